"""Postures and limits of the tests' head: a neck of three joints, pan and tilt of each eye."""

from __future__ import annotations

import numpy as np

from vergence.gaze.commands import JointLimits
from vergence.geometry.kinematics import EYE_JOINTS

NECK_JOINTS = "neck_pitch", "neck_roll", "neck_yaw"
HEAD_JOINTS = (*NECK_JOINTS, *EYE_JOINTS)
NECK, EYE_READINGS = slice(0, 3), slice(3, None)
LIMITS = JointLimits(
    np.radians([(-30, 40), (-30, 30), (-50, 50), (-35, 35), (-30, 30), (-35, 35), (-30, 30)]),
    np.array([3.0] * 3 + [10.0] * 4),
    HEAD_JOINTS,
)
