"""Vectors and small matrices with leading batches, as fast for one as for many.

The axes of a vector (..., n) or a matrix (..., n, m) come last for whoever indexes it, but first in
memory: arithmetic and `einsum` then run over long rows, and keep this order. numpy's matmul takes
0.1 us for each product of a stack. A single vector is (n,), whose elements are numpy's scalars; on
these arithmetic takes a tenth of the time of arrays of one element.
"""

from __future__ import annotations

import math

import numpy as np

from vergence.arrays import Array

ignoring_invalid = np.errstate(invalid="ignore", divide="ignore", over="ignore")
"""As a decorator: NaN and infinity mark what is not seen, and need no warning."""


def batch_last(array: Array, ndim: int = 1) -> Array:
    """View the last axes of an array, those of vectors or with ndim 2 of matrices, as the first."""
    n = array.ndim
    return array.transpose(*range(n - ndim, n), *range(n - ndim)) if n > ndim else array


def batch_first(array: Array, ndim: int = 1) -> Array:
    """View the first axes of an array, those of vectors or with ndim 2 of matrices, as the last."""
    return array.transpose(*range(ndim, array.ndim), *range(ndim)) if array.ndim > ndim else array


def vector(*parts: Array | float) -> Array:
    """Stack components (...) to vectors (..., n); they broadcast."""
    if type(parts[0]) is not np.ndarray and type(parts[-1]) is not np.ndarray:
        return np.array(parts)
    stacked = np.empty((len(parts), *np.broadcast(*parts).shape))
    for k, part in enumerate(parts):
        stacked[k] = part
    return batch_first(stacked)


def joined(*parts: Array) -> Array:
    """Concatenate matrices (..., n, m) along their columns; batches broadcast."""
    rows, columns = parts[0].shape[-2], [part.shape[-1] for part in parts]
    batch = np.broadcast_shapes(*(part.shape[:-2] for part in parts))
    whole = batch_first(np.empty((rows, sum(columns), *batch)), 2)
    start = 0
    for part, count in zip(parts, columns, strict=True):
        whole[..., start : start + count] = part
        start += count
    return whole


def product(a: Array, b: Array) -> Array:
    """Multiply matrices (..., n, k) and (..., k, m)."""
    if a.ndim == b.ndim == 2:
        return a @ b
    if a.ndim == 2:
        rows = batch_last(b, 2)
        whole = a @ rows.reshape(len(rows), math.prod(rows.shape[1:]))
        return batch_first(whole.reshape(len(a), *rows.shape[1:]), 2)
    if b.ndim == 2:
        rows = batch_last(a, 2)
        whole = b.T @ rows.reshape(*rows.shape[:2], math.prod(rows.shape[2:]))
        return batch_first(whole.reshape(len(rows), b.shape[1], *rows.shape[2:]), 2)
    return np.einsum("...ij,...jk->...ik", a, b)


def times(matrix: Array, v: Array) -> Array:
    """Multiply matrices (..., n, m) by vectors (..., m)."""
    if matrix.ndim == 2:
        if v.ndim == 1:
            return matrix @ v
        rows = batch_last(v)
        whole = matrix @ rows.reshape(len(rows), math.prod(rows.shape[1:]))
        return batch_first(whole.reshape(len(matrix), *rows.shape[1:]))
    return np.einsum("...ij,...j->...i", matrix, v)


def times_transposed(matrix: Array, v: Array) -> Array:
    """Multiply the transposes of matrices (..., n, m) by vectors (..., n)."""
    return times(matrix.swapaxes(-1, -2), v)


def dot(a: Array, b: Array) -> Array:
    """Multiply vectors (..., n), to numbers (...)."""
    if a.ndim == b.ndim == 1:
        return a @ b
    return np.einsum("...i,...i->...", a, b)
