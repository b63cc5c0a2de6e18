"""Joint readings to poses: chains of revolute joints, the eyes' and the neck's.

A chain is what carries a camera: each joint turns about an axis through a point, and its angle is a
linear combination of readings. The default of an eye is the paper's: pan, a right-handed turn about
+z (positive looks left), then tilt about +y (positive looks down), `R_base_eye = Rz(pan) Ry(tilt)`.
"""

from __future__ import annotations

from dataclasses import dataclass as plain_dataclass
from dataclasses import field, fields
from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from vergence.arrays import MAX_M, Array, Vector3, Vectors3
from vergence.geometry.se3 import cross, pose, rotation

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


def chain_pose(chain: Chain, readings: Array) -> Array:
    """Return the pose (..., 4, 4) of the chain's end in its base at readings (..., r) [rad]."""
    R, t = _joint_frames(chain, readings)
    return pose(R[..., -1, :, :], t[..., -1, :])


def chain_linearised(chain: Chain, readings: Array) -> tuple[Array, Array]:
    """Return chain_pose, and its derivatives (..., 6, r) by the readings as in `se3.boxplus`."""
    R, t = _joint_frames(chain, readings)
    return pose(R[..., -1, :, :], t[..., -1, :]), _angle_jacobian(chain, R, t) @ chain.mixing


def _angle_jacobian(chain: Chain, R: Array, t: Array) -> Array:
    """Return the Jacobian (..., 6, n): a joint turns the end about its axis, and moves it so."""
    axes = (R[..., :-1, :, :] @ chain.axes[..., None])[..., 0]
    arms = t[..., -1:, :] - t[..., :-1, :]
    return np.swapaxes(np.concatenate([axes, cross(axes, arms)], axis=-1), -1, -2)


def _joint_frames(chain: Chain, readings: Array) -> tuple[Array, Array]:
    """Return R (..., n+1, 3, 3), t (..., n+1, 3): each joint before its turn, and the end."""
    angles = (chain.mixing @ readings[..., None])[..., 0] + chain.offset_rad
    turns = rotation(angles[..., None] * chain.axes)
    shape = np.broadcast_shapes(turns.shape[:-3], chain.points_m.shape[:-2], chain.end_m.shape[:-1])
    n = chain.axes.shape[-2]
    R, t = np.empty((*shape, n + 1, 3, 3)), np.empty((*shape, n + 1, 3))
    R[..., 0, :, :] = np.eye(3)
    t[..., 0, :] = chain.points_m[..., 0, :] if n else chain.end_m
    for k in range(n):
        R[..., k + 1, :, :] = R[..., k, :, :] @ turns[..., k, :, :]
        ahead = chain.points_m[..., k + 1, :] if k + 1 < n else chain.end_m
        step = ahead - chain.points_m[..., k, :]
        t[..., k + 1, :] = t[..., k, :] + (R[..., k + 1, :, :] @ step[..., None])[..., 0]
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


AXES = tuple(each.name for each in fields(EyeAxes))


def axes_row(axes: EyeAxes) -> Array:
    """Return the fields (6,) of EyeAxes in the order of AXES."""
    return np.array([getattr(axes, name) for name in AXES])


def eye_chain(axes: EyeAxes | Array | None = None) -> Chain:
    """Return the chain of an eye, pan then tilt; axes may be rows (..., 6); None: perfect axes."""
    rows = axes if isinstance(axes, np.ndarray) else axes_row(axes or EyeAxes())
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


def eye_jacobians(angles: Array, axes: Array) -> tuple[Array, Array]:
    """Return derivatives of T_base_eye by axes (..., 6, 6) and readings (..., 6, 2).

    In the increment of `se3.boxplus`, at readings (..., 2) [rad] and rows (..., 6) of axes.
    """
    chain = eye_chain(axes)
    R, t = _joint_frames(chain, angles)
    by_angle = _angle_jacobian(chain, R, t)
    R_pan, R_eye = R[..., 1, :, :], R[..., 2, :, :]
    by_axes = np.zeros((*by_angle.shape[:-1], 6))
    by_axes[..., :2] = by_angle * angles[..., None, :]
    by_axes[..., 2:4] = by_angle
    R_tilt = np.swapaxes(R_pan, -1, -2) @ R_eye
    # The tilt axis is turned about x: R_tilt becomes exp(e x) R_tilt exp(-e x).
    by_axes[..., :3, 4] = (R_pan @ (np.eye(3) - R_tilt))[..., :, 0]
    by_axes[..., 3:, 5] = R_pan[..., :, 0]
    return by_axes, by_angle @ chain.mixing


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
