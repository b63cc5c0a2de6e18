"""Heads, postures and noise of simulated frames, for self-calibration."""

from dataclasses import replace

import numpy as np

from simulated_head import random_head
from vergence.geometry.head import HeadCalibration
from vergence.self_calibration.prior import initial_state
from vergence.self_calibration.state import FilterState

CAMERAS = ("left_wide", "right_wide")
NOISE_PX = 0.08
JOINT_STD_RAD = np.radians(0.15)


def head_of(seed: int) -> HeadCalibration:
    return random_head(np.random.default_rng(seed), lenses=("wide",))


def begin(head: HeadCalibration) -> FilterState:
    """Return a state that is told the noise of simulated matches, but not that of the readings."""
    return replace(initial_state(head), match_scale=1.0)


def postures(frames: int, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-0.25, 0.25, (frames, 4))
