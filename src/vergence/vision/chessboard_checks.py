"""Whether the corners that OpenCV found are all those of one chessboard, row by row.

Asked for a board of fewer squares than there are, it now and then finds a part of it, another part
in each image, or puts together corners that are no grid.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.ndimage import map_coordinates

from vergence.arrays import Array

_UNEVEN = 0.5
"""Difference of the two sides at a corner, as a part of the longer one, that no lens makes and no
view: it was at most 0.3 on 150 boards that were drawn, leaning by up to 70 degrees, before
plain lenses, fisheyes and lenses with k3."""
_ALTERNATING = 0.9
"""Part of the neighbouring squares that differ as they should; a reflection may cover others."""
_PLACES = 0.2, 0.35, 0.5, 0.65, 0.8
"""Where squares are looked at, as parts of their sides: some are on the black frames of markers."""
_NARROW = 0.5
"""Least width of the outermost squares, in squares: that of many printed boards."""
_CLEAR = 0.25
"""Part of the contrast of squares by which a grey level is white or black, not between them."""


def contrast(grey: np.ndarray, corners: np.ndarray) -> float:
    """Return how many grey levels black and white differ by, within corners (..., 2) [px]."""
    corners = corners.reshape(-1, 2).astype(int)
    (left, top), (right, bottom) = np.maximum(corners.min(axis=0), 0), corners.max(axis=0)
    box = grey[top : bottom + 1, left : right + 1]
    return float(np.ptp(np.percentile(box[::2, ::2], [10, 90])))


def square_levels(grey: np.ndarray, grid: Array, at: tuple[float, float] = (0.5, 0.5)) -> Array:
    """Return the grey levels (rows - 1, columns - 1) at a place in the squares of a grid.

    Args:
        grey: (H, W) uint8.
        grid: (rows, columns, 2) [px].
        at: the place, as parts of the way along a square's row and its column.
    """
    x, y = at
    above = (1 - x) * grid[:-1, :-1] + x * grid[:-1, 1:]
    below = (1 - x) * grid[1:, :-1] + x * grid[1:, 1:]
    places = ((1 - y) * above + y * below).transpose(2, 0, 1)[::-1]
    return np.asarray(map_coordinates(grey, places, float, order=1, mode="nearest"))


def is_grid(grid: Array) -> bool:
    """Return whether corners lie as those of a board before a camera do.

    grid is (rows, columns, 2) [px], NaN for those that are not known.
    """
    for lines in (grid, grid.swapaxes(0, 1)):
        sides = np.diff(lines, axis=0)
        lengths = np.linalg.norm(sides, axis=-1)
        longer = np.maximum(lengths[1:], lengths[:-1])
        if (np.linalg.norm(np.diff(sides, axis=0), axis=-1) > _UNEVEN * longer).any():
            return False
    along, across = np.diff(grid, axis=1)[:-1], np.diff(grid, axis=0)[:, :-1]
    turn = along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0]
    return not ((turn > 0).any() and (turn < 0).any())


def is_chequered(grey: np.ndarray, grid: Array) -> bool:
    """Return whether the squares between corners (rows, columns, 2) [px] alternate in colour.

    Those between every second corner do not, though they lie evenly as well, and those with markers
    do not in all places. Only neighbours are compared: the light may fall off over the board.
    """
    steps = np.array([_alternation(grey, grid, at) for at in product(_PLACES, _PLACES)])
    medians = np.median(steps, axis=1)
    clear = _CLEAR * contrast(grey, grid)
    if not ((medians > clear).all() or (medians < -clear).all()):
        return False
    return bool((steps * np.sign(medians[0]) > 0).mean() > _ALTERNATING)


def _alternation(grey: np.ndarray, grid: Array, at: tuple[float, float]) -> Array:
    """Return (N,) how much brighter squares of the first one's colour are than each neighbour."""
    values = square_levels(grey, grid, at)
    first = np.where(np.indices(values.shape).sum(axis=0) % 2 == 0, 1, -1)
    below, beside = first[1:] * np.diff(values, axis=0), first[:, 1:] * np.diff(values, axis=1)
    return np.concatenate([below.ravel(), beside.ravel()])


def goes_on(grey: np.ndarray, grid: Array) -> bool:
    """Return whether squares go on beyond those at the corners (rows, columns, 2) [px] of a grid.

    Then the board has more corners than the grid: next to each square outside of the outermost
    corners there is one of the other colour.
    """
    return any(_goes_on_above(grey, np.rot90(grid, quarter)) for quarter in range(4))


def ends_inside(grid: Array, shape: tuple[int, ...]) -> bool:
    """Return whether the squares around the corners (rows, columns, 2) [px] lie in an image (H, W).

    Otherwise there may be more corners beyond its border.
    """
    ends = np.concatenate([_beyond(np.rot90(grid, quarter), 1.0) for quarter in range(4)])
    return bool(((ends >= 0) & (ends <= np.array(shape[1::-1]) - 1)).all())


def _goes_on_above(grey: np.ndarray, grid: Array) -> bool:
    height, width = grey.shape
    values, seen = [], []
    # Near the corners, since the outermost squares of many boards are narrower than the others.
    for squares in (_NARROW / 2, 1 + _NARROW / 2):
        corners = _beyond(grid, squares)
        ends = _beyond(corners, _NARROW / 2), _beyond(corners[::-1], _NARROW / 2)
        centres = np.vstack([ends[0], (corners[1:] + corners[:-1]) / 2, ends[1]])
        column, row = np.round(centres).astype(int).T
        inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
        seen.append(inside)
        values.append(grey[row * inside, column * inside].astype(float))
    usable = seen[0] & seen[1]
    even = np.arange(len(usable)) % 2 == 0
    if usable[even].sum() < 2 or usable[~even].sum() < 2:
        return False
    # Beyond, the colours are exchanged.
    level = [values[0][usable & each].mean() for each in (even, ~even)]
    from_middle = (values[1] - np.mean(level)) / (level[1] - level[0] or 1.0)
    return bool((np.where(even, from_middle, -from_middle)[usable] > _CLEAR).all())


def _beyond(lines: Array, squares: float) -> Array:
    """Return where a line lies that many squares before the first of lines (n, ..., 2) [px].

    It is the parabola through three lines: perspective and lenses make squares grow or shrink.
    """
    first, second, third = lines[:3]
    bend = squares * (squares + 1) / 2 * (third - 2 * second + first)
    return np.asarray(first - squares * (second - first) + bend)
