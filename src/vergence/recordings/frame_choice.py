"""Choose the frames of a recording that a calibration can use: at rest, and in motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.recordings.moments import Moments
from vergence.recordings.recording_map import FrameChoice


@dataclass(frozen=True, eq=False)
class ChosenFrames:
    """F frames of a recording, in order of time."""

    rows: np.ndarray
    """(F,) of int: which moments."""
    moving: np.ndarray
    """(F,) of bool: whether the eyes moved."""


def choose_frames(moments: Moments, stated: FrameChoice) -> ChosenFrames:
    """Choose one frame of each stretch at rest, and stretches in which the eyes move.

    What `stated` has is taken from there.
    """
    rows = np.arange(len(moments))  # a stand-in
    return ChosenFrames(rows, np.zeros(len(rows), bool))
