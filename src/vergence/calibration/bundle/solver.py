"""Sparse, robust Gauss-Newton steps for bundle adjustment.

Blocks of latent unknowns are eliminated one by one (the Schur complement), which leaves a small
dense system in the shared ones: the cost grows linearly with the number of views.

Levels of noise enter as precisions, 1 / sigma^2. Corners beyond `OUTLIER` standard deviations lose
weight as in Cauchy's loss; within, the loss is quadratic, so that good data lose nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from vergence.arrays import Array, scatter_add
from vergence.calibration.bundle.problem import (
    BundleProblem,
    BundleState,
    Index,
    corner_errors,
    head_size,
    jacobians,
    joint_rates,
    prior,
    reading_residuals,
    refit_trajectory,
    retract,
)
from vergence.errors import VergenceError

OUTLIER = 4.0
"""Standard deviations; a good corner exceeds it once in 3000, a good joint reading in 16000."""
Weights = tuple[Array, Array]
"""Robust weights between 0 and 1: of corners (M, K), 0 where not seen, and of readings (B, n)."""


@dataclass(frozen=True, eq=False)
class NoiseLevels:
    """Standard deviations, with a group for each kind of reading."""

    levels: Array
    """(1 + groups,): of one coordinate of a corner in a typical image [px], see
    BundleProblem.noise_scale; then of the readings [rad], or [m] for translations of eye poses."""
    group: Index
    """(n,) group of each latent unknown of a block."""
    outlier: float = OUTLIER
    """Standard deviations beyond which a residual loses weight."""

    @property
    def pixel_px(self) -> float:
        """Return the noise of one coordinate of a corner."""
        return float(self.levels[0])

    @property
    def joint(self) -> Array:
        """(n,) of each latent unknown of a block."""
        return self.levels[1:][self.group]


@dataclass(frozen=True, eq=False)
class LinearProblem:
    """The problem linearised: J^T W J and -J^T W r of the corners in pixels, and joint errors.

    G counts the shared unknowns, or the directions of them that are free (see project_onto).
    """

    gg: Array
    """(G, G)."""
    gl: Array
    """(B, G, n)."""
    ll: Array
    """(B, n, n)."""
    g: Array
    """(G,)."""
    latent: Array
    """(B, n)."""
    sum_squares: float
    """Weighted squares of the corner errors [px^2], in units of the images' noise scale."""
    count: float
    """Number of corner coordinates that have a weight."""
    reading_residuals: Array
    """(B, n)."""
    weights: Weights
    rate: Array
    """(B, n): the joint errors change by minus this with the time offset."""
    time: Array
    """(G,) how the time offset changes with each shared unknown."""
    prior: tuple[Array, Array]
    """(G, G) the information of what is assumed of the shared unknowns, and (G,) its gradient."""


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """The normal equations for given noise, with the latent unknowns eliminated."""

    ll_inverse: Array
    """(B, n, n)."""
    coupling: Array
    """(B, n, G) ll_inverse times the latent rows of the matrix."""
    schur: Array
    """(G, G)."""
    right: tuple[Array, Array]
    """(G,), (B, n)."""


class Errors(NamedTuple):
    """Errors of the corners and of the readings at a state."""

    corner: Array
    """(M, K, 2) [px], of `corner_errors`."""
    joint: Array
    """(B, n), of `reading_residuals`."""


def errors_of(problem: BundleProblem, state: BundleState) -> Errors:
    """Return the errors of a state."""
    return Errors(corner_errors(problem, state), reading_residuals(problem, state))


def linearise(
    problem: BundleProblem, state: BundleState, errors: Errors, weights: Weights
) -> LinearProblem:
    """Return the problem linearised at a state with these errors."""
    G, (B, n) = len(problem.free), problem.reading.shape
    shared, index, latent = jacobians(problem, state)
    _, half_gradient, information = prior(problem, state)
    root = np.sqrt(weights[0])[..., None] / problem.noise_scale[:, None, None]
    M = len(index)
    J = (shared * root[..., None]).reshape(M, -1, index.shape[1])
    L = (latent * root[..., None]).reshape(M, -1, n)
    r = (errors.corner * root).reshape(M, -1, 1)
    J_T, L_T = np.swapaxes(J, 1, 2), np.swapaxes(L, 1, 2)
    block, angle = problem.block[:, None, None], np.arange(n)
    row, column = index[:, :, None], index[:, None, :]
    gg = scatter_add(J_T @ J, (row, column), (G, G))
    gl = scatter_add(J_T @ L, (block, row, angle), (B, G, n))
    ll = scatter_add(L_T @ L, (block, angle[:, None], angle), (B, n, n))
    g = -scatter_add(J_T @ r, (row,), (G,))
    right = -scatter_add(L_T @ r, (block, angle[:, None]), (B, n))
    return LinearProblem(
        gg, gl, ll, g, right,
        sum_squares=float((r**2).sum()),
        count=2.0 * np.count_nonzero(weights[0]),
        reading_residuals=errors.joint,
        weights=weights,
        rate=joint_rates(problem, state),
        time=np.eye(1, G, head_size(problem) - 1)[0],
        prior=(np.diag(information), -half_gradient),
    )  # fmt: skip


def project_onto(linear: LinearProblem, basis: Array) -> LinearProblem:
    """Return the linear problem in the directions of a basis (G, F) of the shared unknowns."""
    rows = csr_array(basis.T)  # boards have directions of their own: most of it is zeros
    B, G, n = linear.gl.shape
    gl = rows @ linear.gl.transpose(1, 0, 2).reshape(G, B * n)
    return replace(
        linear,
        gg=rows @ (rows @ linear.gg).T,
        gl=np.ascontiguousarray(gl.reshape(-1, B, n).transpose(1, 0, 2)),
        g=rows @ linear.g,
        time=rows @ linear.time,
        prior=(rows @ (rows @ linear.prior[0]).T, rows @ linear.prior[1]),
    )


def factorise(linear: LinearProblem, noise: NoiseLevels, damping: float = 0.0) -> NormalEquations:
    """Return the normal equations, damped (Levenberg, Marquardt) relative to their diagonal."""
    pixel = noise.pixel_px**-2
    # A reading keeps a little weight: without it, an eye with outliers only would have no pose.
    joint = np.maximum(linear.weights[1], 1e-9) * noise.joint**-2
    n = joint.shape[1]
    eye = np.eye(n, dtype=bool)
    ll = pixel * linear.ll + np.where(eye, joint[:, :, None], 0.0)
    ll = ll + damping * np.where(eye, ll, 0.0)
    timing, row = linear.rate * joint, linear.time
    gl = pixel * linear.gl - row[:, None] * timing[:, None, :]
    gg = pixel * linear.gg + np.outer(row, row) * (linear.rate * timing).sum() + linear.prior[0]
    gg[np.diag_indices_from(gg)] *= 1 + damping
    right_g = pixel * linear.g + row * (timing * linear.reading_residuals).sum() + linear.prior[1]
    right_l = pixel * linear.latent - joint * linear.reading_residuals
    ll_inverse: Array = np.linalg.inv(ll).astype(float, copy=False)
    coupling = ll_inverse @ np.swapaxes(gl, 1, 2)
    G = len(gg)
    schur = gg - gl.transpose(1, 0, 2).reshape(G, -1) @ coupling.reshape(-1, G)
    return NormalEquations(ll_inverse, coupling, (schur + schur.T) / 2, (right_g, right_l))


def step(factors: NormalEquations) -> tuple[Array, Array]:
    """Return the Gauss-Newton step: along the shared unknowns (G,), and latent (B, n)."""
    right_g, right_l = factors.right
    reduced = right_g - np.einsum("bnf,bn->f", factors.coupling, right_l)
    free = cho_solve(cholesky(factors.schur), reduced)
    latent = (factors.ll_inverse @ right_l[..., None])[..., 0] - factors.coupling @ free
    return free, latent


def cholesky(matrix: Array) -> tuple[Array, bool]:
    """Factor a positive definite matrix; the least ridge that works keeps null ones solvable."""
    unit = np.trace(matrix) / max(len(matrix), 1) * np.eye(len(matrix))
    for ridge in 10.0 ** np.arange(-13, -3):
        try:
            return cho_factor(matrix + ridge * unit, lower=True)
        except (np.linalg.LinAlgError, ValueError):  # the latter: not finite
            continue
    raise VergenceError(
        "The equations of the bundle adjustment cannot be solved: look for wild corners, poses or "
        "readings, and for rows whose images and readings are of different moments."
    )


def robust_weights(problem: BundleProblem, errors: Errors, noise: NoiseLevels) -> Weights:
    """Return Cauchy's weights beyond noise.outlier and 1 within."""
    corner, joint = (
        (noise.outlier / np.maximum(s, noise.outlier)) ** 2
        if np.isfinite(noise.outlier)
        else np.ones_like(s)
        for s in _in_noise(problem, errors, noise)
    )
    return np.where(problem.seen, corner, 0.0), joint


def inlier_weights(problem: BundleProblem, errors: Errors, noise: NoiseLevels) -> Weights:
    """Return 1 for what lies within noise.outlier and 0 for the rest."""
    corner, joint = robust_weights(problem, errors, noise)
    return (corner == 1).astype(float), (joint == 1).astype(float)


def corner_distances(problem: BundleProblem, errors: Errors) -> Array:
    """Return (M, K) [px] the lengths of the corner errors, in units of the images' noise scale."""
    return np.linalg.norm(errors.corner, axis=-1) / problem.noise_scale[:, None]


def _in_noise(problem: BundleProblem, errors: Errors, noise: NoiseLevels) -> tuple[Array, Array]:
    """Return the sizes of all errors, (M, K) and (B, n), in units of the noise."""
    corner = corner_distances(problem, errors) / noise.pixel_px
    return corner, np.abs(errors.joint) / noise.joint


def cost(problem: BundleProblem, state: BundleState, errors: Errors, noise: NoiseLevels) -> float:
    """Return the robust sum of squares in units of the noise, and of what is assumed beforehand.

    Infinite behind a camera.
    """
    total = prior(problem, state)[0]
    for s in _in_noise(problem, errors, noise):
        total += (np.minimum(s, noise.outlier) ** 2).sum()
        if np.isfinite(noise.outlier):
            beyond = np.maximum(s / noise.outlier, 1.0)
            total += 2 * noise.outlier**2 * np.log(beyond).sum()
    return float(total) if np.isfinite(total) else np.inf


def minimise(
    problem: BundleProblem,
    state: BundleState,
    noise: NoiseLevels,
    basis: Array,
    *,
    iterations: int = 60,
) -> tuple[BundleState, bool, LinearProblem]:
    """Return the state of least cost for given noise, whether it converged, and its linear problem.

    Levenberg and Marquardt's method; the linear problem is that of the state where it converged.
    """
    problem = refit_trajectory(problem, state)
    errors = errors_of(problem, state)
    damping, lowest = 1e-6, cost(problem, state, errors, noise)
    while True:
        linear = linearise(problem, state, errors, robust_weights(problem, errors, noise))
        free_linear, iterations = project_onto(linear, basis), iterations - 1
        while True:
            factors = factorise(free_linear, noise, damping)
            free, latent = step(factors)
            gain = float(free @ factors.right[0] + (latent * factors.right[1]).sum())
            # A step of a ten-thousandth of a standard deviation changes nothing.
            if gain < 1e-8:
                return state, True, linear
            try:
                trial = retract(problem, state, basis @ free, latent)
                found = errors_of(problem, trial)
                reached = cost(problem, trial, found, noise)
            except ValueError:  # a focal length that is not positive
                trial, found, reached = None, errors, np.inf
            if trial is not None and reached <= lowest + 1e-12 * abs(lowest):
                state, errors, damping = trial, found, max(damping / 10, 1e-12)
                if problem.around is not None:
                    problem = refit_trajectory(problem, state)
                    errors = errors_of(problem, state)
                    reached = cost(problem, state, errors, noise)
                lowest = reached
                break
            damping *= 10
            if damping > 1e8:
                return state, False, linear
        if iterations == 0:
            weights = robust_weights(problem, errors, noise)
            return state, False, linearise(problem, state, errors, weights)
