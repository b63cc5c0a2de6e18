"""Revolute joints, how real ones differ from the design, and chains of them."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import field
from functools import cached_property, lru_cache
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from vergence.arrays import Array, Vector3, replace_unchecked
from vergence.geometry import se3
from vergence.geometry.batches import batch_first, batch_last, ignoring_invalid, product, times
from vergence.geometry.se3 import hat, rotation

_LARGEST = 1e3
"""Largest gain, factor, offset [rad] or length [m] of a joint."""
_SMALLEST = 1e-9
"""Least angle by a radian of a reading from which it moves a joint [rad]."""
_Number = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST)]
_Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,40}$")]
ReadingName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_:()/ -]{0,60}$")]
MAX_POINT_M = 5.0
"""Farthest point on an eye's joint; one that is farther away was probably given in millimetres."""
PARALLEL = 0.1
"""Sine of the angle between successive axes below which they count as parallel."""


@dataclass(frozen=True, eq=False, config=ConfigDict(extra="forbid", allow_inf_nan=False))
class Joint:
    """A revolute joint of an eye: as designed, and how the real one differs.

    angle = gain * (sum of factor * reading) + offset. The factors of several readings are
    calibrated in place of a gain, which is multiplied into them and then 1.

    The common normal of two successive axes is (own axis) x (axis before); along it and about it,
    one axis may be misplaced relative to the other (Denavit and Hartenberg, 1955). The common
    normal of parallel axes points from the axis before to the own one; such an axis may also be
    inclined in the plane of the two, and has its slide in common with the axis before (Hayati,
    1983).
    """

    name: _Name
    axis: Vector3
    """Unit vector in the eye's base, with every joint at zero."""
    readings: dict[ReadingName, _Number]
    """The factor of each reading that moves the joint, by the name of the reading."""
    point_m: Vector3 = field(default_factory=lambda: np.zeros(3))
    """A point on the axis, in the eye's base."""
    gain: _Number = 1.0
    offset_rad: _Number = 0.0
    nonorthogonality_rad: _Number = 0.0
    """Turn of the axis about the common normal; for a tilt behind a pan: out of the plane that is
    perpendicular to the pan axis."""
    axis_distance_m: _Number = 0.0
    """Shift along the common normal, of this joint and all behind it; for a tilt behind a pan: how
    far it lies ahead (+x) of the pan axis, which it should intersect."""
    slide_m: _Number = 0.0
    """Shift along the axis, of this joint and all behind it."""
    inclination_rad: _Number = 0.0
    """Turn of an axis, parallel to the one before, about (own axis) x (common normal), in their
    plane."""

    def __post_init__(self) -> None:
        if abs(np.linalg.norm(self.axis) - 1) > 1e-6:
            length = np.linalg.norm(self.axis)
            raise ValueError(f"the axis of joint {self.name} is a unit vector, found {length:.6g}")
        if np.abs(self.point_m).max() > MAX_POINT_M:
            raise ValueError(f"point_m of joint {self.name} is in metres, found {self.point_m}")
        if abs(self.gain) * max(map(abs, self.readings.values()), default=0.0) < _SMALLEST:
            raise ValueError(f"no reading moves joint {self.name}")
        if len(self.readings) > 1 and self.gain != 1:
            factors = {name: self.gain * factor for name, factor in self.readings.items()}
            object.__setattr__(self, "readings", factors)
            object.__setattr__(self, "gain", 1.0)


class CommonNormal(NamedTuple):
    """How one of two successive axes was designed to lie to the other."""

    direction: Array
    """(3,) unit vector."""
    parallel_m: float | None
    """Distance of parallel axes; None: they are not parallel."""


def common_normal(before: Joint, joint: Joint) -> CommonNormal:
    """Compute the common normal of two successive axes."""
    return _common_normal(
        *(tuple(each.axis.tolist() + each.point_m.tolist()) for each in (before, joint))
    )


@lru_cache(maxsize=256)  # an estimate changes joints many times a second, but never their design
def _common_normal(before: tuple[float, ...], joint: tuple[float, ...]) -> CommonNormal:
    (first, start), (axis, point) = (np.reshape(each, (2, 3)) for each in (before, joint))
    normal, distance = se3.cross(axis, first), None
    if np.linalg.norm(normal) < PARALLEL:
        normal = point - start
        normal = normal - normal @ axis * axis
        distance = float(np.linalg.norm(normal))
    length = np.linalg.norm(normal)
    return CommonNormal(normal / length if length > 0 else normal, distance)


def _inclines_about(before: Joint, joint: Joint) -> Array:
    """Compute the unit vector (3,) about which a joint's inclination turns its axis."""
    normal = common_normal(before, joint).direction
    return rotation(joint.nonorthogonality_rad * normal) @ se3.cross(joint.axis, normal)


@dataclasses.dataclass(frozen=True, eq=False)
class Chain:
    """n revolute joints from a base outwards, moved by r readings.

    Axes and points are given in the base with every joint at zero, where all frames are parallel.
    """

    axes: Array
    """(n, 3) unit vectors."""
    points_m: Array
    """(n, 3) a point on each axis."""
    end_m: Array
    """(3,) origin of the frame at the end of the chain."""
    mixing: Array
    """(n, r): angles = mixing @ readings + offset."""
    offset_rad: Array
    """(n,)."""

    @cached_property
    def steps_m(self) -> Array:
        """(n, 3) from each joint to the next one, or to the end."""
        return np.diff(np.vstack([self.points_m, self.end_m]), axis=0)

    @cached_property
    def moving(self) -> list[list[tuple[int, float]]]:
        """By joint the readings that move it, and their factors."""
        return [
            [(r, factor) for r, factor in enumerate(row) if factor] for row in self.mixing.tolist()
        ]

    @cached_property
    def rodrigues(self) -> Array:
        """(n, 9, 3) by which cosine, sine and 1 - cosine of an angle make the turn of its joint."""
        outer = self.axes[:, :, None] * self.axes[:, None]
        unit = np.broadcast_to(np.eye(3), outer.shape)
        return np.stack([unit, hat(self.axes), outer], axis=-1).reshape(-1, 9, 3)


@ignoring_invalid
def joint_frames(chain: Chain, readings: Array) -> tuple[list[Array], list[Array]]:
    """Compute rotation and origin of each joint before it turns, and then of the chain's end.

    They are n + 1 rotations (..., 3, 3) and as many origins (..., 3) at readings (..., r) [rad].
    """
    parts, batch = batch_last(readings), readings.shape[:-1]
    R, t = [np.eye(3)], [chain.points_m[0] if len(chain.axes) else chain.end_m]
    for k, (basis, step) in enumerate(zip(chain.rodrigues, chain.steps_m, strict=True)):
        angle = chain.offset_rad[k] + sum(factor * parts[r] for r, factor in chain.moving[k])
        cosine, sine = np.cos(angle), np.sin(angle)
        terms = np.array([cosine, sine, 1 - cosine]).reshape(3, math.prod(batch))
        turn = batch_first((basis @ terms).reshape(3, 3, *batch), 2)
        R.append(product(R[-1], turn) if k else turn)
        t.append(t[-1] + times(R[-1], step) if step.any() else t[-1])
    return R, t


def chain_pose(chain: Chain, readings: Array) -> Array:
    """Compute the pose (..., 4, 4) of a chain's end in its base at readings (..., r) [rad]."""
    R, t = joint_frames(chain, readings)
    return pose_of(R[-1], t[-1], readings.shape[:-1])


def pose_of(R: Array, t: Array, batch: tuple[int, ...]) -> Array:
    """Join rotations and translations, which broadcast, to poses (*batch, 4, 4)."""
    T = batch_first(np.empty((4, 4, *batch)), 2)
    T[..., :3, :3], T[..., :3, 3], T[..., 3, :] = R, t, [0.0, 0.0, 0.0, 1.0]
    return T


def eye_chain(joints: tuple[Joint, ...], readings: tuple[str, ...]) -> Chain:
    """Assemble the chain of joints, with their errors, moved by readings of these names."""
    n = len(joints)
    axes, points, mixing = np.empty((n, 3)), np.empty((n, 3)), np.zeros((n, len(readings)))
    shift = np.zeros(3)
    for k, joint in enumerate(joints):
        axes[k] = joint.axis
        if k:
            normal = common_normal(joints[k - 1], joint).direction
            if joint.nonorthogonality_rad:
                axes[k] = rotation(joint.nonorthogonality_rad * normal) @ joint.axis
            if joint.inclination_rad:
                about = _inclines_about(joints[k - 1], joint)
                axes[k] = rotation(joint.inclination_rad * about) @ axes[k]
            shift = shift + joint.axis_distance_m * normal + joint.slide_m * joint.axis
        points[k] = joint.point_m + shift
        for name, factor in joint.readings.items():
            mixing[k, readings.index(name)] = joint.gain * factor
    offset = np.array([joint.offset_rad for joint in joints])
    return Chain(axes, points, points[-1] if n else np.zeros(3), mixing, offset)


def joint_parameters(joints: tuple[Joint, ...]) -> list[tuple[int, str]]:
    """List the parameters by which joints may differ from their design: (joint's number, name).

    A joint with several readings has a factor for each of them in place of one gain. Slides of the
    first and the last joint are left out, since they only shift the eye's base, or the cameras in
    the eye; successive parallel axes have one slide. The first axis has no errors: it defines the
    base.
    """
    found, n = [], len(joints)
    parallel = [
        0 < k < n and common_normal(joints[k - 1], joints[k]).parallel_m is not None
        for k in range(n + 1)
    ]
    for k in range(n):
        several = list(joints[k].readings) if len(joints[k].readings) > 1 else []
        found += [(k, f"factor_{name}") for name in several] or [(k, "gain")]
        found.append((k, "offset_rad"))
        if k:
            found += [(k, "nonorthogonality_rad"), (k, "axis_distance_m")]
        if parallel[k]:
            found.append((k, "inclination_rad"))
        elif k > 0 and parallel.index(False, k + 1) < n:
            found.append((k, "slide_m"))
    return found


def joint_value(joint: Joint, name: str) -> float:
    """Read one of the numbers that joint_parameters names."""
    if name.startswith("factor_"):
        return joint.readings[name.removeprefix("factor_")]
    return getattr(joint, name)


def change_joints(joints: tuple[Joint, ...], change: Array) -> tuple[Joint, ...]:
    """Change the errors of joints by (a,), in the order of joint_parameters.

    ValueError if they change by more than any joint has.
    """
    if np.abs(change).max(initial=0.0) > _LARGEST:
        raise ValueError(f"the numbers of a joint change by {_LARGEST:g} at most, found {change}")
    own: list[dict[str, Any]] = [{"readings": dict(joint.readings)} for joint in joints]
    for (k, name), value in zip(joint_parameters(joints), change.tolist(), strict=True):
        into = own[k]["readings"] if name.startswith("factor_") else own[k]
        into[name.removeprefix("factor_")] = joint_value(joints[k], name) + value
    return tuple(replace_unchecked(joint, **new) for joint, new in zip(joints, own, strict=True))


def axis_error(joints: tuple[Joint, ...], k: int, name: str) -> tuple[bool, Array] | None:
    """Look up whether an error of joint k tilts its axis or shifts it, and the direction (3,).

    None for an error of the angle.
    """
    if name == "slide_m":
        return False, joints[k].axis
    if name == "inclination_rad":
        return True, _inclines_about(joints[k - 1], joints[k])
    if name in ("nonorthogonality_rad", "axis_distance_m"):
        return name == "nonorthogonality_rad", common_normal(joints[k - 1], joints[k]).direction
    return None
