"""Boards numbered from the wrong end: are all found, and is none turned that should not be?

    python benchmarks/board_flips.py
    python benchmarks/board_flips.py --datasets 300 --seed 1

Each dataset draws a head with its own lenses, gains to 4 % and mountings (every other one with
cameras rolled by any angle), 4 to 18 boards at straight gaze, boards for the narrow cameras, one to
three boards at rest before moving eyes, a tenth of the images without a board, joint noise to 0.3
degrees, pixel noise to 0.3 px, and boards numbered from the wrong end in up to a third of the
views: in all images of a view, or image by image. Every fourth board is square, and may be turned
by any quarter. `number_alike` is given the corners, the readings, and the poses of the boards by
the lenses that Zhang's method finds.

A placement of which all images are turned alike is right: nothing but the pose of the board depends
on it. So an image that differs from most others of its placement counts as wrong. Exits with 1 if
an image stays wrong or is turned without need.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace

import numpy as np
import tyro
from rich.progress import track

from simulated_head import random_head
from simulated_recording import BOARD, Noise, joined, still_recording
from vergence.calibration.checks.board_flips import Renumbered, number_alike, turn_boards
from vergence.calibration.intrinsics import calibrate_intrinsics
from vergence.calibration.observations import Observations
from vergence.geometry.board import Chessboard, corner_points
from vergence.geometry.head import HeadCalibration
from vergence.geometry.se3 import pose, rotation
from vergence.vision.board_pose import board_poses, seen_corners


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


def simulate(number: int, seed: int) -> tuple[Observations, dict[str, np.ndarray]]:
    """Return views, and by camera (V,) by how much their boards are turned."""
    rng = np.random.default_rng([seed, number])
    head = random_head(rng)
    if number % 2:
        head = rolled(head, rng)
    noise = Noise(rng.uniform(0.03, 0.3), np.radians(rng.uniform(0, 0.3)))
    parts = [
        still_recording(
            head,
            rng,
            noise,
            wide_views=int(rng.integers(4, 19)) if k == 0 else 0,
            narrow_views=int(rng.integers(4, 9)) if k == 0 else 0,
            orientations=int(rng.integers(8, 41)),
            spread_rad=rng.uniform(0.15, 0.3),
        )
        for k in range(rng.integers(1, 4))
    ]
    views = joined(parts)
    if number % 4 == 3:
        views = squared(views)
    n = 4 if views.board.columns == views.board.rows else 2
    V = len(views.placement)
    share, together = rng.uniform(0, 1 / 3), rng.random() < 0.5
    common = flips(V, share, n, rng)
    turns, corners = {}, {}
    for name, seen in views.corners.items():
        turns[name] = common if together else flips(V, share, n, rng)
        # Zhang's method needs some views of each camera.
        spared = np.isfinite(seen).all(axis=(1, 2)).cumsum() <= 4
        lost = (rng.random(V) < 0.1) & ~spared
        corners[name] = np.where(lost[:, None, None], np.nan, seen)
    return turn_boards(replace(views, corners=corners), turns), turns


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


def run(number: int, seed: int) -> tuple[Count, float]:
    """Return what came of one dataset, and the time of number_alike [s]."""
    views, injected = simulate(number, seed)
    points = corner_points(views.board)
    poses = {
        name: board_poses(each.camera, views.corners[name], points)
        for name, each in calibrate_intrinsics(views).items()
    }
    start = time.perf_counter()
    found = number_alike(views, poses)
    return count(views, injected, found), time.perf_counter() - start


def main(datasets: int = 100, seed: int = 0) -> int:
    """Run all datasets, print the counts, and return 1 if an image is wrong."""
    results = [run(k, seed) for k in track(range(datasets), "datasets")]
    table = np.array([[*vars(counted).values()] for counted, _ in results])
    images, injected, remaining, falsely, unclear = table.sum(axis=0)
    print(f"{datasets} datasets, seed {seed}: {images} images of boards")
    print(f"numbered from a wrong end: {injected}; renumbered: {injected - remaining}")
    print(f"turned falsely: {falsely}; unclear, left and named: {unclear}")
    print(f"datasets all right: {np.count_nonzero(table[:, 2:4].sum(axis=1) == 0)}")
    print(f"time of renumbering a dataset: {np.mean([each for _, each in results]):.2f} s")
    for number in np.flatnonzero(table[:, 2:].any(axis=1)):
        print(f"dataset {number}: {results[number][0]}")
    return int(remaining + falsely > 0)


if __name__ == "__main__":
    sys.exit(tyro.cli(main, description=__doc__))
