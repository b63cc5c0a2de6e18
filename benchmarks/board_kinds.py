"""Compare the accuracy of boards of all kinds on the same scenes, in drawn images.

Boards of about the same size stand at the same places before one camera. Printed are the share of
boards and of corners that were found, the errors of corners, and those of the lens that all boards
together give, in the middle of the image, each also relative to the chessboard's.

    python benchmarks/board_kinds.py --views 24
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices; before numpy

import cv2
import numpy as np
import tyro

from drawn_card import WIDE, draw_card, sample_slopes
from vergence.arrays import Array
from vergence.calibration.intrinsics import calibrate_camera
from vergence.calibration.lens_map import reference_pixels, unit_rays, without_turn
from vergence.errors import VergenceError
from vergence.geometry.board import (
    AprilGrid,
    Board,
    Charuco,
    Chessboard,
    CircleGrid,
    corner_points,
    described,
    even_grids,
    marker_family,
    opencv_board,
)
from vergence.geometry.camera import Camera, pinhole, project
from vergence.geometry.se3 import pose, rotation, transform
from vergence.vision.board_detection import detect_board

BOARDS: tuple[Board, ...] = (
    Chessboard(9, 6, 0.03),
    Charuco(10, 7, 0.03, 0.01875, "DICT_4X4_50"),
    CircleGrid(9, 6, 0.03),
    CircleGrid(4, 11, 0.02, asymmetric=True),
    AprilGrid(6, 4, 0.045, 0.045 * 10 / 13),
)
CAMERAS = {"wide": WIDE, "narrow": pinhole(640, 480, 600.0, (0.05, 0.0, 0.0, 0.0, 0.0))}
SQUARE_PX = 65
"""Picture elements along a square: whole ones along markers, gaps and modules."""
MARGIN = 1.0
"""White around the outermost corners [squares]; a chessboard has squares there."""
RADIUS = 0.3
"""Of circles, in the distance of their neighbours."""
BLUR_PX = 0.6
OUTLINE_M = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [0.14, 0.11, 0]
"""(4, 3) about the middle of every board: within the image in all scenes."""


@dataclass(frozen=True, eq=False)
class BoardPicture:
    """What is printed."""

    grey: np.ndarray
    """(h, w) uint8."""
    width_m: float
    middle_m: Array
    """(3,) in frame target."""


def board_picture(board: Board) -> BoardPicture:
    """Draw a board."""
    places = corner_points(board)[:, :2] / board.square_m
    low = places.min(axis=0) - MARGIN - isinstance(board, (Chessboard, Charuco))
    high = places.max(axis=0) + MARGIN + isinstance(board, (Chessboard, Charuco))
    width, height = np.ceil((high - low) * SQUARE_PX).astype(int).tolist()
    white = np.zeros((height, width))
    fine = (np.arange(4) + 0.5) / 4
    for dy in fine:
        for dx in fine:
            x, y = np.meshgrid((np.arange(width) + dx) / SQUARE_PX + low[0],
                               (np.arange(height) + dy) / SQUARE_PX + low[1])  # fmt: skip
            white += _is_white(board, x, y) / 16
    middle = low + np.array([width, height]) / SQUARE_PX / 2
    grey = (20 + 210 * white).round().astype(np.uint8)
    return BoardPicture(
        grey, width / SQUARE_PX * board.square_m, np.append(middle, 0) * board.square_m
    )


def _is_white(board: Board, x: Array, y: Array) -> np.ndarray:
    """Return which places [squares] of a board are white."""
    if isinstance(board, CircleGrid):
        nearest, places = np.inf, corner_points(board)[:, :2] / board.square_m
        for part in even_grids(board):
            own = places[part]
            first, step = own[0, 0], own[1, 1] - own[0, 0]
            last = np.array(part.shape[::-1]) - 1
            at = np.clip(np.round((np.stack([x, y], axis=-1) - first) / step), 0, last)
            away = np.stack([x, y], axis=-1) - first - at * step
            nearest = np.minimum(nearest, np.linalg.norm(away, axis=-1))
        return np.asarray(nearest > RADIUS * (np.sqrt(2) if board.asymmetric else 1))
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    if isinstance(board, AprilGrid):
        side = board.marker_m / board.square_m
        within = (i >= -1) & (j >= -1) & (i < board.tags_x) & (j < board.tags_y)
        joint = within & (x - i > side) & (y - j > side)
        white, family = ~joint, marker_family(board.dictionary)
        modules = family.markerSize + 4
        on_marker = within & (i >= 0) & (j >= 0) & (x - i < side) & (y - j < side)
        numbers = np.arange(board.tags_x * board.tags_y).reshape(board.tags_y, board.tags_x)
        for row, ids in enumerate(numbers[::-1]):
            for column, number in enumerate(ids):
                here = on_marker & (i == column) & (j == row)
                marker = family.generateImageMarker(int(number), modules, borderBits=2)
                a, b = ((each / side * modules).astype(int) for each in (x - i, y - j))
                white[here] = marker[b[here], a[here]] > 0
        return white
    within = (i >= -1) & (j >= -1) & (i < board.columns) & (j < board.rows)
    if isinstance(board, Chessboard):
        return ~(within & ((i + j) % 2 == 0))
    scale = 16  # picture elements a marker's module
    drawn = opencv_board(board).generateImage(
        (board.squares_x * 8 * scale, board.squares_y * 8 * scale)
    )
    a, b = (np.clip((each + 1) * 8 * scale, 0, None).astype(int) for each in (x, y))
    values = drawn[np.minimum(b, drawn.shape[0] - 1), np.minimum(a, drawn.shape[1] - 1)]
    return ~within | (values > 127)


def scenes(
    board: Board, camera: Camera, views: int, seed: int
) -> Iterator[tuple[np.ndarray, Array]]:
    """Draw images of a board before a camera; yield also its true corners (K, 2) [px]."""
    rng, noise = np.random.default_rng(seed), np.random.default_rng(seed + 1)
    picture, slopes = board_picture(board), sample_slopes(camera)
    while views:
        turn = np.append(rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.3, 0.3))
        focal = float(camera.matrix[0, 0])
        z = focal / 280 * rng.uniform(0.3, 0.5)
        x, y = rng.uniform(-1, 1, 2) * [0.25, 0.2] * 280 / focal * z
        T = pose(rotation(turn), np.array([x, y, z]))
        outline = project(camera, transform(T, OUTLINE_M))
        if not ((outline > 0) & (outline < np.array(camera.size) - 1)).all():
            continue
        views -= 1
        corners = project(camera, transform(T, corner_points(board) - picture.middle_m))
        image = draw_card(
            camera, picture.grey, T, picture.width_m, noise=noise, blur_px=BLUR_PX, slopes=slopes
        )
        yield image, corners


def compared(board: Board, camera: Camera, views: int, seed: int = 0) -> tuple[Array, Array]:
    """Return found and true corners (V, K, 2) [px]; NaN where not found."""
    found, true = [], []
    for image, corners in scenes(board, camera, views, seed):
        seen = detect_board(image, board)
        found.append(np.full(corners.shape, np.nan) if seen is None else seen)
        true.append(corners)
    return np.array(found), np.array(true)


def lens_error_px(camera: Camera, corners: Array, points: Array) -> float:
    """Return the rms error, where boards are, of the lens that corners (V, K, 2) [px] give."""
    lens = calibrate_camera(
        corners, points, size=camera.size, lens_model="radial-tangential"
    ).camera
    x, y = (np.linspace(0.15, 0.85, 12) * (side - 1) for side in camera.size)
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    off, there = (
        project(lens, unit_rays(camera, each)) - each for each in (grid, reference_pixels(camera))
    )
    error = without_turn(camera, grid, off[..., None], there[..., None])
    return float(np.sqrt(np.mean(error**2)))


def main(views: int = 24, seeds: int = 3) -> None:
    """Print the accuracy of each board.

    Args:
        views: images of each board.
        seeds: sets of scenes.
    """
    for name, camera in CAMERAS.items():
        usual: Array | None = None
        for board in BOARDS:
            errors, lenses, seen = [], [], []
            for seed in range(seeds):
                found, true = compared(board, camera, views, seed)
                errors.append((found - true).ravel())
                seen.append(np.isfinite(found[..., 0]))
                try:
                    lenses.append(lens_error_px(camera, found, corner_points(board)))
                except VergenceError as error:
                    print(error)
            own = np.array([
                np.sqrt(np.nanmean(np.concatenate(errors) ** 2)),
                np.sqrt(np.mean(np.square(lenses))),
            ])  # fmt: skip
            usual = own if usual is None else usual
            shown = np.concatenate(seen)
            print(
                f"{name}, {described(board)}: {100 * shown.any(axis=1).mean():.0f} % of boards, "
                f"{100 * shown.mean():.0f} % of corners; errors {own[0]:.4f} px ("
                f"{own[0] / usual[0]:.2f}), of the lens {own[1]:.4f} px ({own[1] / usual[1]:.2f})",
                flush=True,
            )


if __name__ == "__main__":
    cv2.setNumThreads(1)
    tyro.cli(main)
