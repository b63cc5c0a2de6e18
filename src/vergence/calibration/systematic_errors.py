"""Systematic errors of corners: what neither more corners nor more views average out.

A lens that departs from its model, or a detector, moves corners by a smooth field over the image: a
sum of Legendre polynomials with coefficients of one standard deviation. The unknowns absorb part of
it. Its size is estimated from the part that stays in the residuals, and is at least what is known
of the detector; the absorbed part is *assumed* to be as large.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import legvander2d
from scipy.linalg import cho_solve

from vergence.arrays import Array, scatter_add
from vergence.calibration.residuals import CORNERS, Reprojection
from vergence.estimation.adjustment import Adjustment
from vergence.estimation.linear import cholesky, eliminate
from vergence.estimation.residual import Levels

FIELD_DEGREE = 4
"""Smoother fields than the fourth degree look like the lens, rougher ones like noise."""
LEAST_FIELD_CORNERS = 200
"""A camera with fewer corners does not determine a field of thirty coefficients."""


def systematic_errors(
    found: Adjustment, basis: Array, follows: Array, levels: Levels
) -> tuple[dict[str, float], Array]:
    """Estimate smooth errors over the images, and their effect on the unknowns.

    The first residual of the adjustment is the reprojection. At noise of these levels the unknowns
    absorb part of the fields along a basis (G, F), and all of them change by `follows` (G, F) then.

    Returns:
        By camera the rms of one coordinate of the field over the image [px], and (G, G) what the
        fields add to the covariance of the shared unknowns.
    """
    measured, x = found.residuals[0], found.x
    assert isinstance(measured, Reprojection)
    detections = measured.detections
    weights = found.linear.weights[0]
    free = found.linear.onto(basis)
    reduced = eliminate(free, levels)
    schur = cholesky(reduced.schur)
    # The state is the robust optimum: without its outliers it would stand a little elsewhere.
    moved = reduced.step()
    rows = measured.rows(x)
    assert rows.by_latent is not None
    errors = found.errors[0].reshape(measured.pixels.shape)
    noise = levels[CORNERS] * measured.noise_scale[:, None]
    precision = (weights / noise**2)[..., None]
    sizes, covariance = {}, np.zeros((len(basis), len(basis)))
    for c, (name, mounted) in enumerate(x["head"].cameras.items()):
        lens, mine = mounted.intrinsics, np.flatnonzero(detections.camera == c)
        estimable = np.count_nonzero(weights[mine] == 1) >= LEAST_FIELD_CORNERS
        if not len(mine) or not (estimable or measured.systematic_px):
            sizes[name] = 0.0
            continue
        # Where the corners should be: where they were seen goes with their own errors.
        fields = _fields(measured.pixels[mine] + errors[mine], lens.width, lens.height)
        weighed = fields * precision[mine][..., None]
        w = weighed.reshape(len(mine), -1, fields.shape[-1])
        J, L = rows.by_shared[mine], rows.by_latent[mine]
        column = np.arange(w.shape[2])
        places = rows.columns[mine][..., None], column
        onto = scatter_add(np.swapaxes(J, 1, 2) @ w, places, (len(basis), len(column)))
        places = detections.posture[mine][:, None, None], np.arange(L.shape[2])[:, None], column
        shape = (*free.l.shape[1:], len(column))
        right_l = scatter_add(np.swapaxes(L, 1, 2) @ w, places, shape)
        right_g = basis.T @ onto
        change = cho_solve(schur, right_g - np.einsum("bnf,bnk->fk", reduced.coupling, right_l))
        of_latent = reduced.ll_inverse @ right_l - reduced.coupling @ change
        taken = right_g.T @ change + np.einsum("bnk,bnj->kj", right_l, of_latent)
        left = np.einsum("mkxa,mkxb->ab", weighed, fields, optimize=True) - taken
        seen = np.einsum("mkxa,mkx->a", weighed, errors[mine])
        seen += right_g.T @ moved[0] + np.einsum("bnk,bn->k", right_l, moved[1])
        # Of functions whose mean square is one, for each coordinate.
        per_px = np.sqrt(2 / fields.shape[-1])
        std = max(likeliest_std(left, seen) if estimable else 0.0, measured.systematic_px * per_px)
        absorbed = follows @ change
        covariance += std**2 * absorbed @ absorbed.T
        sizes[name] = float(std / per_px)
    return sizes, covariance


def _fields(pixels: Array, width: int, height: int) -> Array:
    """Evaluate the n functions in x, and in y, (M, K, 2, 2 n) at pixels (M, K, 2)."""
    x, y = (2 * pixels[..., k] / (extent - 1) - 1 for k, extent in enumerate((width, height)))
    i, j = np.divmod(np.arange((FIELD_DEGREE + 1) ** 2), FIELD_DEGREE + 1)
    low = i + j <= FIELD_DEGREE
    values = legvander2d(x, y, [FIELD_DEGREE, FIELD_DEGREE])[..., low]
    values = values * np.sqrt((2 * i[low] + 1) * (2 * j[low] + 1))
    fields = np.zeros((*pixels.shape, 2 * values.shape[-1]))
    fields[..., 0, : values.shape[-1]] = fields[..., 1, values.shape[-1] :] = values
    return fields


def likeliest_std(left: Array, seen: Array) -> float:
    """Estimate the coefficients' standard deviation of greatest likelihood for the residuals.

    Their projection y onto the fields has the covariance G + s^2 G^2, with G what is left of the
    fields after the fit, in units of the noise.
    """
    values, vectors = np.linalg.eigh((left + left.T) / 2)
    if not values.max() > 0:  # a fit that has not converged
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
