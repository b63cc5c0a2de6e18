"""Robust iterated update: matches with outliers, and a Gaussian prior.

The best of many three-point hypotheses starts iteratively reweighted least squares with Tukey's
biweight. Residuals depend on the K unknowns through k coordinates, those of one or two lenses and
of one pose, in which the fit is made. The result is the measurement alone, as normal equations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import chdtri

from vergence.arrays import Array
from vergence.self_calibration.match_noise import (
    CUT,
    design_effect,
    noise_variance,
    tukey_loss,
    tukey_weights,
)
from vergence.self_calibration.state import Evidence

INLIER = 0.3
"""Least weight of an inlier."""
FEWEST = 12.0
"""Least number of inliers; fewer fit by chance."""
LINEAR_RAD = 0.005
"""Error of a joint angle up to which residuals are linear: to 0.01 px at a focal length of 800."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """n residuals at some value of the K unknowns, with their derivatives."""

    residuals: Array
    """(n,) measured minus predicted [standard deviations]."""
    by_coordinates: Array
    """(n, k) derivatives of the predictions."""
    by_unknowns: Array
    """(k, K) derivatives of the coordinates."""
    systematic: float = 0.0
    """Share of the residuals' variance that is due to systematic lens errors."""


def robust_fit(
    linearise: Callable[[Array], Linearised],
    C: Array,
    *,
    pixels: Array,
    size: tuple[int, int],
    prior_design_effect: float,
    fixed: int = 0,
    linear_range: Array | None = None,
) -> tuple[Array, Evidence]:
    """Fit residuals with a prior; return weights (N,) and the measurement.

    Args:
        linearise: computes the residuals after a change (K,).
        C: (K, K) prior covariance of the change.
        pixels: (N, 2) positions of the residuals in the image.
        size: width and height of the image [px].
        prior_design_effect: of the residuals.
        fixed: number of leading unknowns that stay at zero where residuals are linearised.
        linear_range: (K,) change of each unknown up to which residuals need not be linearised
            again; None: they always are.
    """
    start, n = np.zeros(len(C)), len(pixels)
    found = linearise(start)
    y, A, M = found.residuals, found.by_coordinates, found.by_unknowns
    first = np.linspace(0, n, min(n, 150), endpoint=False, dtype=int)  # more start no better
    by_free = M[:, fixed:] @ C[fixed:, fixed:]
    S = by_free @ M[:, fixed:].T
    hypothesis = _best_hypothesis(y[first], A[first], S)
    start[fixed:] = _reweighted(y[first], A[first], S, hypothesis) @ by_free
    if linear_range is None or (np.abs(start) > linear_range).any():
        found = linearise(start)
        y, A, M = found.residuals, found.by_coordinates, found.by_unknowns
        y = y + A @ (M @ start)  # of the linear model about no change
    S = M @ C @ M.T
    e = y - A @ (S @ _reweighted(y, A, S, M @ start))
    weights, variance = tukey_weights(e), noise_variance(e)
    inflation, filled = design_effect(e / np.sqrt(variance), pixels, size, prior_design_effect)
    # The unknowns absorb most of a systematic error, so residuals do not show it.
    noise = variance * inflation
    # Systematic errors have 15 independent parts, polynomials up to the fourth degree.
    field = found.systematic * float(weights.sum()) / 15
    weighted = A * (weights / (noise + field))[:, None]
    N, b = weighted.T @ A, weighted.T @ y
    dual = _dual(N, b, S)
    w = S @ dual
    misfit = float(tukey_loss(y - A @ w).sum()) / prior_design_effect
    evidence = Evidence(
        information=M.T @ N @ M,
        vector=M.T @ b,
        inliers=float((weights > INLIER).sum()),
        match_scale=float(np.sqrt(variance / (1 - found.systematic))),
        design_effect=inflation,
        filled=filled,
        systematic=field / (noise + field),
        distance=float(dual @ w),
        degrees=len(S) - float(np.trace(np.linalg.inv(np.eye(len(S)) + N @ S))),
        misfit=misfit + float(2 * b @ w - w @ N @ w),
    )
    return weights, evidence


def passes_gate(evidence: Evidence) -> bool:
    """Decide whether the innovation is plausible under the prior."""
    return evidence.distance <= gate(evidence.degrees)


def gate(degrees: float) -> float:
    """Compute the largest plausible squared Mahalanobis distance, at a tail probability of 1e-7."""
    return float(chdtri(max(degrees, 1.0), 1e-7))


def _best_hypothesis(y: Array, A: Array, S: Array) -> Array:
    """Choose the change (k,) from three residuals and the prior with the least truncated cost."""
    AS = A @ S
    G = AS @ A.T
    triples = _triples(len(y))
    G3 = G[triples[:, :, None], triples[:, None, :]]
    pull = np.linalg.solve(G3 + np.eye(3), y[triples][..., None])[..., 0]
    pull = np.concatenate([np.zeros((1, 3)), pull])  # the first hypothesis is no change
    G3, triples = np.concatenate([G3[:1], G3]), np.concatenate([triples[:1], triples])
    predicted = (pull[:, None] @ G[triples])[:, 0]
    prior = np.einsum("hi,hij,hj->h", pull, G3, pull)
    cost = np.minimum((y - predicted) ** 2, CUT**2).sum(axis=1) + prior
    best = int(cost.argmin())
    return pull[best] @ AS[triples[best]]


@lru_cache(maxsize=64)
def _triples(residuals: int) -> np.ndarray:
    """Draw the residuals (300, 3) of each hypothesis, enough at 70 % outliers."""
    return np.random.default_rng(0).integers(0, residuals, (300, 3))


def _reweighted(y: Array, A: Array, S: Array, w: Array) -> Array:
    """Compute the `_dual` (k,) of iteratively reweighted least squares, from a change w (k,)."""
    dual = np.zeros_like(w)
    for _ in range(4):
        weighted = A * tukey_weights(y - A @ w)[:, None]
        dual = _dual(weighted.T @ A, weighted.T @ y, S)
        w = S @ dual
    return dual


def _dual(N: Array, b: Array, S: Array) -> Array:
    """Solve normal equations with a prior covariance S (k, k) of the coordinates, maybe singular.

    The coordinates change by S times the dual (k,), and the K unknowns by their prior covariance
    with the coordinates times it, which costs less than `linear.posterior`.
    """
    return np.asarray(np.linalg.solve(np.eye(len(S)) + N @ S, b), float)
