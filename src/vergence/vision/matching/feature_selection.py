"""Which features of an image are matched: one in each cell, where a window determines it best."""

from __future__ import annotations

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.vision.matching.least_squares_matching import WINDOW_PX
from vergence.vision.matching.turned_views import whole_windows

_FEATURES = 1000
"""About how many are sought, however large the part is that both eyes see and that has texture; in
images of more than 0.6 megapixels the largest cells are more. Of neighbouring cells many lie within
4 px of each other. Without the weaker ones, a third of all, single frames are as good within 9 % in
12 % less time, but what is learned in 5 s is up to a fifth worse in Fig. 6.
They are spread evenly: taking more where contrast is high, or where features tell most of the turn
between the eyes, would let a near thing with a repeated pattern outvote the rest."""
_ABOVE_NOISE, _BELOW_TEXTURE = 10.0, 0.03
"""Cells have no texture whose squared gradients are below both: so many times those of the weakest
twentieth, which show noise alone if any do, and this share of those of the strongest."""
_SMALLEST_CELL_PX, _LARGEST_CELL_PX = 6, 24
"""Smaller ones would hold windows that are all but the same; larger ones would leave too few
neighbours by which the relief around a feature is judged (`relief`)."""


def best_of_cells(view: np.ndarray, inside: np.ndarray) -> Array:
    """Return pixels (N, 2), one of each cell: where a window determines both directions best.

    By the smaller eigenvalue of its structure tensor (Shi and Tomasi). Of every second pixel,
    `inside` says whether both eyes see it. Plain walls have no features, and leave theirs to the
    rest, whose cells are the smaller.
    """
    half = cv2.pyrDown(view)  # near enough, and much faster
    smaller = cv2.cornerMinEigenVal(half, WINDOW_PX // 2, ksize=3)
    whole = whole_windows(inside)
    smaller[~whole] = 0
    wanted_px = np.sqrt(np.count_nonzero(whole) / _FEATURES)
    best = _cells(smaller, wanted_px).max(axis=1).max(axis=-1)
    best = np.sort(best[best > 0])
    if not len(best):
        return np.empty((0, 2))
    weak, strong = best[[len(best) // 20, -1 - len(best) // 20]]
    least = min(_ABOVE_NOISE * weak, _BELOW_TEXTURE * strong)
    textured = np.count_nonzero(best > least) / len(best)
    cells = _cells(smaller, wanted_px * np.sqrt(textured))
    rows, height, columns, width = cells.shape
    cells = cells.swapaxes(1, 2).reshape(rows, columns, -1)
    largest = cells.argmax(axis=-1)
    row, column = np.nonzero(cells.max(axis=-1) > least)
    down, across = np.divmod(largest[row, column], width)
    at = np.stack([column * width + across, row * height + down], axis=-1).astype(float)
    return 2 * at


def _cells(values: np.ndarray, side_px: float) -> np.ndarray:
    """Return values (H, W) by cells of about a side: (rows, height, columns, width)."""
    side = min(max(float(side_px), _SMALLEST_CELL_PX / 2), _LARGEST_CELL_PX / 2)
    # Whole pixels, and about as many as wanted: squares may be a third too large or too small.
    height = round(side)
    width = round(side**2 / height)
    rows, columns = values.shape[0] // height, values.shape[1] // width
    whole = values[: rows * height, : columns * width]
    return whole.reshape(rows, height, columns, width)
