"""Detect grids of circles: OpenCV finds the spots, whose centres are those of their grey levels.

The centre of the image of a circle is not the image of its centre: slant and lens move it by up to
a tenth of its radius. A smooth map of the board, fitted to all spots, gives the outline of each
spot in the image, and the difference of the two is removed.
"""

from __future__ import annotations

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.geometry.board import CircleGrid, corner_points
from vergence.vision.corner_refinement import smooth_map

LEAST_AREA_PX = 12.0
"""Least area of a spot; smaller ones have no centre of use."""
OUTLINE = 32
"""Points on the outline of a spot."""
AROUND = 1.35
"""Radius within which grey levels count for a spot, in its own: beyond its blur, before the next.
"""
ROUNDS = 3
"""Rounds of centres, map and outlines: the third changes nothing by 0.001 px."""


def detect_circle_grid(grey: np.ndarray, board: CircleGrid) -> Array | None:
    """Locate the centres (rows * columns, 2) [px] of spots in an image (H, W); None: not found.

    The spots are dark on white, or white on dark.
    """
    for image in (grey, 255 - grey):
        found = _find(image, board)
        if found is not None:
            return _centres(image.astype(float), _right_handed(found, board), board)
    return None


def _find(grey: np.ndarray, board: CircleGrid) -> Array | None:
    """Find dark spots (rows, columns, 2) [px], in the order of OpenCV."""
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.minArea, parameters.maxArea = LEAST_AREA_PX, grey.size / (board.columns * board.rows)
    parameters.minDistBetweenBlobs = 2.0
    spots = cv2.SimpleBlobDetector.create(parameters)
    size = board.columns, board.rows
    kind = cv2.CALIB_CB_ASYMMETRIC_GRID if board.asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
    for flags in (kind, kind | cv2.CALIB_CB_CLUSTERING):
        found, centres = cv2.findCirclesGrid(grey, size, flags=flags, blobDetector=spots)
        if found:
            return np.reshape(centres, (board.rows, board.columns, 2)).astype(float)
    return None


def _right_handed(grid: Array, board: CircleGrid) -> Array:
    """Number spots as they are seen from the front, from the upper left where turns look alike."""
    along, down = grid[:, -1] - grid[:, 0], grid[-1] - grid[0]
    (ax, ay), (dx, dy) = along.mean(axis=0), down.mean(axis=0)
    if ax * dy - ay * dx < 0:
        grid = grid[::-1]  # a mirror image; the pattern is its own
    quarters = [0, 2]
    if board.asymmetric:
        quarters = [0] if board.rows % 2 else [0, 2]
    elif board.rows == board.columns:
        quarters = [0, 1, 2, 3]
    return min((np.rot90(grid, q) for q in quarters), key=lambda each: float(each[0, 0].sum()))


def _centres(grey: Array, grid: Array, board: CircleGrid) -> Array | None:
    """Refine the centres (K, 2) [px] of dark spots about rough ones (rows, columns, 2)."""
    places = corner_points(board)[:, :2] / board.square_m
    spots, corners = grid.reshape(-1, 2), grid.reshape(-1, 2)
    phase = np.arange(OUTLINE) * 2 * np.pi / OUTLINE
    circle = np.stack([np.cos(phase), np.sin(phase)], axis=-1)
    radius = 0.25 * (2**0.5 if board.asymmetric else 1.0)
    for _ in range(ROUNDS):
        outlines = smooth_map(places, corners, (places[:, None] + radius * circle).reshape(-1, 2))
        outlines = outlines.reshape(-1, OUTLINE, 2)
        if not np.isfinite(outlines).all():
            return None
        areas, middles = _polygons(outlines)
        measured = [
            _weighed(grey, spot, AROUND * (outline - middle))
            for spot, outline, middle in zip(spots, outlines, middles, strict=True)
        ]
        spots = np.array([centre for centre, _ in measured])
        seen = np.array([area for _, area in measured])
        if not np.isfinite(spots).all():
            return None
        radius *= float(np.sqrt(np.median(seen / areas)))
        corners = spots - (middles - smooth_map(places, corners, places))
    return corners


def _polygons(outlines: Array) -> tuple[Array, Array]:
    """Compute areas (K,) and centroids (K, 2) of polygons (K, n, 2)."""
    following = np.roll(outlines, -1, axis=1)
    crossed = outlines[..., 0] * following[..., 1] - outlines[..., 1] * following[..., 0]
    area = crossed.sum(axis=1) / 2
    moments = ((outlines + following) * crossed[..., None]).sum(axis=1)
    return np.abs(area), moments / (6 * area[:, None])


def _weighed(grey: Array, centre: Array, outline: Array) -> tuple[Array, float]:
    """Compute the centroid (2,) [px] and area [px^2] of darkness within an outline (n, 2) about it.

    NaN where the image ends.
    """
    around = (centre + outline).astype(np.float32)
    left, top = np.floor(around.min(axis=0)).astype(int) - 1
    right, bottom = np.ceil(around.max(axis=0)).astype(int) + 2
    if left < 0 or top < 0 or right > grey.shape[1] or bottom > grey.shape[0]:
        return np.full(2, np.nan), np.nan
    part = grey[top:bottom, left:right]
    inside = np.zeros(part.shape, np.uint8)
    cv2.fillPoly(inside, [np.round(around - [left, top]).astype(np.int32)], 1)
    edge = inside - cv2.erode(inside, np.ones((3, 3), np.uint8), borderValue=0)
    v, u = np.nonzero(inside)
    white = np.median(part[edge > 0])
    black = np.percentile(part[inside > 0], 10)
    darkness = (white - part[v, u]) / max(white - black, 1.0)
    total = darkness.sum()
    return np.array(
        [left + (u * darkness).sum() / total, top + (v * darkness).sum() / total]
    ), total
