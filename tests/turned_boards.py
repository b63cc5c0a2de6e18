"""Boards numbered from the wrong end, and what renumbering makes of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from simulated_recording import BOARD
from vergence.calibration.board_numbering import Renumbered, turn_boards
from vergence.calibration.observations import Observations
from vergence.geometry.board import Chessboard
from vergence.geometry.head import HeadCalibration
from vergence.geometry.se3 import pose, rotation
from vergence.vision.board_pose import seen_corners


@dataclass(frozen=True)
class Count:
    """Of the images of one dataset."""

    images: int
    """That show at least six corners of the board."""
    injected: int
    """Numbered from a wrong end."""
    remaining: int
    """Of these, after renumbering."""
    turned_falsely: int
    """Numbered as most of their placement before, and no more."""
    unclear: int
    """Left as they were, and named."""


def rolled(head: HeadCalibration, rng: np.random.Generator) -> HeadCalibration:
    """Return a head whose cameras are turned by any angle about their axes."""
    cameras = {
        name: replace(
            mounted,
            T_eye_cam=mounted.T_eye_cam @ pose(rotation(np.array([0, 0, rng.uniform(-3.1, 3.1)]))),
        )
        for name, mounted in head.cameras.items()
    }
    return replace(head, cameras=cameras)


def squared(views: Observations) -> Observations:
    """Return views of a square part of the board, of 6 x 6 corners."""
    corners = {
        name: seen.reshape(-1, BOARD.rows, BOARD.columns, 2)[:, :6, :6].reshape(-1, 36, 2)
        for name, seen in views.corners.items()
    }
    return replace(views, board=Chessboard(6, 6, BOARD.square_m), corners=corners)


def flips(count: int, share: float, n: int, rng: np.random.Generator) -> np.ndarray:
    """Return (count,) turns, a share of them not zero."""
    wrong = rng.permutation(count) < round(share * count)
    return np.where(wrong, rng.integers(1, n, count), 0)


def count(views: Observations, injected: dict[str, np.ndarray], found: Renumbered) -> Count:
    """Return what came of a dataset."""
    n = 4 if views.board.columns == views.board.rows else 2
    names = list(injected)
    seen = np.stack([seen_corners(views.corners[name]).sum(axis=1) >= 6 for name in names])
    before = np.stack([injected[name] for name in names])
    after = (before + np.stack([found.turns[name] for name in names])) % n
    unclear = np.stack([found.unclear[name] for name in names])
    total = np.zeros(3, dtype=int)
    for p in np.unique(views.placement):
        here = seen & (views.placement == p)
        if here.any():
            was, is_now = (t[here] != np.bincount(t[here]).argmax() for t in (before, after))
            total += [was.sum(), (is_now & was).sum(), (is_now & ~was).sum()]
    return Count(*(int(number) for number in (seen.sum(), *total, unclear[seen].sum())))


def turned_at_random(views: Observations, rng: np.random.Generator) -> Observations:
    """Turn up to a third of the boards, those of each camera by themselves."""
    V, n = len(views.placement), 4 if views.board.columns == views.board.rows else 2
    turns = {name: flips(V, rng.uniform(1 / V, 1 / 3), n, rng) for name in views.corners}
    return turn_boards(views, turns)
