"""Whether measured poses of a target, and the start of their adjustment, are of one head."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError, counted
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES, Kinematics, Side, check_turns, same_design
from vergence.geometry.se3 import angle, check_rigid, inverse, known_poses, mean_pose

_STUCK = 0.1
"""Share of an eye's turn by which poses of a target at rest turn at least: of true poses it is
about one, and less by this much only where the measurement does not follow."""
_AT_REST_RAD = 1e-6
"""Turn of an eye up to which it rests, but for how numbers are rounded."""


def check_target_poses(
    T_cam_target: Mapping[str, Array],
    eye: Array,
    eyes: Mapping[str, Side],
    kinematics: Kinematics,
    placement: np.ndarray,
) -> None:
    views, r = len(eye) if eye.ndim else 0, len(kinematics.readings)
    if not T_cam_target:
        raise VergenceError("There are no poses of a target: T_cam_target names no camera.")
    if eye.shape not in ((views, r), (views, 2, 4, 4)):
        raise VergenceError(
            f"eye is ({views}, {r}) readings, or ({views}, 2, 4, 4) poses of both eyes, found "
            f"{eye.shape}."
        )
    if placement.shape != (views,):
        raise VergenceError(
            f"placement has a number for each of {counted(views, 'view')}, found shape "
            f"{placement.shape}."
        )
    if eye.ndim == 4:
        check_rigid("eye", eye)
    else:
        check_turns(kinematics, eye)
    for name, T in T_cam_target.items():
        if T.shape != (views, 4, 4):
            raise VergenceError(
                f"Poses of a target in {counted(views, 'view')} are ({views}, 4, 4) for each "
                f"camera, found {T.shape} for {name}."
            )
        if eyes.get(name) not in EYES:
            raise VergenceError(f"eyes does not say in which eye {name} sits, left or right.")
        check_rigid(f"T_cam_target of {name}", T)


def check_not_stuck(
    T_cam_target: Mapping[str, Array], eye_poses: Array, eyes: Mapping[str, Side]
) -> None:
    """Raise a VergenceError if poses of a target hardly turn where the eye does."""
    for name, T in T_cam_target.items():
        own = eye_poses[:, EYES.index(eyes[name])]
        known = known_poses(T) & known_poses(own)
        if not known.any():
            continue
        turned, by_eye = (_median_turn(each[known]) for each in (T, own))
        if by_eye > _AT_REST_RAD and turned < _STUCK * by_eye:
            raise VergenceError(
                f"The poses of the target by {name} turn by {np.degrees(turned):.2g} degrees in "
                f"the median, its eye by {np.degrees(by_eye):.2g}: is the measurement stuck, or "
                "does the target move with the eye?"
            )


def _median_turn(T: Array) -> float:
    """Return the median angle [rad] between poses (N, 4, 4) and their mean."""
    return float(np.median(angle((inverse(mean_pose(T)) @ T)[:, :3, :3])))


def check_start(
    start: HeadCalibration,
    T_cam_target: Mapping[str, Array],
    eyes: Mapping[str, Side],
    kinematics: Kinematics | None,
) -> None:
    """Raise a VergenceError if a start is of another head than what was measured."""
    for name in T_cam_target:
        if name not in start.cameras:
            raise VergenceError(
                f"There are poses of a target by {name}; start has the cameras "
                f"{', '.join(start.cameras)}."
            )
        own = start.cameras[name].eye
        if eyes.get(name, own) != own:
            raise VergenceError(f"{name} sits in the {own} eye of start, not in the {eyes[name]}.")
    if kinematics is not None and not (
        kinematics.readings == start.kinematics.readings
        and same_design(kinematics, start.kinematics)
    ):
        raise VergenceError(
            "kinematics and start.kinematics describe different joints or readings; leave "
            "kinematics out."
        )
