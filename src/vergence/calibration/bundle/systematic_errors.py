"""Systematic errors of corners: what neither more corners nor more views average out.

A lens that departs from its model, or a detector that errs alike in the same part of the image,
moves corners by a smooth field over the image. Part of it is absorbed by the unknowns, which are
then wrong by more than independent errors explain; the rest stays in the residuals. The size of the
field is estimated from that rest; the absorbed part is *assumed* to be as large. What is known
beforehand of the detector sets a least size.

The field of each camera is a sum of Legendre polynomials in both coordinates of the image, up to
`FIELD_DEGREE`, with coefficients of one standard deviation.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import legvander2d
from scipy.linalg import cho_solve

from vergence.arrays import Array, scatter_add
from vergence.calibration.bundle.problem import BundleProblem, BundleState, corner_errors, jacobians
from vergence.calibration.bundle.solver import (
    LinearProblem,
    NoiseLevels,
    cholesky,
    factorise,
    project_onto,
    step,
)

FIELD_DEGREE = 4
LEAST_FIELD_CORNERS = 200
"""A camera with fewer does not determine a field of thirty coefficients."""


def systematic_errors(
    problem: BundleProblem,
    state: BundleState,
    linear: LinearProblem,
    noise: NoiseLevels,
    basis: Array,
) -> tuple[tuple[float, ...], Array]:
    """Return how large such fields are, and what they do to the unknowns.

    Args:
        problem: the data.
        state: the optimum.
        linear: the problem linearised there, with inliers only.
        noise: standard deviations.
        basis: (G, F) free directions of the shared unknowns.

    Returns:
        By camera the rms of one coordinate of the field over the image [px], and (G, G) what the
        fields add to the covariance of the shared unknowns. Zeros where poses of a target were
        measured instead of corners: they have no place in the image.
    """
    if problem.measured is not None:
        return (0.0,) * len(problem.cameras), np.zeros((len(problem.free), len(problem.free)))
    weights = linear.weights[0]
    factors = factorise(project_onto(linear, basis), noise)
    schur = cholesky(factors.schur)
    # The state is the robust optimum: without its outliers it would stand a little elsewhere.
    moved = step(factors)
    shared, index, latent = jacobians(problem, state)
    errors = corner_errors(problem, state)
    precision = (weights / (noise.pixel_px * problem.noise_scale[:, None]) ** 2)[..., None]
    levels, covariance = [], np.zeros((len(problem.free), len(problem.free)))
    for c, mounted in enumerate(state.head.cameras.values()):
        lens = mounted.intrinsics
        mine = np.flatnonzero(problem.camera == c)
        estimable = np.count_nonzero(weights[mine]) >= LEAST_FIELD_CORNERS
        if not len(mine) or not (estimable or problem.systematic_px):
            levels.append(0.0)
            continue
        # Where the corners should be: where they were seen goes with their own errors.
        fields = _fields(problem.pixels[mine] + errors[mine], lens.width, lens.height)
        weighed = fields * precision[mine][..., None]
        N = len(mine)
        w = weighed.reshape(N, -1, fields.shape[-1])
        J, L = (each[mine].reshape(N, w.shape[1], -1) for each in (shared, latent))
        column = np.arange(w.shape[2])
        places = index[mine][..., None], column
        onto = scatter_add(np.swapaxes(J, 1, 2) @ w, places, (len(problem.free), len(column)))
        places = problem.block[mine][:, None, None], np.arange(L.shape[2])[:, None], column
        shape = (*linear.latent.shape, len(column))
        right_l = scatter_add(np.swapaxes(L, 1, 2) @ w, places, shape)
        right_g = basis.T @ onto
        free = cho_solve(schur, right_g - np.einsum("bnf,bnk->fk", factors.coupling, right_l))
        follows = factors.ll_inverse @ right_l - factors.coupling @ free
        taken = right_g.T @ free + np.einsum("bnk,bnj->kj", right_l, follows)
        left = np.einsum("mkxa,mkxb->ab", weighed, fields, optimize=True) - taken
        seen = np.einsum("mkxa,mkx->a", weighed, errors[mine])
        seen += right_g.T @ moved[0] + np.einsum("bnk,bn->k", right_l, moved[1])
        # Of functions whose mean square is one, for each coordinate.
        per_px = np.sqrt(2 / fields.shape[-1])
        std = max(likeliest_std(left, seen) if estimable else 0.0, problem.systematic_px * per_px)
        absorbed = basis @ free
        covariance += std**2 * absorbed @ absorbed.T
        levels.append(float(std / per_px))
    return tuple(levels), covariance


def _fields(pixels: Array, width: int, height: int) -> Array:
    """Return (M, K, 2, 2 n) the n functions in x, and in y, at pixels (M, K, 2)."""
    x, y = (2 * pixels[..., k] / (extent - 1) - 1 for k, extent in enumerate((width, height)))
    i, j = np.divmod(np.arange((FIELD_DEGREE + 1) ** 2), FIELD_DEGREE + 1)
    low = i + j <= FIELD_DEGREE
    values = legvander2d(x, y, [FIELD_DEGREE, FIELD_DEGREE])[..., low]
    values = values * np.sqrt((2 * i[low] + 1) * (2 * j[low] + 1))
    fields = np.zeros((*pixels.shape, 2 * values.shape[-1]))
    fields[..., 0, : values.shape[-1]] = fields[..., 1, values.shape[-1] :] = values
    return fields


def likeliest_std(left: Array, seen: Array) -> float:
    """Return the coefficients' standard deviation of greatest likelihood for the residuals.

    Their projection y onto the fields has the covariance G + s^2 G^2, with G what is left of the
    fields after the fit, in units of the noise.
    """
    values, vectors = np.linalg.eigh((left + left.T) / 2)
    if not values.max() > 0:  # of a fit that has not converged: nothing can be told
        return 0.0
    kept = values > 1e-5 * values.max()
    g, squares = values[kept], (vectors.T @ seen)[kept] ** 2

    def cost(log_std: float) -> float:
        variance = g + np.exp(2 * log_std) * g**2
        return float((np.log(variance) + squares / variance).sum())

    # From what has no effect to what would be seen in every direction.
    log_std = np.linspace(-3, 6, 300) - 0.5 * np.log(g.max())
    costs = np.array([cost(each) for each in log_std])
    return float(np.exp(log_std[costs.argmin()]))
