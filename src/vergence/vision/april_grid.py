"""Detect grids of AprilTags: OpenCV reads the markers, and their corners are refined as saddles.

The corner of a marker touches that of a small black square, which makes it the crossing of two
edges. Markers are placed by their numbers, whatever their families call the upper side of one.
"""

from __future__ import annotations

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.geometry.board import AprilGrid, corner_points, marker_family
from vergence.vision.corner_refinement import edge_distances, refine_corners, smooth_map

BORDERS = 2, 1
"""Widths of a marker's black frame [modules]: Kalibr's, and OpenCV's."""
LEAST_MARKERS = 3
"""Fewest markers of a grid: with fewer a marker that was misread would not show."""
HALF_WIDTH_PX = 0.8
"""Half width of the strips along the edges [px]: wider ones reach the blur of the frame's inner
edge. On drawn grids the errors are 0.7 times those with 2 px."""
LENGTHEN = 1.25
"""Length of the last strips, relative to those of a chessboard, whose next edges are as dark: half
the gap. On drawn grids the errors are 0.87 times those with 1; with 1.5 the largest double."""
ROUNDS = 3
"""Rounds of refinement and of continuing the grid to markers that were not read."""
STRAY_PX, LEAST_AROUND = 1.0, 5
"""Distance from the smooth map from which a corner is stray, and known corners within 1.5 squares
from which the map is continued to another one."""
STRAY = 5.0
"""Distance of a refined corner from the smooth map, in the median one, from which it is stray."""
FAR = 0.25
"""Largest distance of a marker's corner from its place by all markers, in sides of the marker."""


def read_grid_markers(grey: np.ndarray, board: AprilGrid) -> tuple[Array, np.ndarray]:
    """Read the markers of a board in an image (H, W): corners (N, 4, 2) [px], numbers (N,)."""
    best: tuple[Array, np.ndarray] = np.zeros((0, 4, 2)), np.zeros(0, int)
    for border in BORDERS:
        parameters = cv2.aruco.DetectorParameters()
        parameters.markerBorderBits = border
        finder = cv2.aruco.ArucoDetector(marker_family(board.dictionary), parameters)
        quads, ids, _ = finder.detectMarkers(grey)
        numbers = np.empty(0, int) if ids is None else np.asarray(ids, int).ravel()
        own = np.isin(numbers, board.ids)
        if own.sum() > len(best[1]):
            best = np.reshape(quads, (-1, 4, 2)).astype(float)[own], numbers[own]
    return best


def detect_april_grid(
    large: np.ndarray, scale: int, grey: np.ndarray, board: AprilGrid
) -> Array | None:
    """Locate the corners (rows * columns, 2) [px] of a grid in an image (H, W); NaN: not found.

    The markers are read in an image that is `scale` times as large. None: too few are there, or
    their order is not that of the board.
    """
    quads, numbers = read_grid_markers(large, board)
    quads = (quads + 0.5) / scale - 0.5
    placed = _placed(quads, numbers, board)
    if placed is None:
        return None
    grid, places = placed
    for _ in range(ROUNDS):
        distances = edge_distances(grid)
        grid[np.isnan(distances)] = np.nan
        grid = refine_corners(grey, grid, distances, HALF_WIDTH_PX, places)
        grid = _continued(grid, places)
    grid = refine_corners(grey, grid, LENGTHEN * edge_distances(grid), HALF_WIDTH_PX, places)
    flat, at = grid.reshape(-1, 2), places.reshape(-1, 2)
    off = np.linalg.norm(flat - smooth_map(at, flat, at), axis=1)
    seen = off < STRAY * np.nanmedian(off) if np.isfinite(off).any() else np.isfinite(off)
    return np.where(seen[:, None], flat, np.nan) if seen.any() else None


def _continued(grid: Array, places: Array) -> Array:
    """Put corners (rows, columns, 2) where a smooth map of those that are known has them.

    Corners that are far from it, and those with few known ones around, are NaN.
    """
    flat, at = grid.reshape(-1, 2), places.reshape(-1, 2)
    near = np.linalg.norm(at[:, None] - at, axis=2) < 1.5
    for _ in range(2):
        mapped = smooth_map(at, flat, at)
        far = np.linalg.norm(flat - mapped, axis=1) > STRAY_PX
        flat = np.where(far[:, None], np.nan, flat)
    known = np.isfinite(flat[:, 0])
    enough = np.count_nonzero(near & known, axis=1) >= LEAST_AROUND
    return np.where(enough[:, None], mapped, np.nan).reshape(grid.shape)


def _placed(quads: Array, numbers: np.ndarray, board: AprilGrid) -> tuple[Array, Array] | None:
    """Put the corners (N, 4, 2) of markers in a grid (rows, columns, 2); also return its places.

    None: the markers do not lie as the board's, seen from its front.
    """
    shape = board.rows, board.columns
    places = corner_points(board)[:, :2].reshape(*shape, 2) / board.square_m
    if len(numbers) < LEAST_MARKERS:
        return None
    row, column = np.argwhere(board.ids == numbers[:, None, None])[:, 1:].T
    of_markers = np.stack(
        [places[2 * row + b, 2 * column + a] for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))], axis=1
    )
    centres = of_markers.mean(axis=1), quads.mean(axis=1)
    # Corners are given in the order of the marker's own upper side, here unknown: four turns.
    away = quads - centres[1][:, None]
    best, least = None, np.inf
    for turn in range(4):
        turned = np.roll(quads, turn, axis=1)
        H, inside = cv2.findHomography(
            of_markers.reshape(-1, 2), turned.reshape(-1, 2), cv2.RANSAC, FAR * _side(away)
        )
        lost = np.inf if H is None else float((inside == 0).mean())
        if lost < least:
            best, least = (turned, inside.reshape(-1, 4).astype(bool).all(axis=1)), lost
    if best is None or best[1].sum() < max(LEAST_MARKERS, len(numbers) / 2):
        return None
    turned, good = best
    grid = np.full((*shape, 2), np.nan)
    for k, (a, b) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
        grid[2 * row[good] + b, 2 * column[good] + a] = turned[good, k]
    return grid, places


def _side(away: Array) -> float:
    """Compute the median side [px] of markers, by their corners (N, 4, 2) from the centres."""
    return float(np.median(np.linalg.norm(away, axis=2)) * np.sqrt(2))
