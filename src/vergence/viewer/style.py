"""How recordings look: colours, sizes and speeds, each in one place."""

from __future__ import annotations

import numpy as np

APPLICATION = "vergence"  # the same for every recording: no dots or slashes

AXIS_COLOURS = {"x": (31, 90, 255), "y": (0, 150, 40), "z": (225, 30, 30)}
"""The paper's: x (depth) blue, y green, z red."""
PALE = {"x": (150, 185, 255), "y": (140, 215, 150), "z": (255, 165, 160)}
PAPER = (150, 150, 150)
JOINT_COLOURS = {
    "left_pan": (230, 120, 20),
    "left_tilt": (240, 190, 90),
    "right_pan": (30, 140, 170),
    "right_tilt": (120, 200, 215),
}
BACKGROUND = (236, 239, 243)
EYE_HEIGHT_M = 1.2
"""Of the model, above the floor; the neck stays straight in the experiments."""
ALPHA = {"object": 0.35}
"""Bodies that one must see through: most estimates lie in the object."""
DETECTED, TRUTH = (255, 230, 0), (0, 240, 255)
ESTIMATE, OLD, RAY, OBJECT = (20, 60, 220), (120, 150, 235), (250, 150, 30), (60, 60, 60)
CROSS_PX = np.array([[[-9.0, 0.0], [9.0, 0.0]], [[0.0, -9.0], [0.0, 9.0]]])
RING_PX = 20.0
FRUSTUM_WIDTH_M = 0.095
"""An image is drawn before its camera at the distance at which it is so wide."""
JPEG_QUALITY = 40
"""Sensor noise inflates JPEG: 24 kB for a 640 x 480 image with noise of 3 grey levels, and 54 kB
at 85, for no more to see."""
TRAIL_S = 10.0
"""How long an estimate stays bright."""
SPEED = 3.0
"""Playback, in recorded seconds a second: the eyes' period of 2 pi s is slow to watch."""
NECK_COLOURS = {
    "neck_pitch": (150, 60, 160),
    "neck_roll": (110, 110, 110),
    "neck_yaw": (40, 120, 60),
}
HEAD_JOINT_COLOURS = NECK_COLOURS | JOINT_COLOURS
STATE_COLOURS = {
    "saccade": (230, 120, 20),
    "pursuit": (31, 90, 255),
    "fixation": (0, 150, 40),
    "lost": (200, 30, 60),
}
AIM, HAND = (255, 255, 255, 110), (170, 40, 150)
AXIS_M = 1.0
"""How long a narrow camera's axis is drawn, while nobody knows how far the object is."""
GAZE_TRAIL_S = 4.0
