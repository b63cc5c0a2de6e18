"""Normal equations by noise level, and their solution by the Schur complement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from vergence.arrays import Array, scatter_add
from vergence.errors import VergenceError
from vergence.estimation.residual import (
    LOST_WEIGHT,
    UNIT,
    Levels,
    Residuals,
    coordinate_levels,
    noise_scales,
)
from vergence.estimation.variables import Variables


@dataclass(frozen=True, eq=False)
class Linear:
    """Residuals linearised: J^T W J and -J^T W e for each of Q noise levels, without its value.

    G counts the shared unknowns, or the directions of them in `onto`; B elements have n unknowns.
    """

    names: tuple[str, ...]
    """(Q,) of the noise levels."""
    gg: Array
    """(Q, G, G)."""
    gl: Array
    """(Q, B, G, n)."""
    ll: Array
    """(Q, B, n, n)."""
    g: Array
    """(Q, G)."""
    l: Array  # noqa: E741 - latent, as g is for the shared unknowns
    """(Q, B, n)."""
    squares: Array
    """(Q,) weighted sums of squares."""
    count: Array
    """(Q,) coordinates that count."""
    weights: tuple[Array, ...]
    """Of each residual, see `residual.robust_weights`."""

    def precisions(self, levels: Levels) -> Array:
        """Compute the inverse variances (Q,) of the levels."""
        return np.array([levels.get(name, 1.0) ** -2 for name in self.names])

    def at(self, levels: Levels) -> Linear:
        """Sum the equations at given noise levels, as those of the unit level alone."""
        p = self.precisions(levels)
        sums = {
            name: np.tensordot(p, getattr(self, name), 1)[None]
            for name in ("gg", "gl", "ll", "g", "l", "squares")
        }
        return replace(self, names=(UNIT,), count=self.count.sum(keepdims=True), **sums)

    def onto(self, basis: Array) -> Linear:
        """Project the equations onto a basis (G, F) of the shared unknowns."""
        if not self.gg.shape[1]:
            return self
        rows = csr_array(basis.T)  # nuisance blocks have directions of their own: mostly zeros
        Q, B, G, n = self.gl.shape
        gl = rows @ self.gl.transpose(2, 0, 1, 3).reshape(G, Q * B * n)
        gl = gl.reshape(basis.shape[1], Q, B, n).transpose(1, 2, 0, 3)
        gg = np.array([rows @ (rows @ each).T for each in self.gg])
        return replace(self, gg=gg, gl=np.ascontiguousarray(gl), g=(rows @ self.g.T).T)


def linearise(
    residuals: Residuals, x: Variables, errors: Sequence[Array], weights: Sequence[Array]
) -> Linear:
    """Linearise residuals at the unknowns x, where they have these errors and weights."""
    names = tuple(dict.fromkeys(name for r in residuals for name in np.atleast_1d(r.level)))
    G, (B, n), Q = x.size, (len(x.latent.value), x.latent.size), len(names)
    gg, g = np.zeros((Q, G, G)), np.zeros((Q, G))
    gl, ll, l = np.zeros((Q, B, G, n)), np.zeros((Q, B, n, n)), np.zeros((Q, B, n))  # noqa: E741
    squares, count = np.zeros(Q), np.zeros(Q)
    along = np.arange(n)
    for residual, error, weight in zip(residuals, errors, weights, strict=True):
        if not weight.any():  # nothing of it was measured
            continue
        M, k = error.shape
        rows = residual.rows(x)
        kept = np.repeat(weight, residual.together, axis=1)
        root = np.sqrt(kept) / noise_scales(residual)
        e, J, L = error * root, rows.by_shared, rows.by_latent
        J *= root[..., None]  # in place: these arrays are large
        if L is not None:
            L *= root[..., None]
        own = np.array([names.index(name) for name in coordinate_levels(residual, k)])
        column = np.broadcast_to(rows.columns, (M, J.shape[2]))
        for q in np.unique(own):
            at = slice(None) if (own == q).all() else np.flatnonzero(own == q)
            J_T, r = np.swapaxes(J[:, at], 1, 2), e[:, at, None]
            squares[q] += float((r**2).sum())
            count[q] += np.count_nonzero(kept[:, at] > LOST_WEIGHT)
            if column.size:
                gg[q] += scatter_add(J_T @ J[:, at], (column[:, :, None], column[:, None]), (G, G))
                g[q] -= scatter_add((J_T @ r)[..., 0], (column,), (G,))
            if L is None:
                continue
            L_T, b = np.swapaxes(L[:, at], 1, 2), residual.element[:, None, None]
            if column.size:
                gl[q] += scatter_add(J_T @ L[:, at], (b, column[:, :, None], along), (B, G, n))
            ll[q] += scatter_add(L_T @ L[:, at], (b, along[:, None], along), (B, n, n))
            l[q] -= scatter_add((L_T @ r)[..., 0], (b[..., 0], along), (B, n))
    return Linear(names, gg, gl, ll, g, l, squares, count, tuple(weights))


@dataclass(frozen=True, eq=False)
class Reduced:
    """The normal equations at given noise levels, with the latent unknowns eliminated."""

    ll_inverse: Array
    """(B, n, n)."""
    coupling: Array
    """(B, n, G): ll_inverse times the latent rows of the matrix."""
    schur: Array
    """(G, G) information on the shared unknowns."""
    vector: Array
    """(G,) the right side that belongs to it."""
    right: tuple[Array, Array]
    """(G,), (B, n): the right side before the elimination."""

    def step(self) -> tuple[Array, Array]:
        """Compute the Gauss-Newton step: shared (G,) and latent (B, n)."""
        shared = np.zeros(0)
        if len(self.schur):
            shared = cho_solve(cholesky(self.schur), self.vector)
        alone = (self.ll_inverse @ self.right[1][..., None])[..., 0]
        return shared, alone - self.coupling @ shared


def eliminate(linear: Linear, levels: Levels, damping: Array | float = 0.0) -> Reduced:
    """Eliminate the latent unknowns at given noise levels.

    Levenberg-Marquardt damping is relative to the diagonal: one number, or (B,) where there are
    latent unknowns only.
    """
    p = linear.precisions(levels)
    gg, gl, ll, g, l = (  # noqa: E741
        np.tensordot(p, each, 1) for each in (linear.gg, linear.gl, linear.ll, linear.g, linear.l)
    )
    damping = np.atleast_1d(damping)
    diagonal = np.arange(ll.shape[-1])
    ll[:, diagonal, diagonal] *= 1 + damping[:, None]
    ll_inverse: Array = np.linalg.inv(ll).astype(float, copy=False)
    coupling = ll_inverse @ np.swapaxes(gl, 1, 2)
    G = len(gg)
    if G:
        gg[np.diag_indices(G)] *= 1 + damping[0]
    flat = coupling.reshape(l.size, G)  # all latent unknowns in a row
    schur = gg - np.swapaxes(gl, 1, 2).reshape(l.size, G).T @ flat
    vector = g - l.ravel() @ flat
    return Reduced(ll_inverse, coupling, (schur + schur.T) / 2, vector, (g, l))


def cholesky(matrix: Array) -> tuple[Array, bool]:
    """Factor a positive definite matrix; the least ridge that works keeps null ones solvable."""
    scale = np.diag(matrix)
    unit = np.diag(np.maximum(scale, 1e-6 * scale.mean()) if len(scale) else scale)
    for ridge in 10.0 ** np.arange(-15, -3):
        try:
            return cho_factor(matrix + ridge * unit, lower=True)
        except (np.linalg.LinAlgError, ValueError):  # the latter: not finite
            continue
    raise VergenceError(
        "The normal equations cannot be solved: look for wild corners, poses or readings, and for "
        "rows whose images and readings are of different moments."
    )


def covariance_with(linear: Linear, levels: Levels, basis: Array, columns: np.ndarray) -> Array:
    """Compute the covariance (G, m) of all shared unknowns with some of them.

    The equations are in all G of them, which move along a basis (G, F).
    """
    schur = eliminate(linear.onto(basis), levels).schur
    return basis @ cho_solve(cholesky(schur), basis[columns].T)


def posterior(information: Array, vector: Array, covariance: Array) -> tuple[Array, Array]:
    """Compute the step (G,) and covariance (G, G) after data with this information.

    Solves (I + C N) step = C b for a prior covariance C that may be singular, as where some
    unknowns are fixed.
    """
    gain = np.linalg.solve(
        np.eye(len(vector)) + covariance @ information,
        np.concatenate([covariance @ vector[:, None], covariance], axis=1),
    )
    after: Array = gain[:, 1:].astype(float, copy=False)
    return gain[:, 0].astype(float, copy=False), (after + after.T) / 2
