"""Detect grids of AprilTags: OpenCV reads the markers, and their corners are refined as saddles.

The corner of a marker touches that of a small black square, which makes it the crossing of two
edges. Corners are sought where a smooth map of the board puts them, so that neither the upper side
of a marker nor every marker has to be read.
"""

from __future__ import annotations

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.geometry.board import AprilGrid, corner_points
from vergence.vision.corner_refinement import edge_distances, refine_corners, smooth_map
from vergence.vision.marker_layout import read_markers

BORDER = 2
"""Width of a marker's black frame [modules]: Kalibr's; that of OpenCV is 1."""
HALF_WIDTH_PX = 0.8
"""Half width of the strips along the edges [px]: wider ones reach the blur of the frame's inner
edge. On drawn grids the errors are 0.7 times those with 2 px."""
LENGTHEN = 1.25
"""Length of the strips, relative to those of a chessboard, whose next edges are as dark: half the
gap. On drawn grids the errors are 0.87 times those with 1; with 1.5 the largest double."""
ROUNDS = 3
"""Rounds of the map and of refinement, in which the grid grows to markers that were not read."""
LEAST_MARKERS, LEAST_AROUND = 4, 5
"""Fewest markers that determine a homography, and known corners within 1.5 squares from which the
map is continued to another one."""
STRAY = 5.0
"""Distance of a corner from the map, in the median one, from which it is stray."""


def detect_april_grid(
    large: np.ndarray, scale: int, grey: np.ndarray, board: AprilGrid
) -> Array | None:
    """Locate the corners (rows * columns, 2) [px] of a grid in an image (H, W); NaN: not found.

    The markers are read in an image that is `scale` times as large. None: too few are there, or
    they do not lie as the board's, seen from its front.
    """
    read, numbers = read_markers(large, board.dictionary, border=BORDER)
    on_board = numbers < board.tags_x * board.tags_y
    if on_board.sum() < LEAST_MARKERS:
        return None
    quads, numbers = (np.array(read)[on_board] + 0.5) / scale - 0.5, numbers[on_board]
    shape = board.rows, board.columns
    at = corner_points(board)[:, :2] / board.square_m
    # Half a marker allows for the lens, and not for markers that were misread.
    side = float(np.median(np.linalg.norm(np.diff(quads, axis=1), axis=2)))
    column, row = numbers % board.tags_x, board.tags_y - 1 - numbers // board.tags_x
    down, along = 2 * row[:, None] + [0, 0, 1, 1], 2 * column[:, None] + [0, 1, 1, 0]
    index = (board.columns * down + along).astype(np.intp)
    H, kept = cv2.findHomography(at[index].mean(axis=1), quads.mean(axis=1), cv2.RANSAC, side / 2)
    if H is None or kept.sum() < LEAST_MARKERS or np.linalg.det(H) * H[2, 2] <= 0:
        return None  # also if they are seen from behind, or in another order
    expected, corners = cv2.perspectiveTransform(at[None], H)[0], np.full(at.shape, np.nan)
    for numbers, quad in zip(index[kept.ravel() > 0], quads[kept.ravel() > 0], strict=True):
        turned = [np.roll(quad, k, axis=0) for k in range(4)]
        errors_px = [np.linalg.norm(way - expected[numbers], axis=1).max() for way in turned]
        if min(errors_px) < side / 2:
            corners[numbers] = turned[int(np.argmin(errors_px))]
    near = np.linalg.norm(at[:, None] - at, axis=2) < 1.5
    for _ in range(ROUNDS):
        mapped = smooth_map(at, corners, at)
        known = np.count_nonzero(near & np.isfinite(corners[:, 0]), axis=1) >= LEAST_AROUND
        known &= np.linalg.norm(mapped - expected, axis=1) < side / 2
        grid = np.where(known[:, None], mapped, np.nan).reshape(*shape, 2)
        lengths = LENGTHEN * edge_distances(grid)
        grid[np.isnan(lengths)] = np.nan
        corners = refine_corners(grey, grid, lengths, HALF_WIDTH_PX, at.reshape(grid.shape))
        corners = corners.reshape(-1, 2)
        for _ in range(ROUNDS):
            errors_px = np.linalg.norm(corners - smooth_map(at, corners, at), axis=1)
            if not np.isfinite(errors_px).any():
                return None
            corners[~(errors_px < STRAY * np.nanmedian(errors_px))] = np.nan
    return corners
