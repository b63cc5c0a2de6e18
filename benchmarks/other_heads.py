"""Heads with other joints than pan and tilt of each eye, drawn at random."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from simulated_head import random_head
from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration
from vergence.geometry.joints import Joint, change_joints, joint_parameters
from vergence.geometry.kinematics import AXIS_NAMES, EYES, Kinematics, Side
from vergence.geometry.se3 import pose, rotation

_STD = {
    "gain": 0.02,
    "offset_rad": 0.007,
    "nonorthogonality_rad": 0.005,
    "inclination_rad": 0.005,
    "axis_distance_m": 0.001,
    "slide_m": 0.001,
}
"""Of the errors of joints, as large as those of `random_pan_tilt`."""


def _joint(name: str, readings: dict[str, float], *point_m: float) -> Joint:
    axis = np.array(AXIS_NAMES[name])
    return Joint(name=name, axis=axis, readings=readings, point_m=np.array(point_m or (0, 0, 0.0)))


def tilt_before_pan() -> Kinematics:
    """Return eyes each of which tilts, and pans behind its tilt."""
    eyes: dict[Side, tuple[Joint, ...]] = {
        eye: (_joint("tilt", {f"{eye}_tilt": 1.0}), _joint("pan", {f"{eye}_pan": 1.0}))
        for eye in EYES
    }
    return Kinematics(eyes)


def shared_tilt() -> Kinematics:
    """Return eyes that tilt together, each of which then pans by itself."""
    eyes: dict[Side, tuple[Joint, ...]] = {
        eye: (_joint("tilt", {"tilt": 1.0}), _joint("pan", {f"{eye}_pan": 1.0})) for eye in EYES
    }
    return Kinematics(eyes, ("tilt", "left_pan", "right_pan"))


def version_and_vergence() -> Kinematics:
    """Return eyes that are read by their mean angle and their difference, and tilt together."""
    eyes: dict[Side, tuple[Joint, ...]] = {
        eye: (
            _joint("pan", {"version": 1.0, "vergence": sign}),
            _joint("tilt", {"tilt": 1.0}),
        )
        for eye, sign in zip(EYES, (0.5, -0.5), strict=True)
    }
    return Kinematics(eyes, ("version", "vergence", "tilt"))


def three_axes() -> Kinematics:
    """Return eyes that pan, tilt and roll."""
    eyes: dict[Side, tuple[Joint, ...]] = {
        eye: tuple(_joint(name, {f"{eye}_{name}": 1.0}) for name in ("pan", "tilt", "roll"))
        for eye in EYES
    }
    return Kinematics(eyes, tuple(f"{eye}_{name}" for eye in EYES for name in AXIS_NAMES))


def pair_on_a_neck() -> Kinematics:
    """Return two eyes that a neck carries: yaw about an axis behind and below, then pitch."""
    joints = (
        _joint("pan", {"neck_pan": 1.0}, -0.05, 0.0, -0.1),
        _joint("tilt", {"neck_tilt": 1.0}, -0.05, 0.0, -0.06),
    )
    return Kinematics({eye: joints for eye in EYES}, ("neck_pan", "neck_tilt"))


def two_tilts() -> Kinematics:
    """Return eyes on a neck that tilts, which tilt together about a parallel axis, and pan."""
    eyes: dict[Side, tuple[Joint, ...]] = {
        eye: (
            replace(_joint("tilt", {"neck_tilt": 1.0}, -0.05, 0.0, -0.1), name="neck_tilt"),
            _joint("tilt", {"tilt": 1.0}),
            _joint("pan", {f"{eye}_pan": 1.0}),
        )
        for eye in EYES
    }
    return Kinematics(eyes, ("neck_tilt", "tilt", "left_pan", "right_pan"))


KINDS: dict[str, Callable[[], Kinematics]] = {
    "pan, tilt": Kinematics,
    "tilt, pan": tilt_before_pan,
    "shared tilt, pan": shared_tilt,
    "version and vergence": version_and_vergence,
    "pan, tilt, roll": three_axes,
    "pair on a neck": pair_on_a_neck,
    "neck tilt, tilt, pan": two_tilts,
}


def other_head(kind: str, rng: np.random.Generator, *, rolled: bool = False) -> HeadCalibration:
    """Return a head of a kind with wide cameras; rolled ones stand at any angle in their eyes."""
    head = random_head(rng, lenses=("wide",), perfect_axes=True)
    design = KINDS[kind]()
    off: dict[Side, Array] = {
        eye: rng.normal(0, [_STD.get(name, 0.02) for _, name in joint_parameters(design.eyes[eye])])
        for eye in EYES
    }
    if kind == "pair on a neck":  # one neck for both
        off["right"] = off["left"]
    eyes: dict[Side, tuple[Joint, ...]] = {
        eye: change_joints(design.eyes[eye], off[eye]) for eye in EYES
    }
    head = replace(head, kinematics=Kinematics(eyes, design.readings))
    cameras = dict(head.cameras)
    for name, mounted in cameras.items():
        T = mounted.T_eye_cam
        if kind == "pair on a neck":
            aside = 0.03 + rng.uniform(0, 0.03)
            T = pose(t=[0.05, aside if mounted.eye == "left" else -aside, 0.06]) @ T
        if rolled:
            T = T @ pose(rotation([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))
        cameras[name] = replace(mounted, T_eye_cam=T)
    head = replace(head, cameras=cameras)
    if kind == "pair on a neck":
        head = replace(head, T_rbase_lbase=np.eye(4))
    return head
