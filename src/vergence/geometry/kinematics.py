"""Joint readings to poses: the chains of revolute joints of the eyes.

A chain is what carries a camera: each joint turns about an axis through a point, and its angle is a
linear combination of readings. The default of an eye is the paper's: pan, a right-handed turn about
+z (positive looks left), then tilt about +y (positive looks down), `R_base_eye = Rz(pan) Ry(tilt)`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from vergence.arrays import Array, Vector3, replace_unchecked
from vergence.errors import VergenceError
from vergence.geometry import se3
from vergence.geometry.chain import Chain, chain_pose
from vergence.geometry.se3 import rotation

Side = Literal["left", "right"]
EYES: tuple[Side, Side] = ("left", "right")
EYE_JOINTS = ("left_pan", "left_tilt", "right_pan", "right_tilt")
"""The readings of eyes that pan and tilt, each on its own."""
AXIS_NAMES = {"pan": (0.0, 0.0, 1.0), "tilt": (0.0, 1.0, 0.0), "roll": (1.0, 0.0, 0.0)}
"""The axes of a head that stands upright: up, to the left, ahead."""


_LARGEST = 1e3
"""Largest gain, factor, offset [rad] or length [m] of a joint."""
_Number = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST)]
_Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,40}$")]
ReadingName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_:()/ -]{0,60}$")]
_FINITE = ConfigDict(extra="forbid", allow_inf_nan=False)
MAX_JOINTS = 20
"""Most joints of a chain, and readings of a head."""
MAX_POINT_M = 5.0
"""Farthest point on an eye's joint; one that is farther away was probably given in millimetres."""
PARALLEL = 0.1
"""Sine of the angle between successive axes below which they count as parallel."""
LEAST_APART_M = 1e-3
"""Distance of parallel axes below which they count as one."""


@dataclass(frozen=True, eq=False, config=_FINITE)
class Joint:
    """A revolute joint of an eye: as designed, and how the real one differs.

    angle = gain * (sum of factor * reading) + offset. The common normal of two successive axes is
    (own axis) x (axis before); along it, and about it, one axis may be off against the other
    (Denavit and Hartenberg, 1955). That of parallel axes leads from the axis before to the own one;
    such an axis may also be inclined in the plane of both, and slides with the one before (Hayati,
    1983).
    """

    name: _Name
    axis: Vector3
    """Unit vector in the eye's base, with every joint at zero."""
    readings: dict[ReadingName, _Number]
    """By reading its factor."""
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
        if not any(self.readings.values()):
            raise ValueError(f"no reading moves joint {self.name}")


def pan_tilt(
    eye: Side,
    *,
    pan_gain: float = 1.0,
    pan_offset_rad: float = 0.0,
    tilt_gain: float = 1.0,
    tilt_offset_rad: float = 0.0,
    nonorthogonality_rad: float = 0.0,
    axis_distance_m: float = 0.0,
) -> tuple[Joint, Joint]:
    """Return the joints of the paper's eye: pan about +z, then tilt about +y."""
    pan = Joint(
        name="pan",
        axis=np.array(AXIS_NAMES["pan"]),
        readings={f"{eye}_pan": 1.0},
        gain=pan_gain,
        offset_rad=pan_offset_rad,
    )
    tilt = Joint(
        name="tilt",
        axis=np.array(AXIS_NAMES["tilt"]),
        readings={f"{eye}_tilt": 1.0},
        gain=tilt_gain,
        offset_rad=tilt_offset_rad,
        nonorthogonality_rad=nonorthogonality_rad,
        axis_distance_m=axis_distance_m,
    )
    return pan, tilt


@dataclass(frozen=True, eq=False, config=_FINITE)
class Kinematics:
    """How readings turn the eyes: by eye its joints, from the head outwards."""

    eyes: dict[Side, tuple[Joint, ...]] = field(
        default_factory=lambda: {eye: pan_tilt(eye) for eye in EYES}
    )
    """Both eyes; an eye without joints is fixed to the head."""
    readings: tuple[ReadingName, ...] = EYE_JOINTS
    """Names, in the order in which readings stand in arrays (..., r)."""

    def __post_init__(self) -> None:
        if not len(set(self.readings)) == len(self.readings) <= MAX_JOINTS:
            raise ValueError(f"a head has at most {MAX_JOINTS} readings, each of its own name")
        for eye in EYES:
            if eye not in self.eyes:
                raise ValueError(f"the joints of the {eye} eye are missing")
            _check_joints(f"{eye} eye", self.eyes[eye], self.readings)

    @cached_property
    def chains(self) -> Mapping[Side, Chain]:
        """By eye its chain, with the errors of its joints."""
        return {eye: _eye_chain(self.eyes[eye], self.readings) for eye in EYES}

    @cached_property
    def parameters(self) -> Mapping[Side, list[tuple[int, str]]]:
        """By eye what may differ of its joints: see joint_parameters."""
        return {eye: joint_parameters(self.eyes[eye]) for eye in EYES}

    @cached_property
    def errors(self) -> Mapping[Side, tuple[_Error, ...]]:
        """By eye what may differ of its joints, in the order of joint_parameters."""
        return {eye: _errors(self.eyes[eye], self.readings) for eye in EYES}

    def used(self, eye: Side) -> list[int]:
        """Return which of the readings move an eye, in the order of the joints that they move."""
        mixing = self.chains[eye].mixing != 0
        _, used = np.nonzero(mixing)  # joint by joint
        return list(dict.fromkeys(used.tolist()))


def _check_joints(whose: str, joints: tuple[Joint, ...], readings: tuple[str, ...]) -> None:
    names = [joint.name for joint in joints]
    if not len(set(names)) == len(names) <= MAX_JOINTS:
        raise ValueError(
            f"the {whose} has at most {MAX_JOINTS} joints, each of its own name; found "
            f"{', '.join(names)[:200]}"
        )
    for joint in joints:
        if unknown := set(joint.readings) - set(readings):
            raise ValueError(
                f"joint {joint.name} of the {whose} is moved by {min(unknown)!r}, which is none "
                f"of the readings {', '.join(readings)}"
            )
    for before, joint in pairwise(joints):
        apart = parallel_distance_m(before, joint)
        if apart is not None and apart < LEAST_APART_M:
            raise ValueError(
                f"joints {before.name} and {joint.name} of the {whose} have the same axis; give "
                "one joint with the readings of both, or by `point_m` where each axis is"
            )


def _parallel(before: Joint, joint: Joint) -> bool:
    """Return whether two successive axes are parallel."""
    return _designed(*_lines(before, joint))[0]


def parallel_distance_m(before: Joint, joint: Joint) -> float | None:
    """Return how far a joint's axis is designed to be from the one before; None: not parallel."""
    return float(np.linalg.norm(_between(before, joint))) if _parallel(before, joint) else None


def _between(before: Joint, joint: Joint) -> Array:
    """Return the vector (3,) [m] from a parallel axis before to that of a joint."""
    return _off_axis(joint.point_m - before.point_m, joint.axis)


def _off_axis(apart: Array, axis: Array) -> Array:
    return apart - apart @ axis * axis


def _normal(before: Joint, joint: Joint) -> Array:
    """Return the unit vector (3,) of the common normal of two successive axes."""
    return _designed(*_lines(before, joint))[1]


_Numbers = tuple[float, ...]


def _lines(before: Joint, joint: Joint) -> list[_Numbers]:
    return [tuple(each.axis.tolist() + each.point_m.tolist()) for each in (before, joint)]


@lru_cache(maxsize=256)
def _designed(before: _Numbers, own: _Numbers) -> tuple[bool, Array]:
    """Return whether two axes are parallel, and the unit vector (3,) of their common normal.

    Given are directions and points. Remembered, since joints that an estimate changes many times a
    second keep their design.
    """
    (first, start), (axis, point) = (np.reshape(each, (2, 3)) for each in (before, own))
    normal = se3.cross(axis, first)
    parallel = bool(np.linalg.norm(normal) < PARALLEL)
    if parallel:
        normal = _off_axis(point - start, axis)
    length = np.linalg.norm(normal)
    return parallel, normal / length if length > 0 else normal


def _inclines_about(before: Joint, joint: Joint) -> Array:
    """Return the unit vector (3,) about which a joint's inclination turns its axis."""
    normal = _normal(before, joint)
    return rotation(joint.nonorthogonality_rad * normal) @ se3.cross(joint.axis, normal)


def _eye_chain(joints: tuple[Joint, ...], readings: tuple[str, ...]) -> Chain:
    n = len(joints)
    axes, points, mixing = np.empty((n, 3)), np.empty((n, 3)), np.zeros((n, len(readings)))
    shift = np.zeros(3)
    for k, joint in enumerate(joints):
        axes[k] = joint.axis
        if k:
            normal = _normal(joints[k - 1], joint)
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


def reading_kinds(kinematics: Kinematics) -> list[int]:
    """Return (r,) of what kind each reading is: those of a kind have noise of one level.

    The nth reading of the left eye alone is of one kind with the nth of the right eye alone, such
    as pan with pan; a reading that moves both eyes is of a kind of its own.
    """
    left, right = (kinematics.used(eye) for eye in EYES)
    kinds = [-1] * len(kinematics.readings)
    for one, other in ((left, right), (right, left)):
        for n, reading in enumerate(r for r in one if r not in other):
            kinds[reading] = n
    alone = max(kinds, default=-1) + 1
    for n, reading in enumerate(r for r in left if r in right):
        kinds[reading] = alone + n
    return kinds


def readings_to_turn(kinematics: Kinematics, turn: Array) -> Array:
    """Return readings (..., r) at which both eyes have turned by vectors (..., 3) [rad].

    Along the axes of the head, to first order in the turn, and as nearly as the joints can without
    turning against each other about axes that are all but parallel.
    """
    maps = [chain.axes.T @ chain.mixing for chain in kinematics.chains.values()]
    by_reading = np.concatenate(maps)
    # By the turn that each reading makes, so that one before a gear counts as any other.
    size = np.linalg.norm(by_reading, axis=0)
    size[size == 0] = 1.0
    inverse = np.linalg.pinv(by_reading / size, rcond=PARALLEL) / size[:, None]
    return np.concatenate([turn, turn], axis=-1) @ inverse.T


def eye_turn(kinematics: Kinematics, eye: Side, readings: Array) -> Array:
    """Return the turn (..., 3) [rad] of an eye at readings (..., r), to first order in it."""
    chain, used = kinematics.chains[eye], kinematics.used(eye)  # others may be NaN
    return (readings[..., used] @ chain.mixing[:, used].T + chain.offset_rad) @ chain.axes


def joint_parameters(joints: tuple[Joint, ...]) -> list[tuple[int, str]]:
    """Return what may differ of joints from their design: the number of each joint, and a name.

    Of a joint with several readings the factor of each takes the place of a gain of all. Slides of
    the first and the last joint are left out: they shift the eye's base, and the cameras in the
    eye; successive parallel axes have one slide. The first axis has no errors: it defines the base.
    """
    found, n = [], len(joints)
    parallel = [0 < k < n and _parallel(joints[k - 1], joints[k]) for k in range(n + 1)]
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
    """Return one of the numbers that joint_parameters names."""
    if name.startswith("factor_"):
        return joint.readings[name.removeprefix("factor_")]
    return getattr(joint, name)


def change_joints(joints: tuple[Joint, ...], change: Array) -> tuple[Joint, ...]:
    """Return joints whose errors are changed by (a,), in the order of joint_parameters.

    ValueError if they change by more than any joint has.
    """
    if np.abs(change).max(initial=0.0) > _LARGEST:
        raise ValueError(f"the numbers of a joint change by {_LARGEST:g} at most, found {change}")
    own: list[dict[str, Any]] = [{"readings": dict(joint.readings)} for joint in joints]
    for (k, name), value in zip(joint_parameters(joints), change.tolist(), strict=True):
        into = own[k]["readings"] if name.startswith("factor_") else own[k]
        into[name.removeprefix("factor_")] = joint_value(joints[k], name) + value
    return tuple(replace_unchecked(joint, **new) for joint, new in zip(joints, own, strict=True))


def straight_gaze(kinematics: Kinematics) -> Array:
    """Return the readings (r,) [rad] of straight gaze, which are zero."""
    return np.zeros(len(kinematics.readings))


def looking_along(pan_rad: np.ndarray, tilt_rad: np.ndarray) -> Array:
    """Return unit vectors (..., 3) along which an eye that pans, then tilts, looks (x ahead)."""
    ahead = np.cos(tilt_rad)
    parts = ahead * np.cos(pan_rad), ahead * np.sin(pan_rad), -np.sin(tilt_rad)
    return np.stack(parts, axis=-1)


def checked_readings(
    kinematics: Kinematics, readings: ArrayLike, *, one_posture: bool = False
) -> Array:
    """Return readings (..., r) [rad] as an array; of one posture they are (r,).

    VergenceError if they are not the head's r, or where one posture is needed if they are of more
    than one or not in radians.
    """
    found, names = np.asarray(readings, dtype=float), kinematics.readings
    if found.shape[-1:] != (len(names),) or (one_posture and found.ndim > 1):
        where = "where those of one posture are needed" if one_posture else "in their place"
        raise VergenceError(
            f"This head has the {len(names)} joint readings {', '.join(names)}; found an array of "
            f"shape {found.shape} {where}."
        )
    if one_posture:
        check_turns(kinematics, found)
    return found


def check_turns(kinematics: Kinematics, readings: Array) -> None:
    """Raise VergenceError for readings (..., r) [rad] that turn a joint by more than a turn.

    Degrees do so. The reading itself may be larger, as that of a motor before a gear; one that is
    not finite counts as unknown.
    """
    known = np.where(np.isfinite(readings), readings, 0.0)
    for chain in kinematics.chains.values():
        check_radians(known @ chain.mixing.T + chain.offset_rad, "Joint readings")


def check_radians(angles: Array, what: str) -> None:
    """Raise VergenceError for angles (...) [rad] of more than a turn, as degrees are."""
    beyond = np.abs(angles) > 2 * np.pi
    if beyond.any():
        raise VergenceError(
            f"{what} are in radians; found a joint at {angles[beyond].flat[0]:g}, more than a "
            "turn: np.radians makes radians of degrees."
        )


def T_base_eye(kinematics: Kinematics, eye: Side, readings: ArrayLike) -> Array:
    """Return the pose (..., 4, 4) of an eye in its fixed base: T_er(theta) of the paper.

    Readings are (..., r) [rad], all those of the head; VergenceError if they are not as many.
    """
    return chain_pose(kinematics.chains[eye], checked_readings(kinematics, readings))


class _Error(NamedTuple):
    """One of the errors of an eye's joints: of an angle, or of an axis."""

    joint: int
    mixing: list[tuple[int, float]]
    """Readings that change an angle, and by how much: it is constant + mixing @ readings."""
    constant: float
    direction: list[float] | None
    """Direction that an axis is turned about or shifted along."""
    tilts: bool


def _errors(joints: tuple[Joint, ...], names: tuple[str, ...]) -> tuple[_Error, ...]:
    """Return the errors of joints in the order of joint_parameters."""
    found = []
    for k, name in joint_parameters(joints):
        joint, mixing, direction = joints[k], {}, None
        if name == "gain":
            mixing = joint.readings
        elif name.startswith("factor_"):
            mixing = {name.removeprefix("factor_"): joint.gain}
        elif name == "slide_m":
            direction = joint.axis.tolist()
        elif name == "inclination_rad":
            direction = _inclines_about(joints[k - 1], joint).tolist()
        elif name != "offset_rad":
            direction = _normal(joints[k - 1], joint).tolist()
        terms = [(names.index(one), float(factor)) for one, factor in mixing.items()]
        constant = float(name == "offset_rad")
        tilts = name in ("nonorthogonality_rad", "inclination_rad")
        found.append(_Error(k, terms, constant, direction, tilts))
    return tuple(found)
