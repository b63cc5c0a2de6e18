"""How the eyes move in the paper's experiments (Eqs. 22-23): parallel and divergent motion."""

from __future__ import annotations

from typing import Literal

import numpy as np

from vergence.arrays import Array

Motion = Literal["parallel", "divergent"]
AMPLITUDE_RAD = 0.25
PERIOD_S = {"parallel": 6 * np.pi, "divergent": 60 * np.pi}
"""Combined period of all joints: the least common multiple of their periods."""
_SLOWED = {
    "parallel": np.array([1.0, 1.5, 1.0, 1.5]),
    "divergent": np.array([1.0, 1.5, 2.0, 2.5]),
}
"""By what the time is divided in the cosine of each joint."""


def eye_angles(motion: Motion, time_s: Array) -> Array:
    """Return (N, 4) joint angles [rad], in the order of EYE_JOINTS, at (N,) times.

    Parallel: both eyes by Eq. 22. Divergent: the left eye by Eq. 22, the right by Eq. 23.
    """
    return AMPLITUDE_RAD * np.cos(time_s[..., None] / _SLOWED[motion])
