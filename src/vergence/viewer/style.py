"""Colours, sizes and speeds of recordings and pictures, each stated once."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import cycle

import numpy as np

APPLICATION = "vergence"  # the same for every recording: no dots or slashes

AXIS_COLOURS = {"x": (31, 90, 255), "y": (0, 150, 40), "z": (225, 30, 30)}
"""The paper's: x (depth) blue, y green, z red."""
PAPER = (150, 150, 150)
"""Values that the paper states, and estimates from a single frame."""
EYE_COLOURS = {"left": ((230, 120, 20), (240, 190, 90)), "right": ((30, 140, 170), (120, 200, 215))}
"""Strong and light; of a joint: pan and tilt."""
JOINT_COLOURS = {
    f"{eye}_{joint}": colour
    for eye, colours in EYE_COLOURS.items()
    for joint, colour in zip(("pan", "tilt"), colours, strict=True)
}
"""Colours of the usual joints of the eyes, by name."""
BACKGROUND = (236, 239, 243)
"""Behind 3-D views: a light grey."""
EYE_HEIGHT_M = 1.2
"""Height of the eyes above the floor; the neck stays straight in the experiments."""
FITTING, MISFIT = (60, 220, 90), (240, 60, 60)
"""Matches between the images of both eyes."""
DETECTED, TRUTH = (255, 230, 0), (0, 240, 255)
"""Marks in images: what was detected, and where the twin has it."""
ESTIMATE, OLD, RAY, OBJECT = (20, 60, 220), (120, 150, 235), (250, 150, 30), (60, 60, 60)
"""Located points, and earlier ones; lines of sight and residuals; outlines of
objects and boards."""
CROSS_PX = np.array([[[-9.0, 0.0], [9.0, 0.0]], [[0.0, -9.0], [0.0, 9.0]]])
"""(2, 2, 2): the lines of a mark around a detected pixel [px], which fit into the ring of the
truth."""
NECK_COLOURS = (150, 60, 160), (110, 110, 110), (40, 120, 60)
"""Colours of a neck's joints in their order, repeated beyond three."""
STATE_COLOURS = {
    "saccade": (230, 120, 20),
    "pursuit": (31, 90, 255),
    "fixation": (0, 150, 40),
    "lost": (200, 30, 60),
}
"""Colours by state of the gaze."""
AIM, HAND = (255, 255, 255, 110), (170, 40, 150)
"""Where a camera is to have the target; the hand that reaches."""
MAGNIFICATION = 100
"""Drawn length of a residual over its own: usual residuals of 0.1 px are seen."""


def joint_colours(joints: Sequence[str], neck: Collection[str]) -> dict[str, tuple[int, int, int]]:
    """Assign colours to joints of a posture by name: those of its neck, and of its readings."""
    necks, others = cycle(NECK_COLOURS), cycle(JOINT_COLOURS.values())
    return {
        name: next(necks) if name in neck else JOINT_COLOURS.get(name) or next(others)
        for name in joints
    }


def html(rgb: tuple[int, int, int]) -> str:
    """Format a colour for matplotlib, such as #1f5aff."""
    return "#{:02x}{:02x}{:02x}".format(*rgb)


def pale(rgb: tuple[int, int, int]) -> tuple[int, int, int]:
    """Mix a colour with white."""
    r, g, b = (round(0.45 * level + 0.55 * 255) for level in rgb)
    return r, g, b


PALE = {axis: pale(colour) for axis, colour in AXIS_COLOURS.items()}
