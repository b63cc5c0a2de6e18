"""Robust linearised fits with a Gaussian prior: the estimator of self-calibration.

Residuals are in standard deviations. Many of them may be wrong: the best of many hypotheses from
three residuals each starts a reweighted fit with a fixed scale. This is done with some of them
first; where that fit ended all are linearised, and fitted in the same way. Where they are linear up
to there, all are linearised at once. What the residuals say is kept apart from the prior, as normal
equations.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from vergence.arrays import Array
from vergence.self_calibration.match_noise import (
    CUT,
    design_effect,
    noise_variance,
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


def robust_fit(
    linearised: Callable[[Array, np.ndarray], tuple[Array, Array]],
    C: Array,
    *,
    pixels: Array,
    match_scale: float,
    expected_design_effect: float,
    fixed: int = 0,
    linear: Callable[[Array], bool] | None = None,
) -> tuple[Array, Array, Evidence]:
    """Return the change (K,) that residuals and prior give, weights (N,), and what residuals say.

    Args:
        linearised: returns residuals (n,) [standard deviations] of some (n,) of the pixels, after a
            change (K,), and their derivatives (n, K) there, with the sign of what is predicted.
        C: (K, K) prior covariance of the change.
        pixels: (N, 2) where the residuals are in the image.
        match_scale: noise that the standard deviations assume, relative to what windows tell.
        expected_design_effect: before the residuals are seen.
        fixed: how many of the first unknowns stay at zero where residuals are linearised again.
        linear: whether residuals are linear enough up to a change (K,), so that they need not be
            linearised again there; None: they never are.
    """
    first, prior = np.zeros(len(C)), np.asarray(np.linalg.inv(C), float)
    everyone = np.arange(len(pixels))
    few = np.linspace(0, len(pixels), min(len(pixels), _FIRST), endpoint=False, dtype=int)
    y, A = linearised(first, few if linear is None else everyone)
    started = slice(None) if linear is None else few
    own = np.asarray(np.linalg.inv(C[fixed:, fixed:]), float) if fixed else prior
    start = _best_hypothesis(y[started], A[started, fixed:], C[fixed:, fixed:])
    first[fixed:] = _reweighted(y[started], A[started, fixed:], own, start)
    if linear is None or not linear(first):
        y, A = linearised(first, everyone)
        y = y + A @ first  # of the linear model about no change
    z = _reweighted(y, A, prior, first)
    weights, scale2 = tukey_weights(y - A @ z), noise_variance(y - A @ z)
    normal = (y - A @ z) / np.sqrt(scale2)
    inflation, blocks = design_effect(normal, pixels, expected_design_effect)
    weighted = A * (weights / (scale2 * inflation))[:, None]
    information, vector = weighted.T @ A, weighted.T @ y
    z = np.asarray(np.linalg.solve(information + prior, vector), float)
    scale = float(np.sqrt(scale2)) * match_scale
    inliers = float((weights > INLIER).sum())
    # What no change of the geometry explains is not known to be noise of another scale.
    misfit = float(tukey_loss(y - A @ z).sum()) / expected_design_effect
    misfit += float(2 * vector @ z - z @ information @ z)
    says = Evidence(information, vector, inliers, scale, inflation, blocks, misfit)
    return z, weights, says


def _best_hypothesis(y: Array, A: Array, C: Array) -> Array:
    """Return the change (K,) by three residuals and the prior that most others agree with."""
    AC = A @ C
    G = AC @ A.T
    triples = _triples(len(y))
    G3 = G[triples[:, :, None], triples[:, None, :]]
    pull = np.linalg.solve(G3 + np.eye(3), y[triples][..., None])[..., 0]
    pull = np.concatenate([np.zeros((1, 3)), pull])  # and that nothing is wrong
    G3, triples = np.concatenate([G3[:1], G3]), np.concatenate([triples[:1], triples])
    predicted = (pull[:, None] @ G[triples])[:, 0]
    prior = np.einsum("hi,hij,hj->h", pull, G3, pull)
    cost = np.minimum((y - predicted) ** 2, CUT**2).sum(axis=1) + prior
    best = int(cost.argmin())
    return pull[best] @ AC[triples[best]]


@lru_cache(maxsize=64)
def _triples(residuals: int) -> np.ndarray:
    """Return of which residuals (H, 3) each hypothesis is; the same whenever there are as many."""
    return np.random.default_rng(0).integers(0, residuals, (_HYPOTHESES, 3))


def _reweighted(y: Array, A: Array, prior: Array, z: Array) -> Array:
    """Return the change (K,) by iteratively reweighted least squares with the prior's information.

    It begins at a change z.
    """
    for _ in range(_STEPS):
        weighted: Array = A * tukey_weights(y - A @ z)[:, None]
        z = np.asarray(np.linalg.solve(weighted.T @ A + prior, weighted.T @ y), float)
    return z
