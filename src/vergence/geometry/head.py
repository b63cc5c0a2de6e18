"""HeadCalibration: all that the estimators need to know of a head; JSON in and out.

The frame `head` has its origin midway between the rotation centres of the eyes and the axes of
the left eye's base frame (x forward, y left, z up).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass

from vergence.arrays import Array, Transform
from vergence.errors import VergenceError
from vergence.files import read_json, write_json
from vergence.geometry.camera import Camera, intrinsics_names
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.kinematics import (
    EYES,
    Kinematics,
    Side,
    eye_pose,
    joint_names,
    reading_kinds,
)
from vergence.geometry.neck import Neck, head_pose
from vergence.geometry.pose_errors import PoseErrors
from vergence.geometry.se3 import POSE, inverse, pose

R_EYE_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation of a camera that looks straight ahead, and of a board that faces it: z along the eye's
x."""

_FINITE = ConfigDict(extra="forbid", allow_inf_nan=False)
"""Settings of the dataclasses: unknown fields, NaN and infinity are refused."""
AS_WIDE = 0.8
"""Ratio of two fields of view above which cameras count as equally wide: lenses of one kind differ
by a few percent."""
MAX_CAMERAS = 64  # a limit for files of strangers, see docs/security.md
MAX_TIME_OFFSET_S = 10.0  # a limit for files of strangers


@dataclass(frozen=True, eq=False, config=_FINITE)
class MountedCamera:
    """A camera and where it sits in its eye."""

    eye: Side
    intrinsics: Camera
    T_eye_cam: Transform
    """Pose of the camera in the eye: T_ec of the paper."""


@dataclass(frozen=True, eq=False, config=_FINITE)
class HeadCalibration:
    """Everything that calibration finds of a head, and nothing that only a twin could know."""

    cameras: dict[str, MountedCamera]
    """By name. The paper's eyes have a wide camera each, which it calls peripheral, and a narrow
    one, which it calls foveal."""
    T_rbase_lbase: Transform
    """Pose of the left eye's base frame in the right one's: T_e^rl of the paper (Eq. 10); the
    identity for a head of one eye."""
    kinematics: Kinematics = field(default_factory=Kinematics)
    """How readings of the joints turn the eyes."""
    neck: Neck = field(default_factory=Neck)
    """From the design, not calibrated; without joints the head is the body."""
    time_offset_s: float = 0.0
    """An image shows the joints this much later than their reading."""
    pose_errors: dict[Side, PoseErrors] = field(default_factory=dict)
    """By eye, what to add to its measured poses; empty: nothing, or joints are read."""
    accuracy: Accuracy | None = None
    """None: not stated; files of other programs and heads as designed have none."""
    format: Literal["vergence-head-calibration-2"] = "vergence-head-calibration-2"

    def __post_init__(self) -> None:
        if not 1 <= len(self.cameras) <= MAX_CAMERAS:
            raise ValueError(f"a head has 1 to {MAX_CAMERAS} cameras, found {len(self.cameras)}")
        for name in self.cameras:
            check_camera_name(name)
        if abs(self.time_offset_s) > MAX_TIME_OFFSET_S:
            raise ValueError(
                f"time_offset_s is in seconds, at most {MAX_TIME_OFFSET_S:g}; found "
                f"{self.time_offset_s:g}"
            )

    def __repr__(self) -> str:
        stated = "states its accuracy" if states_covariance(self) else "states no accuracy"
        return (
            f"<HeadCalibration of {', '.join(self.cameras)}; moved by "
            f"{', '.join(self.kinematics.readings) or 'nothing'}; {stated}>"
        )

    def camera(self, name: str) -> MountedCamera:
        """Look up a camera by its name; VergenceError for an unknown name."""
        if name not in self.cameras:
            known = ", ".join(self.cameras)
            raise VergenceError(f"No camera is called {name!r}; this head has: {known}.")
        return self.cameras[name]


@lru_cache(maxsize=64)
def parameter_names(head: HeadCalibration) -> tuple[str, ...]:
    """List the names of the parameters of a head, in their order: see `geometry.parameters`."""
    cameras = {name: intrinsics_names(each.intrinsics) for name, each in head.cameras.items()}
    joints = tuple(name for eye in EYES for name in joint_names(head.kinematics, eye))
    return _names(tuple(cameras.items()), joints)


@lru_cache(maxsize=64)
def _names(
    lenses: tuple[tuple[str, tuple[str, ...]], ...], joints: tuple[str, ...]
) -> tuple[str, ...]:
    """List the names of all parameters; remembered, since a head that changes keeps its names."""
    poses = tuple(f"T_eye_cam.{name}" for name in POSE)
    return (
        *(f"{camera}.{name}" for camera, lens in lenses for name in (*lens, *poses)),
        *(f"T_rbase_lbase.{name}" for name in POSE),
        *joints,
        "time_offset_s",
    )


def states_covariance(head: HeadCalibration) -> bool:
    """Check whether a head states how well its parameters are known."""
    return head.accuracy is not None and len(head.accuracy.parameters) > 0


def states_noise(head: HeadCalibration) -> bool:
    """Check whether a head states a covariance, or noise of pixels or readings."""
    if (stated := head.accuracy) is None:
        return False
    levels = stated.camera_std_px or stated.joint_std or stated.parameters
    return bool(levels) or stated.pixel_std_px is not None


@lru_cache(maxsize=64)
def without_accuracy(head: HeadCalibration) -> HeadCalibration:
    """Take a calibration as exact."""
    return replace(head, accuracy=None)


def stated_covariance(head: HeadCalibration, names: Sequence[str]) -> tuple[np.ndarray, Array]:
    """Select which (s,) of named parameters have a stated covariance, and that (s, s)."""
    if head.accuracy is None:
        return np.empty(0, dtype=np.intp), np.empty((0, 0))
    theirs = {name: k for k, name in enumerate(head.accuracy.parameters)}
    stated = np.array([k for k, name in enumerate(names) if name in theirs], dtype=np.intp)
    rows = [theirs[name] for name in names if name in theirs]
    return stated, head.accuracy.covariance[np.ix_(rows, rows)]


def pixel_stds(head: HeadCalibration, cameras: tuple[str, str] | None) -> Array:
    """Look up the stated noise of left u, left v, right u, right v (4,) [px]; 0: not stated."""
    pair, accuracy = pair_names(head, cameras), head.accuracy
    if accuracy is None:
        return np.zeros(4)
    typical = accuracy.pixel_std_px or 0.0
    return np.repeat([accuracy.camera_std_px.get(name, typical) for name in pair], 2)


@lru_cache(maxsize=64)
def reading_stds(head: HeadCalibration) -> Array:
    """Look up the stated noise of each reading (r,) [rad]; 0: not stated."""
    accuracy, kinds = head.accuracy, reading_kinds(head.kinematics)
    if accuracy is None or not accuracy.joint_std:
        return np.zeros(len(kinds))
    levels = np.array(accuracy.joint_std)
    return levels[np.minimum(kinds, len(levels) - 1)]


def dead_bands(head: HeadCalibration) -> Array:
    """Compute the changes (r,) of the readings that its eyes do not follow [rad].

    It is half of the stated backlash, as far as that is certain, where the eye lags behind; an eye
    before which its sensor lags follows every command. 0: none is stated.
    """
    bands = np.zeros(len(head.kinematics.readings))
    widths = {} if head.accuracy is None else head.accuracy.backlash_rad
    for r, name in enumerate(head.kinematics.readings):
        for owner in (name, *(f"{eye}_{name}" for eye in EYES)):
            width, std = widths.get(owner, (0.0, 0.0))
            bands[r] = max(bands[r], (width - std) / 2)
    return bands


def check_camera_name(name: str) -> None:
    """Raise ValueError for a name that no camera can have: it is also used in names of files."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]{0,63}", name) or name in EYES:
        raise ValueError(
            f"cameras.{name[:80]}: a camera's name begins with a letter, has letters, digits, - "
            "and _, and is not the name of an eye"
        )


def cameras_of(head: HeadCalibration, eye: Side) -> list[str]:
    """List the names of an eye's cameras, in the order of the head."""
    return [name for name, mounted in head.cameras.items() if mounted.eye == eye]


def main_camera(lenses: Mapping[str, Camera]) -> str:
    """Select the main one of an eye's cameras: the first of those that see most."""
    slopes = {name: lens.width / lens.matrix[0, 0] for name, lens in lenses.items()}
    return next(n for n, slope in slopes.items() if slope > AS_WIDE * max(slopes.values()))


def main_cameras(head: HeadCalibration) -> tuple[str, ...]:
    """List the main camera of each eye that has one."""
    return tuple(main_camera(lenses_of(head, eye)) for eye in EYES if cameras_of(head, eye))


def narrow_camera(lenses: Mapping[str, Camera]) -> str:
    """Select the camera of an eye that sees least, and finest; the main one if all see as much."""
    slopes = {name: lens.width / lens.matrix[0, 0] for name, lens in lenses.items()}
    main = main_camera(lenses)
    least = min(slopes, key=lambda name: slopes[name])
    return least if slopes[least] < AS_WIDE * slopes[main] else main


def lenses_of(head: HeadCalibration, eye: Side) -> dict[str, Camera]:
    """Look up the intrinsics of an eye's cameras by name, in the order of the head."""
    return {name: head.cameras[name].intrinsics for name in cameras_of(head, eye)}


def main_pair(head: HeadCalibration) -> tuple[str, str] | None:
    """Select the main camera of the left and of the right eye; None for a head of one eye."""
    left, right = (lenses_of(head, eye) for eye in EYES)
    return (main_camera(left), main_camera(right)) if left and right else None


def pair_names(head: HeadCalibration, cameras: tuple[str, str] | None = None) -> tuple[str, str]:
    """Check the names of a camera of the left eye and one of the right; None: the main ones."""
    if not isinstance(head, HeadCalibration):
        raise VergenceError(
            f"A head is a HeadCalibration, such as of load_head(path); found {head!r:.80}."
        )
    pair = main_pair(head) if cameras is None else cameras
    if pair is None:
        raise VergenceError(
            f"Stereo needs a camera in each eye; this head has {', '.join(head.cameras)}."
        )
    names = [pair] if isinstance(pair, str) else list(pair)
    if [head.camera(name).eye for name in names] != ["left", "right"]:
        raise VergenceError(
            "A stereo pair is a camera of the left eye and one of the right, in this order, such "
            f"as {main_pair(head)}; found {pair!r:.80}."
        )
    return names[0], names[1]


def base_pose(head: HeadCalibration, eye: Side) -> Array:
    """Compute the pose (4, 4) of an eye's base frame in frame head."""
    T_lbase_rbase = inverse(head.T_rbase_lbase)
    T_head_lbase = pose(t=-T_lbase_rbase[:3, 3] / 2)
    return T_head_lbase if eye == "left" else T_head_lbase @ T_lbase_rbase


def camera_pose_in_base(head: HeadCalibration, camera: str, joints: Array) -> Array:
    """Compute poses (..., 4, 4) of a camera in its eye's base, at readings (..., r) of the head."""
    mounted = head.camera(camera)
    return eye_pose(head.kinematics, mounted.eye, joints) @ mounted.T_eye_cam


def base_pose_in_body(head: HeadCalibration, eye: Side, neck_angles: Array) -> Array:
    """Compute poses (..., 4, 4) of an eye's base in frame body, T_be(neck) of Eq. 12.

    The angles (..., n) [rad] are those of a frame, or of a posture, which begins with them.
    """
    angles = neck_angles[..., : len(head.neck.axes)]
    return head_pose(head.neck, angles) @ base_pose(head, eye)


def wide_pose_in_narrow(head: HeadCalibration, eye: Side) -> Array:
    """Compute the pose (4, 4) of the wide camera in the narrow one: R_fp, t_fp of Sec. III."""
    lenses = lenses_of(head, eye)
    wide, narrow = (head.camera(select(lenses)) for select in (main_camera, narrow_camera))
    return inverse(narrow.T_eye_cam) @ wide.T_eye_cam


def save_head(head: HeadCalibration, path: Path | str) -> None:
    """Write a calibration as JSON; VergenceError if the file cannot be written."""
    if not isinstance(head, HeadCalibration):
        raise VergenceError(
            f"save_head takes a HeadCalibration, such as calibrate(...).head; found {head!r:.80}."
        )
    write_json(head, Path(path))


def load_head(path: Path | str, *, allow_void: bool = False) -> HeadCalibration:
    """Read a calibration from JSON; `allow_void` also reads one that must not be used.

    Raises VergenceError if the file is missing or invalid, or the calibration is void.
    """
    head = read_json(Path(path), HeadCalibration, "a head calibration")
    if head.accuracy is None:
        return head
    known = parameter_names(head)
    if unknown := [name for name in head.accuracy.parameters if name not in known]:
        raise VergenceError(
            f"{path} is not a head calibration: accuracy.parameters has {unknown[0][:80]!r}, which "
            f"is no parameter of this head; it has {', '.join(known[:3])} and others."
        )
    if head.accuracy.void and not allow_void:
        raise VergenceError(f"The calibration {path} is VOID: {head.accuracy.void[0]}")
    return head
