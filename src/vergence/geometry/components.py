"""Vectors and matrices by components, each of them a number or an array of one shape.

numpy is fast on long rows, slow on many small matrices, and slower than Python on single numbers.
Code that is written by components serves a million points as well as the single one of a control
step, and a posture that many points share is made of numbers where the points are arrays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np

from vergence.arrays import Array

Component = Any
"""A number, or an array; those of one expression broadcast."""
Vector = Sequence[Any]
"""Three components, or two of a pixel."""
Rows = Sequence[Sequence[Any]]
"""A matrix by rows."""
NAN = float("nan")


def components(array: Array, ndim: int = 1) -> Any:
    """Return the components of an array (a, ...), or with ndim 2 (a, b, ...); one element: numbers.

    Arrays are views of it.
    """
    if math.prod(array.shape[ndim:]) == 1:
        return array.reshape(array.shape[:ndim]).tolist()
    return list(array) if ndim == 1 else [list(row) for row in array]


def pose_components(T: Array) -> tuple[Rows, Vector]:
    """Return rotation (3, 3) and translation (3) of poses (..., 4, 4)."""
    first = T[..., :3, :]
    rows = components(first if T.ndim == 2 else first.transpose(-2, -1, *range(T.ndim - 2)), 2)
    return [row[:3] for row in rows], [row[3] for row in rows]


def stacked(rows: Sequence[Any], shape: tuple[int, ...], ndim: int = 1) -> Array:
    """Return an array (a, *shape), or with ndim 2 (a, b, *shape), of components."""
    if math.prod(shape) == 1:
        found = np.array(rows, dtype=float)
        return found.reshape(*found.shape[:ndim], *shape)
    lead = (len(rows),) if ndim == 1 else (len(rows), len(rows[0]))
    array = np.empty((*lead, *shape))
    flat = rows if ndim == 1 else [each for row in rows for each in row]
    for into, each in zip(array.reshape(math.prod(lead), *shape), flat, strict=True):
        into[...] = each
    return array


def ignoring_invalid(value: Component) -> AbstractContextManager[object]:
    """Return a context in which arrays give no warnings; numbers give none anyway."""
    if type(value) is float:  # entering numpy's takes longer than ten operations
        return nullcontext()
    return np.errstate(invalid="ignore", divide="ignore", over="ignore")


def quotient(a: Component, b: Component) -> Component:
    """Return a / b; dividing a number by zero gives infinity or NaN, as with arrays."""
    if isinstance(b, float) and b == 0:
        return a * math.inf
    return a / b


def positive(z: Component) -> Component:
    """Return z where it is above zero, and NaN elsewhere."""
    return where(z > 0, z)


def where(good: Component, value: Component) -> Component:
    """Return a value where it is good, and NaN elsewhere."""
    if isinstance(value, float):
        return value if good else NAN
    return value if good.all() else np.where(good, value, NAN)


def anywhere(found: Component) -> bool:
    """Return whether something holds for any element."""
    return found if isinstance(found, bool) else bool(found.any())


def sine_cosine(angle: Component) -> tuple[Component, Component]:
    """Return the sine and the cosine of an angle."""
    if isinstance(angle, float):
        return (math.sin(angle), math.cos(angle)) if math.isfinite(angle) else (NAN, NAN)
    return np.sin(angle), np.cos(angle)


def dot(a: Vector, b: Vector) -> Component:
    """Return the inner product of two vectors."""
    a1, a2, a3 = a
    b1, b2, b3 = b
    return a1 * b1 + a2 * b2 + a3 * b3


def cross(a: Vector, b: Vector) -> Vector:
    """Return a x b."""
    a1, a2, a3 = a
    b1, b2, b3 = b
    return a2 * b3 - a3 * b2, a3 * b1 - a1 * b3, a1 * b2 - a2 * b1


def plus(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def minus(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def times(matrix: Rows, vector: Vector) -> Vector:
    """Return the product of a matrix and a vector."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    x, y, z = vector
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def transposed(matrix: Rows) -> Rows:
    """Return the transposed matrix."""
    (a, b, c), (d, e, f), (g, h, i) = matrix
    return (a, d, g), (b, e, h), (c, f, i)


def product(a: Rows, b: Rows) -> Rows:
    """Return the product of two matrices."""
    columns = transposed(b)
    return times(columns, a[0]), times(columns, a[1]), times(columns, a[2])
