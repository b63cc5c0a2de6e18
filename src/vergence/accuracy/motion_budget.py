"""Error budget over a named motion: parallel, divergent, or the recorded motion of a dataset."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vergence.accuracy.budget import Budget, Source, budget
from vergence.accuracy.motions import PERIOD_S, eye_angles
from vergence.arrays import Array
from vergence.data.reader import load_dataset
from vergence.data.stereo_rows import check_readings_match
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration, pixel_stds, reading_stds, states_covariance
from vergence.geometry.kinematics import EYE_JOINTS

SAMPLES = 400
"""Samples of a motion; budgets of more samples differ by less than a printed digit."""


@dataclass(frozen=True, eq=False)
class MotionBudgets:
    """Budgets of K points in one motion, and in parallel motion for comparison."""

    motion: str
    budgets: list[Budget]
    parallel: list[Budget] | None
    """None for a head whose readings are not pan and tilt of each eye."""


def stated_sources(head: HeadCalibration, pixel_std_px: float | None) -> list[Source]:
    """Collect the noise that a calibration states; `pixel_std_px` replaces that of pixels."""
    pixels = pixel_stds(head, None) if pixel_std_px is None else pixel_std_px
    joints = reading_stds(head)
    sources = [Source("pixel noise", pixel_std_px=pixels)] if np.any(pixels) else []
    return sources + [Source("joint noise", joint_std_rad=joints)] * bool(joints.any())


def motion_budgets(
    head: HeadCalibration, points: Array, *, motion: str, sources: Sequence[Source]
) -> MotionBudgets:
    """Compute the budgets of points (K, 3) [m], given in the left eye's base frame.

    Args:
        head: its stated covariance is a source of errors, too.
        points: (K, 3) [m].
        motion: parallel, divergent, or the folder of a dataset.
        sources: further errors.

    Raises:
        VergenceError: there is no source, a point is not seen, the motion does not exist for this
            head, or the head was calibrated with measured poses.
    """
    if head.accuracy is not None and head.accuracy.eye_motion == "poses":
        raise VergenceError(
            "A budget says what errors of joint readings add; this head was calibrated with "
            "measured eye poses."
        )
    if not sources and not states_covariance(head):
        raise VergenceError(
            "A budget needs sources of errors: give a calibration that states its accuracy, an "
            "error profile (--profile paper), or --noise in pixels."
        )
    names = dict.fromkeys((motion, "parallel"))
    if (readings := head.kinematics.readings) != EYE_JOINTS:
        if motion in PERIOD_S:
            raise VergenceError(
                f"The motion {motion!r} is of the readings {', '.join(EYE_JOINTS)}; this head has "
                f"{', '.join(readings)}. Give the folder of a dataset of this head as --motion."
            )
        del names["parallel"]
    found: dict[str, list[Budget]] = {}
    for name in names:
        joints, rates = motion_of(name, head)
        found[name] = budget(head, points, joints=joints, rates=rates, sources=sources)
    return MotionBudgets(motion, found[motion], found.get("parallel"))


def motion_of(name: str, head: HeadCalibration) -> tuple[Array, Array]:
    """Make the readings (T, r) [rad] of a motion and their rates (T, r) [rad/s].

    VergenceError if the motion or dataset does not exist, or has other readings than the head.
    """
    if name in PERIOD_S:
        time_s = np.arange(SAMPLES) * PERIOD_S[name] / SAMPLES
        turns = eye_angles("parallel" if name == "parallel" else "divergent", time_s)
        readings = turns / head.kinematics.factors
        return readings, np.gradient(readings, time_s, axis=0)
    if not os.path.isdir(name):
        raise VergenceError(
            f"There is no motion {name!r}; there are parallel, divergent, and the folders of "
            "datasets."
        )
    data = load_dataset(name)
    if data.T_base_eye is not None or len(data.eye_angles) < 2:
        raise VergenceError(f"A motion needs two or more rows of joint readings; {name} has none.")
    check_readings_match(data, head)
    rates = np.gradient(data.eye_angles, data.joint_time_s, axis=0)
    step = -(-len(rates) // (4 * SAMPLES))
    return data.eye_angles[::step], np.where(data.moving[:, None], rates, 0.0)[::step]
