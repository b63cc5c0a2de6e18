"""Find the inner corners of a calibration board in an image."""

from __future__ import annotations

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.geometry.board import Board, Charuco, Chessboard, corner_points, opencv_board
from vergence.vision.corner_refinement import HALF_WIDTH_PX, clearances, quadrants, refine_grid

CLEAR = 0.6
"""A corner is sought along its edges to this part of the way to the nearest other edge. On rendered
boards further was better, from 0.3 to 0.6; blurred edges are wide, so it stays there."""
LEAST_CLEAR_PX = 4
"""Corners whose neighbours' edges are nearer err by 0.05 px and more, and all towards one side."""
BLUR_PX = 1.2
"""So near to an edge its blur is felt. On rendered boards 0.8 to 1.5 err alike."""
LEAST_HALF_WIDTH_PX = 0.8
"""Of the strips in which a ChArUco corner is sought, however near the markers are."""
LARGE_PX = 1_500_000
"""Images of more pixels are not enlarged before markers are looked for."""


def detect_board(image: np.ndarray, board: Board) -> Array | None:
    """Return the inner corners (rows * columns, 2) [px] in the order of corner_points.

    Corners that were not seen are NaN. Of a ChArUco board a part is enough. A chessboard is found
    as a whole, but for single corners that are no clear saddles; one whose corner counts differ
    in parity looks different from its two ends, and is numbered so that the square outside the
    first corner is black; others keep the order in which OpenCV found them, which may be turned
    by 180 degrees.

    Args:
        image: (H, W) or (H, W, 3) uint8, RGB.
        board: what to look for.

    Returns:
        The corners, or None where no board was found.
    """
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    if isinstance(board, Charuco):
        return _find_charuco(grey, board)
    return _find_chessboard(grey, board)


def _find_chessboard(grey: np.ndarray, board: Chessboard) -> Array | None:
    size = (board.columns, board.rows)
    # First without CALIB_CB_ACCURACY, which takes three times as long and errs by more than a
    # pixel at a few corners of boards that lean, but finds boards that are lost without it.
    found, corners = cv2.findChessboardCornersSB(grey, size, flags=0)
    if not found:
        found, corners = cv2.findChessboardCornersSB(grey, size, flags=cv2.CALIB_CB_ACCURACY)
    if not found or corners is None:
        return None
    corners = corners.reshape(-1, 2).astype(float)
    if (board.columns + board.rows) % 2 and _first_square_is_white(grey, corners, board):
        corners = corners[::-1]
    grid = corners.reshape(board.rows, board.columns, 2)
    clear = clearances(grid)
    grid = np.where(clear[..., None] < LEAST_CLEAR_PX, np.nan, grid)
    grid = refine_grid(grey, grid, CLEAR * clear)
    rim = grid[0], grid[-1], grid[:, 0], grid[:, -1]
    if any(np.isnan(line).all() for line in rim):
        return None  # the board's own rim was taken for a row, as its other end is out of sight
    return grid.reshape(-1, 2)


def _find_charuco(grey: np.ndarray, board: Charuco) -> Array | None:
    parameters = cv2.aruco.CharucoParameters()
    parameters.minMarkers = 1  # beside a corner; what is not a saddle is thrown out below
    parameters.tryRefineMarkers = True
    detector = cv2.aruco.CharucoDetector(opencv_board(board), parameters)
    # Markers of 15 px, as in a wide image at arm's length, are read twice as often when enlarged.
    scale = 2 if grey.size < LARGE_PX else 1
    large = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    found, numbers, _, _ = detector.detectBoard(large)
    if found is None or numbers is None or not len(numbers):
        return None
    corners = np.full((board.rows * board.columns, 2), np.nan)
    seen = np.asarray(numbers, dtype=int).ravel()
    corners[seen] = (np.reshape(found, (-1, 2)) + 0.5) / scale - 0.5
    grid = corners.reshape(board.rows, board.columns, 2)
    shortest = _shortest_diagonals(grid)
    if not np.isfinite(shortest).any():
        return None
    grid[~np.isfinite(shortest)] = np.nan  # without neighbours its scale is not known
    # Inside the white between an edge and the markers, and clear of the blur of both.
    margin = (1 - board.marker_m / board.square_m) / 2
    clear = clearances(grid)
    half_widths = np.clip(margin * clear - BLUR_PX, LEAST_HALF_WIDTH_PX, HALF_WIDTH_PX)
    corners = refine_grid(grey, grid, CLEAR * clear, half_widths).reshape(-1, 2)
    _drop_misplaced(corners, corner_points(board)[:, :2], 0.3 * float(np.nanmedian(shortest)))
    return corners if np.isfinite(corners).any() else None


def _shortest_diagonals(grid: Array) -> Array:
    """Return (rows, columns) of corners (rows, columns, 2): shortest diagonal of its squares [px].

    NaN for a corner without neighbours both along its row and along its column.
    """
    diagonals = [
        np.linalg.norm(along + sign * across, axis=-1)
        for along, across in quadrants(grid)
        for sign in (-1, 1)
    ]
    return np.asarray(np.fmin.reduce(diagonals))


def _drop_misplaced(corners: Array, points: Array, tolerance_px: float) -> None:
    """Set to NaN the corners (K, 2) of markers that were misread: not where the others say.

    The tolerance leaves room for what the lens bends.
    """
    seen = np.flatnonzero(np.isfinite(corners[:, 0]))
    if len(seen) < 6:  # too few to tell the odd one out
        return
    _, inside = cv2.findHomography(points[seen], corners[seen], cv2.RANSAC, tolerance_px)
    if inside is not None:
        corners[seen[~np.asarray(inside, dtype=bool).ravel()]] = np.nan


def _first_square_is_white(grey: np.ndarray, corners: Array, board: Chessboard) -> bool:
    """Compare the mean grey of the squares that share the first square's colour with the rest."""
    grid = corners.reshape(board.rows, board.columns, 2)
    centres = (grid[:-1, :-1] + grid[:-1, 1:] + grid[1:, :-1] + grid[1:, 1:]) / 4
    column, row = np.round(centres).astype(int).transpose(2, 0, 1)
    values = grey[row, column].astype(float)
    j, i = np.indices(values.shape)
    like_first = (i + j) % 2 == 0  # the square inside the first corner is like the one outside
    return bool(values[like_first].mean() > values[~like_first].mean())
