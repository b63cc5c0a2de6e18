"""Follow the board from frame to frame, and notice when it and the eyes stand still."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.geometry.board import Board
from vergence.vision.board_detection import detect_board
from vergence.vision.board_pose import LEAST_CORNERS, seen_corners

WATCHED_PX = 640
"""Width to which larger images are shrunk while nothing is kept [px]: a pair of them takes 30 to 70
ms of processor time with a board, by its kind, and 10 to 25 ms without."""
STILL_RAD = 0.03
"""Change of a reading that counts as motion [rad]: three times the noise of hobby servos, 0.4
degrees, in each of two readings. The corners show smaller motions."""
STILL_PER_WIDTH = 1 / 500
"""Largest distance of corners from where they came to rest, in image widths: the eyes' noise, and
that of a hand that is held still."""

Detect = Callable[[Frame, Board, float], Mapping[str, Array]]
"""Finds the corners (K, 2) [px] of a board, NaN where not seen, by each camera that sees it.
Larger images may be shrunk to a width [px]."""


@dataclass(frozen=True, eq=False)
class Watched:
    """Where the board was in the latest frame, and since when nothing has moved."""

    corners: Mapping[str, Array] = field(default_factory=dict)
    """By camera that sees the board (K, 2) [px]."""
    anchor: Mapping[str, Array] = field(default_factory=dict)
    """Where the corners came to rest."""
    readings: Array = field(default_factory=lambda: np.zeros(0))
    """(j,) of neck and eyes at that moment."""
    time_s: float = -np.inf
    since_s: float = np.inf
    """Time of that moment."""

    @property
    def still_s(self) -> float:
        """How long board and eyes have stood still [s]."""
        return max(0.0, self.time_s - self.since_s)


def watch(before: Watched, frame: Frame, corners: Mapping[str, Array]) -> Watched:
    """Compare the corners in a frame with those of the moment since which nothing has moved."""
    readings = np.concatenate([frame.neck_angles, frame.eye_angles])
    still = bool(corners) and any(name in before.anchor for name in corners)
    still = still and readings.shape == before.readings.shape
    still = still and bool((np.abs(readings - before.readings) < STILL_RAD).all())
    for name in corners.keys() & before.anchor.keys():
        moved_px = np.linalg.norm(corners[name] - before.anchor[name], axis=1)
        moved_px = moved_px[np.isfinite(moved_px)]
        width = frame.images[name].shape[1] if name in frame.images else WATCHED_PX
        still = still and len(moved_px) > 0 and np.median(moved_px) < STILL_PER_WIDTH * width
    if not still:
        return Watched(corners, corners, readings, frame.time_s, frame.time_s)
    return Watched(corners, before.anchor, before.readings, frame.time_s, before.since_s)


def find_board(frame: Frame, board: Board, width_px: float) -> dict[str, Array]:
    """Find the board in the images of a frame, quickly: see `Detect`; a few boards are missed."""
    found = {}
    for name, image in frame.images.items():
        scale = min(1.0, width_px / image.shape[1])
        if scale < 1:
            image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        corners = detect_board(image, board, thorough=False)
        if corners is not None and seen_corners(corners).sum() >= LEAST_CORNERS:
            found[name] = (corners + 0.5) / scale - 0.5
    return found
