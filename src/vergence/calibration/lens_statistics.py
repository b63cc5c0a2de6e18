"""Accuracy of a fitted lens by its residuals: covariance, jackknife, held-out errors."""

from __future__ import annotations

import numpy as np

from vergence.arrays import Array
from vergence.calibration.lenses import LensFit

FOLDS = 5
"""Parts of the views, each predicted by a lens from the others."""
SMALLEST_EIGENVALUE = 1e-13
"""Least eigenvalue, of information scaled to a unit diagonal, of a direction that is determined."""


def noise_covariance(rest: Array, variance: float) -> Array:
    """Compute the covariance (n, n) of fitted intrinsics, if all corners err independently.

    By the derivatives (V, 2 K, n) of the corners' pixels, of `without_poses`, and the variance of
    these. Infinite: not determined.
    """
    H = (np.swapaxes(rest, 1, 2) @ rest).sum(axis=0)
    scale = np.sqrt(np.diag(H))
    if not np.isfinite(variance) or not (scale > 0).all():
        return np.full(H.shape, np.inf)
    values, vectors = np.linalg.eigh(H / np.outer(scale, scale))
    return variance * (vectors / np.maximum(values, 1e-15)) @ vectors.T / np.outer(scale, scale)


def jackknife_covariance(errors: Array, rest: Array) -> Array:
    """Compute the covariance (n, n) of fitted intrinsics, by the change that each view makes.

    The jackknife, for clusters: errors that the corners of a view share, such as those by the bend
    of the board, are in it, unlike where all corners are taken to err independently. The lens
    without a view is one Gauss-Newton step away from that of all views.

    Args:
        errors: (V, 2 K) [px] of the fit to all views.
        rest: (V, 2 K, n) their derivatives, of `without_poses`.
    """
    V, (H, g) = len(errors), _by_view(errors, rest)
    moved = _solve(H.sum(axis=0) - H, g)
    moved -= moved.mean(axis=0)
    return (V - 1) / V * moved.T @ moved


def held_out_squares(fit: LensFit) -> Array:
    """Compute (V,) [px^2] the squares of each view's errors, predicted by a lens from other views.

    The views are divided into FOLDS; of a view itself only the board's pose is fitted. The lens
    without a fold is one Gauss-Newton step away from that of all views.
    """
    V = len(fit.errors)
    number, squares = np.arange(V) % FOLDS, np.empty(V)
    H, g = _by_view(fit.errors, fit.rest)
    for k in range(FOLDS):
        mine = number == k
        moved = _solve(H[~mine].sum(axis=0), g[mine].sum(axis=0))
        squares[mine] = ((fit.errors[mine] + fit.rest[mine] @ moved) ** 2).sum(axis=1)
    return squares


def _by_view(errors: Array, rest: Array) -> tuple[Array, Array]:
    """Compute what each view adds to the normal equations of the intrinsics: (V, n, n), (V, n)."""
    rest_T = np.swapaxes(rest, 1, 2)
    return rest_T @ rest, (rest_T @ errors[..., None])[..., 0]


def _solve(H: Array, g: Array) -> Array:
    """Solve for the shortest x (..., n) of H x = g, in units of H's diagonal; H may be singular."""
    scale = np.sqrt(np.maximum(np.diagonal(H, axis1=-2, axis2=-1), 1e-300))
    values, vectors = np.linalg.eigh(H / scale[..., None, :] / scale[..., None])
    inverse = np.where(values > SMALLEST_EIGENVALUE, 1 / np.maximum(values, 1e-300), 0.0)
    along = (np.swapaxes(vectors, -1, -2) @ (g / scale)[..., None])[..., 0]
    return (vectors @ (inverse * along)[..., None])[..., 0] / scale
