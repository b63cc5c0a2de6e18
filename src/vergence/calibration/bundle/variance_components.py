"""Noise levels from the residuals: variance components by restricted likelihood (REML).

Each group of residuals (corners; readings of one kind) has its own variance. The restricted
likelihood accounts for the part of each group's noise that the fit has absorbed (Patterson and
Thompson 1971; geodesy's Helmert variance components are its stationary points: sigma^2 = r^T r /
redundancy).
It is climbed by Fisher scoring in log sigma^2, in the linearised problem, where a step costs one
elimination and no projection.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import cho_solve, solve_triangular
from scipy.special import digamma, polygamma

from vergence.arrays import Array
from vergence.calibration.bundle.solver import (
    LinearProblem,
    NoiseLevels,
    NormalEquations,
    cholesky,
    factorise,
    step,
)

FLOOR_PX = 1e-3
"""No corner is found better than that; keeps exact data from dividing by zero."""
LEAST_LEFT = 6
"""An image with fewer residuals left does not determine the noise of its corners."""
SCORING_STEPS = 40
"""At most; the scoring ends when no log variance changes by 1e-4."""
FLOOR_JOINT = 0.05
"""Least joint noise, in units of how well one image determines the joint; below, results no longer
change."""


def estimate_noise(
    linear: LinearProblem, noise: NoiseLevels, fixed: np.ndarray
) -> tuple[NoiseLevels, Array, Array]:
    """Return the noise levels of greatest restricted likelihood.

    Args:
        linear: the problem linearised near its optimum, with outliers weighted 0, onto what is
            free.
        noise: where to start.
        fixed: (1 + groups,) which levels are known and stay.

    Returns:
        The levels; (1 + groups,) the variance of log sigma^2 of each; and (1 + groups,) how many
        residuals of each group are left over after the fit.
    """
    s = 2 * np.log(noise.levels)
    # A group's readings count as exact below a part of what an image determines.
    floor = 2 * np.log([FLOOR_PX, *FLOOR_JOINT * image_levels(linear, noise)])
    s = np.where(fixed, s, np.maximum(s, floor))
    value, score, information, left = _evaluate(linear, noise, s)
    for _ in range(SCORING_STEPS):
        # A level at its floor is left out of the scoring step.
        stuck = fixed | ((s <= floor + 1e-9) & (score <= 0))
        fisher = information + 1e-9 * np.eye(len(s))
        fisher[stuck] = fisher[:, stuck] = 0
        fisher[stuck, stuck] = 1
        move = np.clip(np.linalg.solve(fisher, np.where(stuck, 0, score)), -2, 2)
        for _ in range(12):
            trial_s = np.where(stuck, s, np.maximum(s + move, floor))
            trial = _evaluate(linear, noise, trial_s)
            if trial[0] <= value + 1e-9:
                break
            move = move / 3
        else:
            break
        change, s = np.abs(trial_s - s).max(), trial_s
        value, score, information, left = trial
        if change < 1e-4:
            break
    variance = np.zeros(len(s))
    values, vectors = np.linalg.eigh(information[np.ix_(~fixed, ~fixed)])
    # A group with hardly a residual left has an information that is rounding, of either sign.
    variance[~fixed] = (vectors**2 / np.maximum(values, 1e-12)).sum(axis=1)
    return replace(noise, levels=np.exp(s / 2)), variance, left


def restricted_cost(linear: LinearProblem, noise: NoiseLevels) -> float:
    """Return -2 log of the restricted likelihood, but for a constant."""
    return _evaluate(linear, noise, 2 * np.log(noise.levels))[0]


def redundancy(linear: LinearProblem, noise: NoiseLevels) -> Array:
    """Return (1 + groups,) how many residuals of each group such noise would leave over.

    At a generous noise, less than one of a group says that its level cannot be estimated.
    """
    return _evaluate(linear, noise, 2 * np.log(noise.levels))[3]


def image_noise_scales(squares: Array, counts: Array) -> Array:
    """Return (M,) by what factor the corners of each image are noisier than typical ones.

    Far and leaning boards have small squares, and larger errors. The log variances of the images
    are assumed to be normally distributed (empirical Bayes): where they differ no more than chance
    explains for so few corners, all scales are one. By image there are the sum of squares of the
    residuals (M,) [px^2], and how many of them are left over after the fit (M,).
    """
    enough = counts > LEAST_LEFT
    scales = np.ones(len(squares))
    if enough.sum() < 2:
        return scales
    nu = counts[enough]
    level = np.log(np.maximum(squares[enough] / nu, FLOOR_PX**2)) - digamma(nu / 2) + np.log(nu / 2)
    chance = polygamma(1, nu / 2)  # the variance of the logarithm of a chi-square
    differ = max(0.0, float(np.var(level, ddof=1) - chance.mean()))
    typical = np.average(level, weights=1 / (differ + chance))
    scales[enough] = np.exp((level - typical) * differ / (differ + chance) / 2)
    return scales


def image_levels(linear: LinearProblem, noise: NoiseLevels) -> Array:
    """Return (groups,) how well one image determines the joints [rad]: the best of each group.

    Where an image shows a sum of readings only: how well it determines one if the others are known.
    """
    # An eye of a block may see no board, or have lost all its corners as outliers.
    n = linear.ll.shape[1]
    diagonal = linear.ll[:, np.arange(n), np.arange(n)]
    unseen = diagonal == 0
    matrix = linear.ll + unseen[..., None] * np.eye(n)
    known = np.linalg.cond(matrix) < 1e12
    alone = 1 / np.where(unseen, 1.0, diagonal)
    alone[known] = np.linalg.inv(matrix[known])[:, np.arange(n), np.arange(n)]
    alone[unseen] = np.inf
    typical = [
        np.median(own[finite]) if (finite := np.isfinite(own)).any() else np.inf for own in alone.T
    ]
    variance = noise.pixel_px**2 * np.array(typical)
    return np.sqrt([variance[noise.group == k].min() for k in range(len(noise.levels) - 1)])


def _evaluate(
    linear: LinearProblem, noise: NoiseLevels, s: Array
) -> tuple[float, Array, Array, Array]:
    """Return -2 log restricted likelihood, gradient and Fisher information in s, and redundancy."""
    noise = replace(noise, levels=np.exp(s / 2))
    factors = factorise(linear, noise)
    free, latent = step(factors)
    used = linear.weights[1] > 0
    error = linear.reading_residuals + latent - linear.rate * (linear.time @ free)
    group = np.broadcast_to(noise.group, error.shape)
    inverse_variance = used * noise.joint**-2
    squares = np.bincount(group.ravel(), (inverse_variance * error**2).ravel())
    squares = np.append(_corner_squares(linear, free, latent) / noise.pixel_px**2, squares)
    counts = np.append(linear.count, np.bincount(group.ravel(), used.ravel()))
    trace, norms = _absorbed(linear, factors, inverse_variance, noise)
    # What is assumed beforehand determines a part of the unknowns, which the corners need not.
    assumed = np.trace(cho_solve(cholesky(factors.schur), linear.prior[0]))
    unknowns = len(free) + latent.size - assumed
    redundancy = counts - np.concatenate([[unknowns - trace.sum()], trace])
    # With M the residual projector, F_gh = |M_gh|^2 / 2, and M M = M gives the corners' row.
    joint = norms + np.diag(counts[1:] - 2 * trace)
    across = redundancy[1:] - joint.sum(axis=1)
    fisher = np.zeros((len(s), len(s)))
    fisher[1:, 1:] = joint
    fisher[0, 1:] = fisher[1:, 0] = across
    fisher[0, 0] = redundancy[0] - across.sum()
    log_det = -np.linalg.slogdet(factors.ll_inverse)[1].sum()
    log_det += 2 * np.log(np.diag(cholesky(factors.schur)[0])).sum()
    value = float((counts * s).sum() + log_det + squares.sum())
    return value, (squares - redundancy) / 2, fisher / 2, redundancy


def _corner_squares(linear: LinearProblem, shared: Array, latent: Array) -> float:
    """Return the sum of squares of the corner errors after a step, in the linear model [px^2]."""
    linear_part = shared @ linear.g + (latent * linear.latent).sum()
    crossed = np.einsum("bgn,g,bn->", linear.gl, shared, latent, optimize=True)
    curved = shared @ linear.gg @ shared + 2 * crossed
    curved += np.einsum("bn,bnm,bm->", latent, linear.ll, latent, optimize=True)
    return float(linear.sum_squares - 2 * linear_part + curved)


def _absorbed(
    linear: LinearProblem, factors: NormalEquations, inverse_variance: Array, noise: NoiseLevels
) -> tuple[Array, Array]:
    """Return trace (groups,) and squared norms (groups, groups) of the readings' hat matrix.

    It is Q^1/2 E Q^1/2, E the posterior covariance of the joint errors: a block diagonal plus what
    the shared unknowns add, Z Z^T.
    """
    root = np.sqrt(inverse_variance)
    own = factors.ll_inverse * root[:, :, None] * root[:, None, :]
    U = (factors.coupling + linear.rate[:, :, None] * linear.time) * root[:, :, None]
    L, _ = cholesky(factors.schur)
    B, n, F = U.shape
    Z = solve_triangular(L, U.reshape(-1, F).T, lower=True).T.reshape(B, n, F)
    groups = [np.flatnonzero(noise.group == k) for k in range(len(noise.levels) - 1)]
    grams = [np.einsum("bnf,bng->fg", Z[:, k], Z[:, k], optimize=True) for k in groups]
    inner = Z @ np.swapaxes(Z, 1, 2)
    trace = np.array(
        [
            np.trace(own[:, k][:, :, k], axis1=1, axis2=2).sum() + np.trace(gram)
            for k, gram in zip(groups, grams, strict=True)
        ]
    )
    norms = np.empty((len(groups), len(groups)))
    for a, rows in enumerate(groups):
        for b, columns in enumerate(groups):
            D, ZZ = own[:, rows][:, :, columns], inner[:, rows][:, :, columns]
            norms[a, b] = (D * (D + 2 * ZZ)).sum() + (grams[a] * grams[b]).sum()
    return trace, norms
