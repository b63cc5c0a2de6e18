"""Noise levels from the residuals: variance components by restricted likelihood (REML).

Each noise level has its own variance. The restricted likelihood accounts for the part of each
level's noise that the fit has absorbed (Patterson and Thompson 1971; geodesy's Helmert variance
components are its stationary points: sigma^2 = r^T r / redundancy). It is climbed by Fisher
scoring in log sigma^2, in the linearised problem, where a step costs one elimination and no
evaluation of residuals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve
from scipy.special import digamma, polygamma

from vergence.arrays import Array
from vergence.estimation.linear import Linear, Reduced, cholesky, eliminate
from vergence.estimation.residual import Levels

SCORING_STEPS = 40
"""At most; the scoring ends when no log variance changes by 1e-4."""
FLOOR_DETERMINED = 0.05
"""Least level, relative to how well all other data determine what is measured; below, results no
longer change."""
LEAST_LEFT = 6
"""Residuals left in a row from which it determines its own noise."""


@dataclass(frozen=True)
class Level:
    """A noise level to be estimated or given."""

    name: str
    start: float
    """Generous: good data should not pass for outliers before the level is known."""
    given: bool = False
    usual: float | None = None
    """Assumed where the data do not determine the level; None: they must."""
    floor: float = 0.0
    """No measurement is better."""
    latent: tuple[int, ...] = ()
    """Which latent unknowns of an element it measures directly, as an encoder does its angle."""


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """The levels of greatest restricted likelihood."""

    levels: Levels
    log_variance: Array
    """(Q,) variance of log sigma^2 of each level."""
    redundancy: Array
    """(Q,) residuals of each level that are left over after the fit."""


def estimate_noise(
    linear: Linear, specification: Sequence[Level], levels: Levels, fixed: np.ndarray
) -> NoiseEstimate:
    """Estimate noise levels by restricted maximum likelihood.

    Args:
        linear: near the optimum, with inlier weights, in the free directions; its levels are those
            of the specification and perhaps the unit level after them.
        specification: (Q,) of the levels.
        levels: to start from.
        fixed: (Q,) which are known and stay.
    """
    names = [level.name for level in specification]
    s = 2 * np.log([levels[name] for name in names])
    determined = determined_by_others(linear, specification, levels)
    floor = 2 * np.log(
        [max(each.floor, FLOOR_DETERMINED * determined.get(each.name, 0.0), 1e-300)
         for each in specification]
    )  # fmt: skip
    s = np.where(fixed, s, np.maximum(s, floor))
    now = _evaluate(linear, names, s)
    for _ in range(SCORING_STEPS):
        # A level at its floor is left out of the scoring step.
        stuck = fixed | ((s <= floor + 1e-9) & (now.score <= 0))
        if stuck.all():
            break
        fisher = now.information + 1e-9 * np.eye(len(s))
        fisher[stuck] = fisher[:, stuck] = 0
        fisher[stuck, stuck] = 1
        move = np.clip(np.linalg.solve(fisher, np.where(stuck, 0, now.score)), -2, 2)
        for _ in range(12):
            trial_s = np.where(stuck, s, np.maximum(s + move, floor))
            trial = _evaluate(linear, names, trial_s)
            if trial.cost <= now.cost + 1e-9:
                break
            move = move / 3
        else:
            break
        change, s, now = np.abs(trial_s - s).max(), trial_s, trial
        if change < 1e-4:
            break
    variance = np.zeros(len(s))
    values, vectors = np.linalg.eigh(now.information[np.ix_(~fixed, ~fixed)])
    # The information of a level with almost no residual left is rounding, of either sign.
    variance[~fixed] = (vectors**2 / np.maximum(values, 1e-12)).sum(axis=1)
    estimated = dict(zip(names, np.exp(s / 2).tolist(), strict=True))
    return NoiseEstimate(estimated, variance, now.redundancy)


def redundancy(linear: Linear, levels: Levels) -> Array:
    """Count the residuals (Q,) of each level that such noise would leave over.

    At a generous noise, a level with less than one cannot be estimated.
    """
    names = [name for name in linear.names if name in levels]
    return _evaluate(linear, names, 2 * np.log([levels[name] for name in names])).redundancy


def determined_by_others(
    linear: Linear, specification: Sequence[Level], levels: Levels
) -> dict[str, float]:
    """Compute how well one element's other data determine what a level measures directly.

    By the name of the level: the median over elements, the best of the latent unknowns that it
    measures. Where only a sum of latent unknowns is determined: as if the others were known.
    """
    direct = [level for level in specification if level.latent]
    if not direct:
        return {}
    others = ~np.isin(linear.names, [level.name for level in direct])
    ll = np.tensordot(linear.precisions(levels) * others, linear.ll, 1)
    n = ll.shape[1]
    # An element may have no other data, or only outliers.
    diagonal = ll[:, np.arange(n), np.arange(n)]
    unseen = diagonal <= 1e-7 * diagonal.max(axis=0, initial=0)
    matrix = ll + unseen[..., None] * np.eye(n)
    known = np.linalg.cond(matrix) < 1e12
    variance = 1 / np.where(unseen, 1.0, diagonal)
    variance[known] = np.linalg.inv(matrix[known])[:, np.arange(n), np.arange(n)]
    variance[unseen] = np.inf
    typical = np.array([
        np.median(own[finite]) if (finite := np.isfinite(own)).any() else np.inf
        for own in variance.T
    ])  # fmt: skip
    return {level.name: float(np.sqrt(typical[list(level.latent)].min())) for level in direct}


def row_noise_scales(squares: Array, counts: Array, floor: float) -> Array:
    """Estimate the noise of each row relative to the typical one (empirical Bayes).

    The log variances of the rows are assumed to be normally distributed. Where they differ no more
    than chance explains for so few residuals, all scales are one.

    Args:
        squares: (M,) sum of squares of the residuals of each row.
        counts: (M,) how many of them are left over after the fit.
        floor: least standard deviation.
    """
    enough = counts > LEAST_LEFT
    scales = np.ones(len(squares))
    if enough.sum() < 2:
        return scales
    nu = counts[enough]
    level = np.log(np.maximum(squares[enough] / nu, floor**2)) - digamma(nu / 2) + np.log(nu / 2)
    chance = polygamma(1, nu / 2)  # the variance of the logarithm of a chi-square
    differ = max(0.0, float(np.var(level, ddof=1) - chance.mean()))
    typical = np.average(level, weights=1 / (differ + chance))
    scales[enough] = np.exp((level - typical) * differ / (differ + chance) / 2)
    return scales


@dataclass(frozen=True, eq=False)
class _Evaluation:
    cost: float
    score: Array
    information: Array
    redundancy: Array


def _evaluate(linear: Linear, names: Sequence[str], s: Array) -> _Evaluation:
    """Evaluate the restricted likelihood, its gradient and Fisher information, at log variances.

    The first level's share follows from the others': the hat matrix of all data is a projector.
    """
    levels = dict(zip(names, np.exp(s / 2).tolist(), strict=True))
    reduced = eliminate(linear, levels)
    order = [linear.names.index(name) for name in names]
    precisions = linear.precisions(levels)
    squares = _squares_after(linear, *reduced.step()) * precisions
    trace, norms = _hat_matrix(linear, reduced, precisions)
    trace[0] = len(reduced.schur) + reduced.right[1].size - trace[1:].sum()
    redundancy = linear.count - trace
    # With M the residual projector, F_gh = |M_gh|^2 / 2, and M M = M gives the first row.
    fisher = norms + np.diag(linear.count - 2 * trace)
    fisher[0] = fisher[:, 0] = 0
    fisher[0] = fisher[:, 0] = redundancy - fisher.sum(axis=1)
    fisher[0, 0] = redundancy[0] - fisher[0, 1:].sum()
    log_det = -np.linalg.slogdet(reduced.ll_inverse)[1].sum()
    log_det += 2 * np.log(np.diag(cholesky(reduced.schur)[0])).sum()
    cost = float(linear.count[order] @ s + log_det + squares.sum())
    score = (squares - redundancy)[order] / 2
    return _Evaluation(cost, score, fisher[np.ix_(order, order)] / 2, redundancy[order])


def _squares_after(linear: Linear, shared: Array, latent: Array) -> Array:
    """Compute the sums of squares (Q,) after a step, in the linear model."""
    slope = linear.g @ shared + np.einsum("bn,qbn->q", latent, linear.l)
    curved = (linear.gg @ shared) @ shared
    curved += 2 * np.einsum("qbgn,g,bn->q", linear.gl, shared, latent, optimize=True)
    curved += np.einsum("bn,qbnm,bm->q", latent, linear.ll, latent, optimize=True)
    return linear.squares - 2 * slope + curved


def _hat_matrix(linear: Linear, reduced: Reduced, precisions: Array) -> tuple[Array, Array]:
    """Compute traces (Q,) and squared norms (Q, Q) of the blocks of the data's hat matrix.

    With N_g the normal matrix of a level and C the covariance of all unknowns these are
    tr(C N_g) and tr(C N_g C N_h). C = D + U S^-1 U^T, D the inverse of the latent blocks alone, S
    the Schur complement, and U the identity above minus the coupling. Only the blocks of levels
    after the first are computed; the first level has the most data.
    """
    Q, D, coupling = len(linear.names), reduced.ll_inverse, reduced.coupling
    F = coupling.shape[2]
    covariance = cho_solve(cholesky(reduced.schur), np.eye(F))
    trace, norms = np.zeros(Q), np.zeros((Q, Q))
    own, across, inner = {}, {}, {}
    flat = coupling.reshape(-1, F)
    for q in range(1, Q):
        ll = precisions[q] * linear.ll[q]
        gl = precisions[q] * linear.gl[q]
        follows = ll @ coupling
        rows = np.swapaxes(gl, 1, 2)
        # U^T N U, and the latent rows of N U.
        K = precisions[q] * linear.gg[q] + flat.T @ follows.reshape(-1, F)
        if rows.any():
            half = rows.reshape(-1, F).T @ flat
            K -= half + half.T
        own[q], across[q], inner[q] = D @ ll, rows - follows, covariance @ K
        trace[q] = np.trace(own[q], axis1=1, axis2=2).sum() + np.trace(inner[q])
    for q in own:
        left = D @ across[q]
        for h in range(q, Q):
            crossed = left.reshape(-1, F).T @ across[h].reshape(-1, F)
            norm = (own[q] * np.swapaxes(own[h], 1, 2)).sum()
            norm += 2 * (covariance * crossed.T).sum() + (inner[q] * inner[h].T).sum()
            norms[q, h] = norms[h, q] = norm
    return trace, norms
