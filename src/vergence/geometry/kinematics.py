"""Joint readings to poses: chains of revolute joints, the eyes' and the neck's.

A chain is what carries a camera: each joint turns about an axis through a point, and its angle is a
linear combination of readings. The default of an eye is the paper's: pan, a right-handed turn about
+z (positive looks left), then tilt about +y (positive looks down), `R_base_eye = Rz(pan) Ry(tilt)`.
"""

from __future__ import annotations

from dataclasses import dataclass as plain_dataclass
from dataclasses import field, fields
from functools import cached_property, lru_cache
from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from vergence.arrays import MAX_M, Array, Vector3, Vectors3
from vergence.geometry.se3 import cross, hat

Side = Literal["left", "right"]
EYES: tuple[Side, Side] = ("left", "right")
EYE_JOINTS = ("left_pan", "left_tilt", "right_pan", "right_tilt")
"""Order of the columns wherever the angles of both eyes stand in one (N, 4) array."""
EYE_COLUMNS: dict[Side, slice] = {"left": slice(0, 2), "right": slice(2, 4)}
"""Where pan and tilt of an eye stand among the four angles of both."""
NECK_JOINTS = ("neck_pitch", "neck_roll", "neck_yaw")


@plain_dataclass(frozen=True, eq=False)
class Chain:
    """n revolute joints from a base outwards, moved by r readings.

    Axes and points are given in the base with every joint at zero, where all frames are parallel.
    Leading dimensions are batches.
    """

    axes: Array
    """(..., n, 3) unit vectors."""
    points_m: Array
    """(..., n, 3) a point on each axis."""
    end_m: Array
    """(..., 3) origin of the frame at the end of the chain."""
    mixing: Array
    """(..., n, r): angles = mixing @ readings + offset."""
    offset_rad: Array
    """(..., n)."""

    @cached_property
    def components(self) -> tuple[Array, Array, Array, Array, Array]:
        """Generators (n, 3, 3, ...) of the turns and their squares; axes, points and steps between
        these (n, 3, ...): what does not depend on readings, components first."""
        generators = hat(self.axes)
        points = np.concatenate([self.points_m, self.end_m[..., None, :]], axis=-2)
        turns = _first(generators, 3), _first(generators @ generators, 3)
        steps = np.diff(points, axis=-2)
        return *turns, _first(self.axes, 2), _first(points, 2), _first(steps, 2)


def chain_pose(chain: Chain, readings: Array) -> Array:
    """Return the pose (..., 4, 4) of the chain's end in its base at readings (..., r) [rad]."""
    R, t = _joint_frames(chain, readings)
    return _pose(R[-1], t[-1])


def chain_linearised(chain: Chain, readings: Array) -> tuple[Array, Array]:
    """Return chain_pose, and its derivatives (..., 6, r) by the readings as in `se3.boxplus`."""
    R, t = _joint_frames(chain, readings)
    by_angle = _first(_angle_jacobian(chain, R, t), 2)
    return _pose(R[-1], t[-1]), _last(_by_readings(chain, by_angle))


def _pose(R: Array, t: Array) -> Array:
    """Return poses (..., 4, 4) of R (3, 3, ...) and t (3, ...)."""
    T = np.zeros((4, 4, *t.shape[1:]))
    T[:3, :3], T[:3, 3], T[3, 3] = R, t, 1.0
    return _last(T)


def _angle_jacobian(chain: Chain, R: Array, t: Array) -> Array:
    """Return the Jacobian (..., 6, n): a joint turns the end about its axis, and moves it so."""
    axes = np.add.reduce(R[:-1] * _spread(chain.components[2], 2, t.ndim - 2)[:, None], axis=2)
    moves = cross(axes.swapaxes(0, 1), (t[-1] - t[:-1]).swapaxes(0, 1), axis=0)
    return _last(np.concatenate([axes.swapaxes(0, 1), moves]))


def _first(array: Array, count: int) -> Array:
    """Return an array (..., a, b) as (a, b, ...), for the last `count` of its axes."""
    k = array.ndim - count
    return array.transpose(*range(k, array.ndim), *range(k)) if k else array


def _last(array: Array) -> Array:
    """Return an array (a, b, ...) as (..., a, b)."""
    return array.transpose(*range(2, array.ndim), 0, 1) if array.ndim > 2 else array


def _spread(array: Array, count: int, batch: int) -> Array:
    """Return an array (a, b, ...) that broadcasts with others of `batch` dimensions behind."""
    shape = array.shape
    return array.reshape(*shape[:count], *(1,) * (batch + count - len(shape)), *shape[count:])


def _joint_frames(chain: Chain, readings: Array) -> tuple[Array, Array]:
    """Return R (n+1, 3, 3, ...), t (n+1, 3, ...): each joint before its turn, and the end.

    The components come first: numpy is several times as fast on long rows as on small matrices.
    """
    generators, squares, axes, ahead, steps = chain.components
    if chain.mixing.ndim == 2:
        angles = readings @ chain.mixing.T + chain.offset_rad
    else:
        angles = (chain.mixing @ readings[..., None])[..., 0] + chain.offset_rad
    shape = np.broadcast_shapes(angles.shape[:-1], axes.shape[2:])
    n, d = len(axes), len(shape)
    R, t = np.empty((n + 1, 3, 3, *shape)), np.empty((n + 1, 3, *shape))
    R[0] = _spread(np.eye(3), 2, d)
    t[0] = _spread(ahead[0], 1, d)
    if not n:
        return R, t
    angle = _spread(_first(angles, 1), 1, d)[:, None, None]
    # Rodrigues' formula.
    turns = np.sin(angle) * _spread(generators, 3, d)
    turns = turns + (1 - np.cos(angle)) * _spread(squares, 3, d)
    turns += R[0]
    R[1] = turns[0]
    for k in range(1, n):
        R[k + 1] = np.add.reduce(R[k][:, :, None] * turns[k], axis=1)
    steps = _spread(steps, 2, d)
    for k in range(n):
        t[k + 1] = t[k] + np.add.reduce(R[k + 1] * steps[k], axis=1)
    return R, t


_Number = Annotated[float, Field(ge=-1e3, le=1e3)]


@dataclass(frozen=True, eq=False, config=ConfigDict(extra="forbid", allow_inf_nan=False))
class EyeAxes:
    """How the axes of one eye differ from perfect ones; true angle = gain * reading + offset."""

    pan_gain: _Number = 1.0
    tilt_gain: _Number = 1.0
    pan_offset_rad: _Number = 0.0
    tilt_offset_rad: _Number = 0.0
    nonorthogonality_rad: _Number = 0.0
    """Turn of the tilt axis about +x, out of the plane that is perpendicular to the pan axis."""
    axis_distance_m: _Number = 0.0
    """Distance of the tilt axis ahead (+x) of the pan axis, which it should intersect."""


_PERFECT = EyeAxes()
AXES = tuple(each.name for each in fields(EyeAxes))


def axes_row(axes: EyeAxes) -> Array:
    """Return the fields (6,) of EyeAxes in the order of AXES."""
    return np.array([getattr(axes, name) for name in AXES])


@lru_cache(maxsize=64)
def _chain_of(axes: EyeAxes) -> Chain:
    return eye_chain(axes_row(axes))


def eye_chain(axes: EyeAxes | Array | None = None) -> Chain:
    """Return the chain of an eye, pan then tilt; axes may be rows (..., 6); None: perfect axes."""
    if not isinstance(axes, np.ndarray):
        return _chain_of(axes or _PERFECT)
    rows = axes
    mixing, steps, directions = (np.zeros((*rows.shape[:-1], 2, n)) for n in (2, 3, 3))
    mixing[..., 0, 0], mixing[..., 1, 1] = rows[..., 0], rows[..., 1]
    directions[..., 0, 2] = 1.0
    directions[..., 1, 1], directions[..., 1, 2] = np.cos(rows[..., 4]), np.sin(rows[..., 4])
    steps[..., 1, 0] = rows[..., 5]
    return Chain(directions, steps, steps[..., 1, :], mixing, rows[..., 2:4])


def T_base_eye(angles: Array, axes: EyeAxes | Array | None = None) -> Array:
    """Return the pose (..., 4, 4) of the eye in its fixed base frame: T_er(theta) of the paper.

    Angles are (..., 2) readings of pan and tilt [rad]; axes are those of `eye_chain`.
    """
    return chain_pose(eye_chain(axes), angles)


def eye_linearised(angles: Array, axes: EyeAxes | Array) -> tuple[Array, Array, Array]:
    """Return T_base_eye (..., 4, 4), its derivatives by axes (..., 6, 6) and readings (..., 6, 2).

    In the increment of `se3.boxplus`, at readings (..., 2) [rad] and rows (..., 6) of axes.
    """
    chain = eye_chain(axes)
    R, t = _joint_frames(chain, angles)
    by_angle = _first(_angle_jacobian(chain, R, t), 2)
    by_axes = np.zeros((6, 6, *t.shape[2:]))
    by_axes[:, :2] = by_angle * _spread(_first(angles, 1), 1, t.ndim - 2)
    by_axes[:, 2:4] = by_angle
    # The tilt axis is turned about x: R_tilt becomes exp(e x) R_tilt exp(-e x).
    by_axes[:3, 4] = R[1, :, 0] - R[2, :, 0]
    by_axes[3:, 5] = R[1, :, 0]
    return _pose(R[-1], t[-1]), _last(by_axes), _last(_by_readings(chain, by_angle))


def _by_readings(chain: Chain, by_angle: Array) -> Array:
    """Return derivatives (6, r, ...) by readings of those by angles (6, n, ...)."""
    mixing = _spread(_first(chain.mixing, 2), 2, by_angle.ndim - 2)
    return np.add.reduce(by_angle[:, :, None] * mixing, axis=1)


def eye_jacobians(angles: Array, axes: EyeAxes | Array) -> tuple[Array, Array]:
    """Return the derivatives of `eye_linearised` by axes (..., 6, 6) and readings (..., 6, 2)."""
    return eye_linearised(angles, axes)[1:]


MAX_NECK_JOINTS = 20


@dataclass(frozen=True, eq=False, config=ConfigDict(extra="forbid"))
class Neck:
    """The chain from body to head: each joint turns about an axis through a point.

    Axes and points are given in the frame body with every joint at zero, where the axes of body
    and head are parallel.
    """

    axes: Vectors3 = field(default_factory=lambda: np.empty((0, 3)))
    """(n, 3) unit vectors, from the body outwards."""
    points_m: Vectors3 = field(default_factory=lambda: np.empty((0, 3)))
    """(n, 3) a point on each axis."""
    head_m: Vector3 = field(default_factory=lambda: np.zeros(3))
    """Origin of frame head."""

    def __post_init__(self) -> None:
        if len(self.axes) != len(self.points_m):
            raise ValueError(
                f"a neck has a point on each axis, found {len(self.axes)} axes and "
                f"{len(self.points_m)} points"
            )
        if len(self.axes) > MAX_NECK_JOINTS:
            raise ValueError(f"a neck has at most {MAX_NECK_JOINTS} joints, found {len(self.axes)}")
        largest = max(np.abs(self.points_m).max(initial=0.0), np.abs(self.head_m).max())
        if largest > MAX_M:
            raise ValueError(f"points are in metres, found {largest:g}")
        lengths = np.linalg.norm(self.axes, axis=1)
        if (np.abs(lengths - 1) > 1e-6).any():
            raise ValueError(f"axes are unit vectors, found one of length {lengths.max():.6g}")


def T_body_head(neck: Neck, angles: Array) -> Array:
    """Return the pose (..., 4, 4) of the head in frame body at neck angles (..., n) [rad]."""
    n = len(neck.axes)
    return chain_pose(Chain(neck.axes, neck.points_m, neck.head_m, np.eye(n), np.zeros(n)), angles)
