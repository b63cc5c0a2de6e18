"""Select the features to match, one in each cell, and judge the relief of the scene around them."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial import KDTree

from vergence.arrays import Array
from vergence.vision.matching.least_squares_matching import WINDOW_PX
from vergence.vision.matching.turned_views import whole_windows

_FEATURES = 1000
"""Number of features to select; with a third fewer, depth is up to a fifth worse in Fig. 6."""
_NEIGHBOURS = 8
"""Number of neighbours that show the surface around a match; twelve give the same depth."""
_SURFACE_PX = 15.0
"""Distance at which a neighbour has half the weight [px]: a window's width."""


def best_of_cells(view: np.ndarray, inside: np.ndarray) -> Array:
    """Select pixels (N, 2), in each cell the one that a window determines best in both directions.

    The measure is the smaller eigenvalue of the structure tensor (Shi and Tomasi, 1994). `inside`
    tells for every second pixel whether both eyes see it. Where parts have no texture, cells
    are smaller.
    """
    half = cv2.pyrDown(view)  # accurate enough, and much faster
    smaller = cv2.cornerMinEigenVal(half, WINDOW_PX // 2, ksize=3)
    whole = whole_windows(inside)
    smaller[~whole] = 0
    side_px = np.sqrt(np.count_nonzero(whole) / _FEATURES)
    best = _cells(smaller, side_px).max(axis=1).max(axis=-1)
    best = np.sort(best[best > 0])
    if not len(best):
        return np.empty((0, 2))
    weak, strong = best[[len(best) // 20, -1 - len(best) // 20]]
    least = min(10 * weak, 0.03 * strong)  # of a cell without texture the noise is below both
    textured = np.count_nonzero(best > least) / len(best)
    cells = _cells(smaller, side_px * np.sqrt(textured))
    rows, height, columns, width = cells.shape
    cells = cells.swapaxes(1, 2).reshape(rows, columns, -1)
    largest = cells.argmax(axis=-1)
    row, column = np.nonzero(cells.max(axis=-1) > least)
    down, across = np.divmod(largest[row, column], width)
    at = np.stack([column * width + across, row * height + down], axis=-1).astype(float)
    return 2 * at


def _cells(values: np.ndarray, side_px: float) -> np.ndarray:
    """Divide values (H, W) into cells of about this side: (rows, height, columns, width)."""
    # Below 6 px windows are nearly the same, above 24 px features have too few neighbours.
    side = min(max(float(side_px), 6 / 2), 24 / 2)
    # Height and width are whole pixels with about the wanted area.
    height = round(side)
    width = round(side**2 / height)
    rows, columns = values.shape[0] // height, values.shape[1] // width
    return values[: rows * height, : columns * width].reshape(rows, height, columns, width)


def relief_around(at: Array, displaced: Array) -> Array:
    """Estimate the relief of the scene around windows (N,) [px]: its RMS deviation from a plane.

    Relief displaces windows across the epipolar line. A plane is fitted to the displacements of the
    neighbours without the worst of them, which may be a mismatch. `displaced` (N,) are those of the
    windows at (N, 2) along the epipolar line [px].
    """
    if len(at) <= _NEIGHBOURS:
        return np.zeros(len(at))
    tree = KDTree(at, balanced_tree=False, compact_nodes=False)  # fast to build
    distance, which = tree.query(at, k=_NEIGHBOURS + 1, distance_upper_bound=40)
    # Neighbours lead, so that sums over them are of long rows.
    distance, which = (np.ascontiguousarray(np.asarray(a).T[1:]) for a in (distance, which))
    near = np.isfinite(distance)
    which = np.where(near, which, 0)
    x, y = ((a[which] - a) / _SURFACE_PX for a in at.T)
    weights = np.where(near, 1 / (1 + (distance / _SURFACE_PX) ** 2), 0.0)
    values = displaced[which] - displaced
    deviation = values - _planes(x, y, weights, values)[0]
    weights[(np.abs(deviation) * near).argmax(axis=0), np.arange(len(at))] = 0
    plane, middle = _planes(x, y, weights, values)
    square = (weights * (values - plane) ** 2).sum(axis=0) + middle**2
    return np.sqrt(square / (weights.sum(axis=0) + 1))


def _planes(x: Array, y: Array, weights: Array, values: Array) -> tuple[Array, Array]:
    """Fit planes to values (k, N); return them at their k places (k, N) and in the middle (N,)."""
    terms = np.stack([np.ones_like(x), x, y])
    H, right = (
        np.einsum("ikn,jkn->nij", weights * terms, of) for of in (terms, values[np.newaxis])
    )
    H += 1e-3 * np.eye(3)  # the flattest plane through neighbours on one line
    middle, by_x, by_y = np.linalg.solve(H, right)[..., 0].T
    return middle + by_x * x + by_y * y, middle
