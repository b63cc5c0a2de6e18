"""Robust linearised fits with a Gaussian prior: the estimator of self-calibration.

Residuals are in standard deviations. Many of them may be wrong: the best of many hypotheses from
three residuals each starts a reweighted fit with a fixed scale. This is done with some of them
first; where that fit ended all are linearised, and fitted in the same way. Where they are linear up
to there, all are linearised at once. What the residuals say is kept apart from the prior, as normal
equations.

Residuals depend on the unknowns through fewer coordinates: those of two lenses and of one pose, of
a head with many joints and mountings. The fit is made in these, with the prior that they have.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from vergence.arrays import Array
from vergence.self_calibration.match_noise import (
    CUT,
    design_effect,
    noise_variance,
    systematic_inflation,
    tukey_loss,
    tukey_weights,
)
from vergence.self_calibration.state import Evidence

_HYPOTHESES = 300
_STEPS = 4
"""Steps of each of the two runs of reweighted least squares in a fit."""
_FIRST = 150
"""Residuals that start a fit; more take longer, and start no better."""
INLIER = 0.3
"""Weight from which a residual fits."""
FEWEST = 12.0
"""Matches that must fit; a few always do, whatever they show."""
MOST = 0.5
"""Share of the matches that is most of them."""
GATE = 1e-7
"""Probability by chance of a change that is not believed from one frame alone."""

LINEAR_RAD = 0.005
"""Error of a reading up to which residuals are linear: by its square they are wrong by 0.01 px at
most, with focal lengths up to 800 px."""


@dataclass(frozen=True, eq=False)
class LinearisedResiduals:
    """n residuals after a change of the K unknowns, and their derivatives there."""

    residuals: Array
    """(n,) [standard deviations]"""
    by_coordinates: Array
    """(n, k) with the sign of what is predicted, by the coordinates that they depend on."""
    by_unknowns: Array
    """(k, K) of these coordinates."""
    systematic: float = 0.0
    """Share of the residuals' variance that is by systematic errors of the lenses."""


def robust_fit(
    linearised: Callable[[Array, np.ndarray], LinearisedResiduals],
    C: Array,
    *,
    pixels: Array,
    size: tuple[int, int],
    expected_design_effect: float,
    fixed: int = 0,
    linear: Callable[[Array], bool] | None = None,
) -> tuple[Array, Array, Evidence]:
    """Return the change (K,) that residuals and prior give, weights (N,), and what residuals say.

    Args:
        linearised: returns the residuals of some (n,) of the pixels after a change (K,).
        C: (K, K) prior covariance of the change.
        pixels: (N, 2) where the residuals are in the image.
        size: width and height of the image [px].
        expected_design_effect: before the residuals are seen.
        fixed: how many of the first unknowns stay at zero where residuals are linearised again.
        linear: whether residuals are linear enough up to a change (K,), so that they need not be
            linearised again there; None: they never are.
    """
    everyone, first = np.arange(len(pixels)), np.zeros(len(C))
    few = np.linspace(0, len(pixels), min(len(pixels), _FIRST), endpoint=False, dtype=int)
    found = linearised(first, few if linear is None else everyone)
    started = slice(None) if linear is None else few
    y, A, M = found.residuals, found.by_coordinates, found.by_unknowns
    # S is the prior covariance of the coordinates, w a change of them.
    free = M[:, fixed:] @ C[fixed:, fixed:]
    S = free @ M[:, fixed:].T
    start = _best_hypothesis(y[started], A[started], S)
    first[fixed:] = _reweighted(y[started], A[started], S, start) @ free
    if linear is None or not linear(first):
        found = linearised(first, everyone)
        y, A, M = found.residuals, found.by_coordinates, found.by_unknowns
        y = y + A @ (M @ first)  # of the linear model about no change
    S = M @ C @ M.T
    w = S @ _reweighted(y, A, S, M @ first)
    weights, scale2 = tukey_weights(y - A @ w), noise_variance(y - A @ w)
    normal = (y - A @ w) / np.sqrt(scale2)
    inflation, blocks = design_effect(normal, pixels, size, expected_design_effect)
    # Residuals do not show what of a smooth error the unknowns have absorbed.
    noise, field = scale2 * inflation, systematic_inflation(weights, found.systematic)
    weighted = A * (weights / (noise + field))[:, None]
    N, b = weighted.T @ A, weighted.T @ y
    pull = _pull(N, b, S)
    w = S @ pull
    scale = float(np.sqrt(scale2 / (1 - found.systematic)))
    inliers = float((weights > INLIER).sum())
    # What no change of the geometry explains is not known to be noise of another scale.
    misfit = float(tukey_loss(y - A @ w).sum()) / expected_design_effect
    misfit += float(2 * b @ w - w @ N @ w)
    information, vector = M.T @ N @ M, M.T @ b
    systematic = field / (noise + field)
    says = Evidence(information, vector, inliers, scale, inflation, blocks, systematic, misfit)
    return C @ (M.T @ pull), weights, says


def _best_hypothesis(y: Array, A: Array, S: Array) -> Array:
    """Return the change (k,) by three residuals and the prior that most others agree with.

    S (k, k) is the prior covariance of the coordinates.
    """
    AS = A @ S
    G = AS @ A.T
    triples = _triples(len(y))
    G3 = G[triples[:, :, None], triples[:, None, :]]
    pull = np.linalg.solve(G3 + np.eye(3), y[triples][..., None])[..., 0]
    pull = np.concatenate([np.zeros((1, 3)), pull])  # and that nothing is wrong
    G3, triples = np.concatenate([G3[:1], G3]), np.concatenate([triples[:1], triples])
    predicted = (pull[:, None] @ G[triples])[:, 0]
    prior = np.einsum("hi,hij,hj->h", pull, G3, pull)
    cost = np.minimum((y - predicted) ** 2, CUT**2).sum(axis=1) + prior
    best = int(cost.argmin())
    return pull[best] @ AS[triples[best]]


@lru_cache(maxsize=64)
def _triples(residuals: int) -> np.ndarray:
    """Return of which residuals (H, 3) each hypothesis is; the same whenever there are as many."""
    return np.random.default_rng(0).integers(0, residuals, (_HYPOTHESES, 3))


def _reweighted(y: Array, A: Array, S: Array, w: Array) -> Array:
    """Return the `_pull` (k,) of iteratively reweighted least squares, which begin at a change w.

    S (k, k) is the prior covariance of the coordinates.
    """
    pull = np.zeros(len(S))
    for _ in range(_STEPS):
        weighted: Array = A * tukey_weights(y - A @ w)[:, None]
        pull = _pull(weighted.T @ A, weighted.T @ y, S)
        w = S @ pull
    return pull


def _pull(N: Array, b: Array, S: Array) -> Array:
    """Return (k,) by which normal equations and a prior covariance (k, k) change coordinates.

    Coordinates change by S times it, and the unknowns by their prior covariance with the
    coordinates times it. It exists even where the prior holds some of them fixed, so that S has no
    inverse.
    """
    return np.asarray(np.linalg.solve(np.eye(len(S)) + N @ S, b), float)
