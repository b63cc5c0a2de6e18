"""Eye motions of the paper's experiments (Eqs. 22-23): parallel and divergent."""

from __future__ import annotations

from typing import Literal

import numpy as np

from vergence.arrays import Array

Motion = Literal["parallel", "divergent"]
PERIOD_S = {"parallel": 6 * np.pi, "divergent": 60 * np.pi}
"""Combined period of all joints [s]: the least common multiple of their periods."""
_TIME_DIVISORS = {
    "parallel": np.array([1.0, 1.5, 1.0, 1.5]),
    "divergent": np.array([1.0, 1.5, 2.0, 2.5]),
}
"""Divisors of time by joint, in the order of EYE_JOINTS; Eqs. 22-23."""
SLOWEST_S = {motion: 2 * np.pi * float(each.max()) for motion, each in _TIME_DIVISORS.items()}
"""Period of the slowest joint [s], in which each joint goes through its whole range."""


def eye_angles(motion: Motion, time_s: Array) -> Array:
    """Compute joint angles (..., 4) [rad], in the order of EYE_JOINTS, at times (...,) [s].

    Parallel: both eyes by Eq. 22. Divergent: the left eye by Eq. 22, the right by Eq. 23.
    """
    return 0.25 * np.cos(time_s[..., None] / _TIME_DIVISORS[motion])
