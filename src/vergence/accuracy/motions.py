"""Eye motions of the paper's experiments (Eqs. 22-23): parallel and divergent."""

from __future__ import annotations

from typing import Literal

import numpy as np

from vergence.arrays import Array
from vergence.geometry.kinematics import (
    EYE_JOINTS,
    EYES,
    Kinematics,
    Side,
    least_readings,
    turn_by_readings,
)

Motion = Literal["parallel", "divergent"]
PERIOD_S = {"parallel": 6 * np.pi, "divergent": 60 * np.pi}
"""Combined period of all joints [s]: the least common multiple of their periods."""
_TIME_DIVISORS = {
    "parallel": np.array([1.0, 1.5, 1.0, 1.5]),
    "divergent": np.array([1.0, 1.5, 2.0, 2.5]),
}
"""Divisors of time by joint, in the order of EYE_JOINTS; Eqs. 22-23."""
_ABOUT_YZ = "tilt", "pan"
"""Turns about the second and the third axis of the head."""
SLOWEST_S = {motion: 2 * np.pi * float(each.max()) for motion, each in _TIME_DIVISORS.items()}
"""Period of the slowest joint [s], in which each joint goes through its whole range."""


def eye_angles(motion: Motion, time_s: Array) -> Array:
    """Compute joint angles (..., 4) [rad], in the order of EYE_JOINTS, at times (...,) [s].

    Parallel: both eyes by Eq. 22. Divergent: the left eye by Eq. 22, the right by Eq. 23.
    """
    return 0.25 * np.cos(time_s[..., None] / _TIME_DIVISORS[motion])


def eye_readings(kinematics: Kinematics, motion: Motion, time_s: Array) -> Array:
    """Compute readings (..., r) [rad] that turn eyes by `eye_angles`, or as nearly as they can."""
    angles = eye_angles(motion, time_s)
    if kinematics.readings == EYE_JOINTS:
        return angles / kinematics.gear_ratios
    eyes: list[Side] = [eye for eye in EYES if kinematics.eyes[eye]]
    turns = [angles[..., EYE_JOINTS.index(f"{eye}_{name}")] for eye in eyes for name in _ABOUT_YZ]
    pairs = np.stack(turns, axis=-1)
    by_reading = [turn_by_readings(kinematics.chains[eye])[1:] for eye in eyes]
    return least_readings(np.concatenate(by_reading), pairs)
