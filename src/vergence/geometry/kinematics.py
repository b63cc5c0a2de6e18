"""Joint readings to poses: the chains of revolute joints of the eyes.

A chain is what carries a camera: each joint turns about an axis through a point, and its angle is a
linear combination of readings. The default of an eye is the paper's: pan, a right-handed turn about
+z (positive looks left), then tilt about +y (positive looks down), `R_base_eye = Rz(pan) Ry(tilt)`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import field
from functools import cached_property
from itertools import pairwise, zip_longest
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass

from vergence.arrays import Array, floats
from vergence.errors import VergenceError
from vergence.geometry.joints import (
    PARALLEL,
    Chain,
    Joint,
    ReadingName,
    chain_pose,
    common_normal,
    eye_chain,
    joint_parameters,
)

Side = Literal["left", "right"]
EYES: tuple[Side, Side] = ("left", "right")
EYE_JOINTS = ("left_pan", "left_tilt", "right_pan", "right_tilt")
"""The readings of eyes that pan and tilt, each on its own."""
AXIS_NAMES = {"pan": (0.0, 0.0, 1.0), "tilt": (0.0, 1.0, 0.0), "roll": (1.0, 0.0, 0.0)}
"""The axes of a head that stands upright: up, to the left, ahead."""
MAX_JOINTS = 20
"""Most joints of a chain, and readings of a head."""
GEARED = 3.0
"""Ratio of the factors of readings from which one of them stands before a gear, so that its noise
is of another size. A reading of vergence, which turns each eye by its half, does not."""


def pan_tilt(eye: Side) -> tuple[Joint, Joint]:
    """Describe the joints of the paper's eye: pan about +z, then tilt about +y."""
    pan, tilt = (
        Joint(name, np.array(AXIS_NAMES[name]), {f"{eye}_{name}": 1.0}) for name in ("pan", "tilt")
    )
    return pan, tilt


@dataclass(frozen=True, eq=False, config=ConfigDict(extra="forbid", allow_inf_nan=False))
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
        return {eye: eye_chain(self.eyes[eye], self.readings) for eye in EYES}

    @cached_property
    def parameters(self) -> Mapping[Side, list[tuple[int, str]]]:
        """By eye the parameters by which its joints may differ from the design, in order."""
        return {eye: joint_parameters(self.eyes[eye]) for eye in EYES}

    @cached_property
    def gear_ratios(self) -> Array:
        """(r,) ratio of the gear behind each reading: the largest of its factors, without gains."""
        joints = [joint for eye in EYES for joint in self.eyes[eye]]
        turns = [[abs(joint.readings.get(name, 0.0)) for joint in joints] for name in self.readings]
        return np.array([max(each, default=0.0) or 1.0 for each in turns])

    def used(self, eye: Side) -> list[int]:
        """List the readings that move an eye, in the order of the joints that they move."""
        mixing = self.chains[eye].mixing != 0
        _, used = np.nonzero(mixing)  # joint by joint
        return list(dict.fromkeys(used.tolist()))


def joint_names(kinematics: Kinematics, eye: Side) -> tuple[str, ...]:
    """List the names of the parameters of an eye's joints, such as left.pan_gain."""
    joints = kinematics.eyes[eye]
    return tuple(f"{eye}.{joints[k].name}_{name}" for k, name in kinematics.parameters[eye])


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
                f"joint {joint.name} of the {whose} is moved by {min(unknown)!r}, none of "
                f"the readings {', '.join(readings)}"
            )
    for before, joint in pairwise(joints):
        distance = common_normal(before, joint).parallel_m
        if distance is not None and distance < 1e-3:  # m; no two joints are built so
            raise ValueError(
                f"joints {before.name} and {joint.name} of the {whose} have the same axis; give "
                "one joint with the readings of both, or by `point_m` where each axis is"
            )


FIXED_EYES = Kinematics({eye: () for eye in EYES}, ())
"""Cameras that stand still: a base has no joints, and no reading moves it."""


def check_moves(kinematics: Kinematics, what: str) -> None:
    """Raise VergenceError if the eyes stand still, which something, in words, needs to move."""
    if not kinematics.readings:
        raise VergenceError(f"{what} needs moving eyes; the cameras of this head stand still.")


def same_design(a: Kinematics, b: Kinematics, eyes: Collection[Side] = EYES) -> bool:
    """Check whether joints of some eyes have the same design, whatever their errors."""
    pairs = [pair for eye in eyes for pair in zip_longest(a.eyes[eye], b.eyes[eye])]
    return all(
        one is not None
        and other is not None
        and (one.name, set(one.readings)) == (other.name, set(other.readings))
        and np.allclose(one.axis, other.axis)
        and np.allclose(one.point_m, other.point_m)
        for one, other in pairs
    )


def reading_kinds(kinematics: Kinematics) -> list[int]:
    """Number the kinds (r,) of readings; readings of one kind have the same level of noise.

    A reading of the left eye alone is of one kind with one of the right eye alone if both turn a
    joint of one name through like gears, such as pan and pan. All others are of their own kind.
    """
    left, right = (kinematics.used(eye) for eye in EYES)
    kinds, numbers = {}, {}
    for reading in sorted((*left, *right), key=lambda r: r in left and r in right):
        kind: object = reading
        if not (reading in left and reading in right):
            name, eye = kinematics.readings[reading], EYES[reading in right]
            joint = next(joint for joint in kinematics.eyes[eye] if joint.readings.get(name))
            gear = round(np.log10(abs(joint.readings[name])))
            kind = joint.name, gear, [*joint.readings].index(name)
        numbers[reading] = kinds.setdefault(kind, len(kinds))
    return [numbers.get(reading, -1) for reading in range(len(kinematics.readings))]


def readings_to_turn(kinematics: Kinematics, turn: Array) -> Array:
    """Compute readings (..., r) that turn both eyes by vectors (..., 3) [rad], to first order."""
    maps = [turn_by_readings(chain) for chain in kinematics.chains.values()]
    return least_readings(np.concatenate(maps), np.concatenate([turn, turn], axis=-1))


def turn_by_readings(chain: Chain) -> Array:
    """Compute the turn (3, r) of an eye by each reading, where all joints are at zero."""
    return chain.axes.T @ chain.mixing


def least_readings(by_reading: Array, turn: Array) -> Array:
    """Compute the smallest readings (..., r) that turn by nearly (..., n), as each turns by (n, r).

    Nearly parallel axes do not turn far against each other.
    """
    # By the turn that each reading makes, so that one before a gear counts as any other.
    size = np.linalg.norm(by_reading, axis=0)
    size[size == 0] = 1.0
    return turn @ (np.linalg.pinv(by_reading / size, rcond=PARALLEL) / size[:, None]).T


def eye_turn(kinematics: Kinematics, eye: Side, readings: Array) -> Array:
    """Compute the turn (..., 3) [rad] of an eye at readings (..., r), to first order in it."""
    return eye_joint_angles(kinematics, eye, readings) @ kinematics.chains[eye].axes


def eye_joint_angles(kinematics: Kinematics, eye: Side, readings: Array) -> Array:
    """Compute the angles (..., n) [rad] of an eye's joints at readings (..., r).

    Readings that do not move the eye may be NaN.
    """
    chain, used = kinematics.chains[eye], kinematics.used(eye)
    return readings[..., used] @ chain.mixing[:, used].T + chain.offset_rad


def straight_gaze(kinematics: Kinematics) -> Array:
    """Make the readings (r,) [rad] of straight gaze, which are zero."""
    return np.zeros(len(kinematics.readings))


def looking_along(pan_rad: np.ndarray, tilt_rad: np.ndarray) -> Array:
    """Compute unit vectors (..., 3) along which an eye looks that pans, then tilts (x ahead)."""
    ahead = np.cos(tilt_rad)
    parts = ahead * np.cos(pan_rad), ahead * np.sin(pan_rad), -np.sin(tilt_rad)
    return np.stack(parts, axis=-1)


def pan_tilt_along(x: Array, y: Array, z: Array) -> tuple[Array, Array]:
    """Compute pan and tilt (...) [rad] with which an eye looks along vectors."""
    return np.arctan2(y, x), -np.arctan2(z, np.hypot(x, y))


def checked_readings(
    kinematics: Kinematics, readings: ArrayLike, *, one_posture: bool = False
) -> Array:
    """Check readings (..., r), or (r,) [rad] of one posture; VergenceError for invalid ones."""
    found, names = floats("joints", readings), kinematics.readings
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
    """Raise VergenceError for finite readings (..., r) that turn a joint by more than a turn."""
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


def eye_pose(kinematics: Kinematics, eye: Side, readings: ArrayLike) -> Array:
    """Compute the pose (..., 4, 4) of an eye in its base, T_er(theta), at readings (..., r)."""
    return chain_pose(kinematics.chains[eye], checked_readings(kinematics, readings))
