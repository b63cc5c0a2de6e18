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

OUTLINE = np.array([(np.cos(k * np.pi / 16), np.sin(k * np.pi / 16)) for k in range(32)])
"""(32, 2) points on the outline of a spot, about its centre and in its radius."""
AROUND = 1.35
"""Radius within which grey levels count, in that of the spot: beyond its blur, before the next."""
ROUNDS = 3
"""Rounds of centres, map and outlines: the third changes nothing by 0.001 px."""


def detect_circle_grid(grey: np.ndarray, board: CircleGrid) -> Array | None:
    """Locate centres (rows * columns, 2) [px] of dark spots in an image (H, W); None: not found."""
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.maxArea = grey.size / (board.columns * board.rows)
    parameters.minDistBetweenBlobs = 2.0  # [px]; spots of a far grid are close
    spots = cv2.SimpleBlobDetector.create(parameters)
    size = board.columns, board.rows
    kind = cv2.CALIB_CB_ASYMMETRIC_GRID if board.asymmetric else cv2.CALIB_CB_SYMMETRIC_GRID
    found, centres = cv2.findCirclesGrid(grey, size, flags=kind, blobDetector=spots)
    if not found:
        return None
    grid = np.reshape(centres, (board.rows, board.columns, 2)).astype(float)
    return _centres(grey, _right_handed(grid, board).reshape(-1, 2), board)


def _right_handed(grid: Array, board: CircleGrid) -> Array:
    """Number spots as they are seen from the front, from the upper left where turns look alike."""
    along, down = (grid[:, -1] - grid[:, 0]).mean(axis=0), (grid[-1] - grid[0]).mean(axis=0)
    if along[0] * down[1] < along[1] * down[0]:
        grid = grid[::-1]  # a mirror image; the pattern is its own
    if board.asymmetric:
        return grid
    step = 1 if board.rows == board.columns else 2
    turned = [np.rot90(grid, quarter) for quarter in range(0, 4, step)]
    return min(turned, key=lambda each: float(each[0, 0].sum()))


def _centres(grey: np.ndarray, spots: Array, board: CircleGrid) -> Array | None:
    """Refine the centres (K, 2) [px] of dark spots about rough ones; None: one is cut off."""
    places, corners = corner_points(board)[:, :2] / board.square_m, spots
    radius = (0.7 if board.asymmetric else 0.5) / AROUND  # halfway to the next spot
    for _ in range(ROUNDS):
        outlines = smooth_map(places, corners, (places[:, None] + radius * OUTLINE).reshape(-1, 2))
        outlines = outlines.reshape(len(places), -1, 2)
        outlines -= smooth_map(places, corners, places)[:, None]
        drawn = np.array([_moments(each) for each in outlines])
        around = spots[:, None] + AROUND * (outlines - drawn[:, None, :2])
        if not ((around > 1) & (around < np.array(grey.shape[::-1]) - 2)).all():
            return None  # also of what is not finite
        seen = np.array([_moments(*_darkness(grey, each)) for each in around])
        spots, corners = seen[:, :2], seen[:, :2] - drawn[:, :2]
        radius *= float(np.sqrt(np.median(seen[:, 2] / drawn[:, 2])))
    return corners


def _moments(of: Array, offset: Array | float = 0.0) -> Array:
    """Compute centroid and area (3,) [px] of a polygon (n, 2), or of an image from an offset on."""
    m = cv2.moments(of.astype(np.float32))
    centre = np.array([m["m10"], m["m01"]]) / (m["m00"] or np.nan) + offset
    return np.append(centre, m["m00"])


def _darkness(grey: np.ndarray, outline: Array) -> tuple[Array, Array]:
    """Compute how dark pixels within an outline (n, 2) are, from 0 to 1, and where they begin."""
    left, top = np.floor(outline.min(axis=0)).astype(int)
    width, height = np.ceil(outline.max(axis=0)).astype(int) + 1 - [left, top]
    part = grey[top : top + height, left : left + width]
    inside = np.zeros((height, width), np.uint8)
    cv2.fillPoly(inside, [np.round(outline - [left, top]).astype(np.int32)], 1)
    edge = inside - cv2.erode(inside, np.ones((3, 3), np.uint8), borderValue=0)
    white, black = np.median(part[edge > 0]), np.percentile(part[inside > 0], 10)
    return inside * (white - part) / max(white - black, 1.0), np.array([left, top])
