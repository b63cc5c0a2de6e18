"""How far from plane the scene is around a match, by how its neighbours are displaced."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from vergence.arrays import Array

_NEIGHBOURS = 8
_NEIGHBOUR_PX = 40.0
"""Neighbours of a match that show the surface around it: how many, and how near they are. With
twelve depth is as steady."""
_SURFACE_PX = 15.0
"""Distance at which a neighbour counts half: a window's width."""


def relief_around(at: Array, displaced: Array) -> Array:
    """Return how far from plane the scene is around windows (N,) [px], as neighbours show.

    At a depth discontinuity an edge of the nearer surface and one of the farther often meet in a
    T-junction, which is no point of the scene, and seems to be displaced across the epipolar line;
    relief in a window is taken in part for such a displacement. A window cannot tell; its
    neighbours do: by how much, root mean square, they and it are displaced otherwise than a plane
    through them would be. The neighbour that fits worst does not count, since it may be wrong.

    Args:
        at: (N, 2) middles of the windows [px].
        displaced: (N,) how far they are displaced along the epipolar line [px].
    """
    if len(at) <= _NEIGHBOURS:
        return np.zeros(len(at))
    tree = KDTree(at, balanced_tree=False, compact_nodes=False)  # is used but once
    far, which = tree.query(at, k=_NEIGHBOURS + 1, distance_upper_bound=_NEIGHBOUR_PX)
    # Neighbours first: sums over them are then of long rows.
    far, which = (np.ascontiguousarray(np.asarray(each).T[1:]) for each in (far, which))
    near = np.isfinite(far)
    which = np.where(near, which, 0)
    x, y = ((each[which] - each) / _SURFACE_PX for each in at.T)
    weights = np.where(near, 1 / (1 + (far / _SURFACE_PX) ** 2), 0.0)
    values = displaced[which] - displaced
    apart = values - _planes(x, y, weights, values)[0]
    weights[(np.abs(apart) * near).argmax(axis=0), np.arange(len(at))] = 0
    plane, here = _planes(x, y, weights, values)
    square = (weights * (values - plane) ** 2).sum(axis=0) + here**2
    return np.sqrt(square / (weights.sum(axis=0) + 1))


def _planes(x: Array, y: Array, weights: Array, values: Array) -> tuple[Array, Array]:
    """Fit planes to values (k, N); return them at their k places (k, N) and in the middle (N,)."""
    terms = np.ones_like(x), x, y
    H = np.empty((x.shape[1], 3, 3))
    right = np.empty((x.shape[1], 3, 1))
    for i, first in enumerate(terms):
        weighted = weights * first
        right[:, i, 0] = (weighted * values).sum(axis=0)
        for j, second in enumerate(terms[: i + 1]):
            H[:, i, j] = H[:, j, i] = (weighted * second).sum(axis=0)
    H += 1e-3 * np.eye(3)  # the flattest plane through neighbours on one line
    here, by_x, by_y = np.linalg.solve(H, right)[..., 0].T
    return here + by_x * x + by_y * y, here
