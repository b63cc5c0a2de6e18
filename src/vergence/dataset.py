"""What a head hands out: frames of images and joint readings, real or simulated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array


@dataclass(frozen=True, eq=False)
class Frame:
    """One moment as the software sees it."""

    time_s: float
    """Time stamp of the images."""
    joint_time_s: float
    """Time stamp of the joint readings."""
    eye_angles: Array
    """(4,) readings [rad] in the order of kinematics.EYE_JOINTS."""
    neck_angles: Array
    """(3,) readings [rad] in the order of kinematics.NECK_JOINTS."""
    images: Mapping[str, np.ndarray]
    """By camera: (H, W, 3) uint8, RGB."""
