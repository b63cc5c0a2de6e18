"""Check that the corners that OpenCV found are all those of one chessboard, row by row.

Asked for a board of fewer squares than there are, OpenCV finds a part of it, another part in each
image, or puts together corners that do not form a grid.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.ndimage import map_coordinates

from vergence.arrays import Array

_PLACES = 0.2, 0.35, 0.5, 0.65, 0.8
"""Where squares are sampled, over their sides; some places lie on the frames of markers."""
_NARROW = 0.5
"""Least width of the outermost squares, in squares: that of many printed boards."""
_CLEAR = 0.25
"""Least difference of a white or black grey level from the middle, over the contrast."""


def contrast(grey: np.ndarray, corners: np.ndarray) -> float:
    """Estimate the grey levels between black and white within corners (..., 2) [px]."""
    corners = corners.reshape(-1, 2).astype(int)
    (left, top), (right, bottom) = np.maximum(corners.min(axis=0), 0), corners.max(axis=0)
    box = grey[top : bottom + 1, left : right + 1]
    return float(np.ptp(np.percentile(box[::2, ::2], [10, 90])))


def square_levels(grey: np.ndarray, grid: Array, at: tuple[float, float] = (0.5, 0.5)) -> Array:
    """Sample the grey levels (rows - 1, columns - 1) at one place in each square of a grid.

    The place is given as parts of the way along a square's row and its column.
    """
    x, y = at
    above = (1 - x) * grid[:-1, :-1] + x * grid[:-1, 1:]
    below = (1 - x) * grid[1:, :-1] + x * grid[1:, 1:]
    places = ((1 - y) * above + y * below).transpose(2, 0, 1)[::-1]
    return np.asarray(map_coordinates(grey, places, float, order=1, mode="nearest"))


def is_chequered(grey: np.ndarray, grid: Array) -> bool:
    """Check that the squares between corners (rows, columns, 2) [px] alternate in colour.

    Only neighbours are compared, since the light may fall off over the board.
    """
    steps = np.array([_alternation(grey, grid, at) for at in product(_PLACES, _PLACES)])
    medians = np.median(steps, axis=1)
    clear = _CLEAR * contrast(grey, grid)
    if not ((medians > clear).all() or (medians < -clear).all()):
        return False
    # A reflection may cover a tenth.
    return bool((steps * np.sign(medians[0]) > 0).mean() > 0.9)


def goes_on(grey: np.ndarray, grid: Array) -> bool:
    """Check whether the board has more squares than a grid (rows, columns, 2) [px] of corners.

    Then next to each square outside the outermost corners there is one of the other colour.
    """
    return any(_goes_on_above(grey, np.rot90(grid, quarter)) for quarter in range(4))


def ends_inside(grid: Array, shape: tuple[int, ...]) -> bool:
    """Check that the squares around the corners (rows, columns, 2) [px] lie in an image (H, W)."""
    ends = np.concatenate([_beyond(np.rot90(grid, quarter), 1.0) for quarter in range(4)])
    return bool(((ends >= 0) & (ends <= np.array(shape[1::-1]) - 1)).all())


def _alternation(grey: np.ndarray, grid: Array, at: tuple[float, float]) -> Array:
    """Compute (N,) the brightness of squares of the first one's colour minus each neighbour's."""
    values = square_levels(grey, grid, at)
    sign = np.where(np.indices(values.shape).sum(axis=0) % 2 == 0, 1, -1)
    down, right = sign[1:] * np.diff(values, axis=0), sign[:, 1:] * np.diff(values, axis=1)
    return np.concatenate([down.ravel(), right.ravel()])


def _goes_on_above(grey: np.ndarray, grid: Array) -> bool:
    height, width = grey.shape
    values, inside = [], []
    # Two rows: the outermost squares, and beyond. The outermost squares of many boards are narrow.
    for squares in (_NARROW / 2, 1 + _NARROW / 2):
        corners = _beyond(grid, squares)
        ends = _beyond(corners, _NARROW / 2), _beyond(corners[::-1], _NARROW / 2)
        centres = np.vstack([ends[0], (corners[1:] + corners[:-1]) / 2, ends[1]])
        column, row = np.round(centres).astype(int).T
        inside.append((column >= 0) & (row >= 0) & (column < width) & (row < height))
        values.append(grey[row * inside[-1], column * inside[-1]].astype(float))
    usable = inside[0] & inside[1]
    even = np.arange(len(usable)) % 2 == 0
    if usable[even].sum() < 2 or usable[~even].sum() < 2:
        return False
    # Beyond, the colours are exchanged.
    level = [values[0][usable & each].mean() for each in (even, ~even)]
    from_middle = (values[1] - np.mean(level)) / (level[1] - level[0] or 1.0)
    return bool((np.where(even, from_middle, -from_middle)[usable] > _CLEAR).all())


def _beyond(lines: Array, squares: float) -> Array:
    """Extrapolate lines (n, ..., 2) [px] by a number of squares before the first one.

    A parabola through three lines follows the growth of squares by perspective and lens.
    """
    first, second, third = lines[:3]
    bend = squares * (squares + 1) / 2 * (third - 2 * second + first)
    return np.asarray(first - squares * (second - first) + bend)
