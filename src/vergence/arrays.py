"""Array fields that check their shape and travel through JSON as nested lists."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import PlainSerializer, PlainValidator
from threadpoolctl import LibController, ThreadpoolController

from vergence.errors import VergenceError

Array = NDArray[np.float64]
_Instance = TypeVar("_Instance")


def _shaped(*shape: int | None) -> tuple[PlainValidator, PlainSerializer]:
    """Make the validator and serialiser of a finite float array; None leaves a size free."""
    wanted = " x ".join("n" if size is None else str(size) for size in shape)

    def check(value: Any) -> Array:
        try:
            array = np.array(value, dtype=float)
        except (TypeError, ValueError):
            raise ValueError(f"expected {wanted} numbers, found {value!r:.60}") from None
        if array.size == 0 and None in shape:  # JSON's [] has lost the other dimensions
            array = array.reshape([0 if size is None else size for size in shape])
        if array.ndim != len(shape) or any(
            size not in (None, found) for size, found in zip(shape, array.shape, strict=True)
        ):
            found = " x ".join(map(str, array.shape)) or "a single number"
            raise ValueError(f"expected {wanted} numbers, found {found}")
        if not np.isfinite(array).all():
            raise ValueError("expected finite numbers, found NaN or infinity")
        array.setflags(write=False)  # the dataclasses that hold it are frozen
        return array

    return PlainValidator(check), PlainSerializer(lambda array: array.tolist())


Vector3 = Annotated[Array, *_shaped(3)]
VectorN = Annotated[Array, *_shaped(None)]
Vectors3 = Annotated[Array, *_shaped(None, 3)]
Matrix3 = Annotated[Array, *_shaped(3, 3)]
Matrix = Annotated[Array, *_shaped(None, None)]


MAX_M = 1e6
"""Largest coordinate of a translation or a point [m]; far larger ones overflow."""


ROUNDED = 1e-3
"""Distance of a number from that of the nearest rotation, up to which it counts as rounded: three
decimals, as some robots print them, err by 0.0005, and up to twice that in the nearest rotation."""


def nearest_rotation(M: Array) -> Array:
    """Project matrices M (..., 3, 3) onto the nearest rotations.

    The orthogonal factor of M, with the direction of the least singular value turned round where
    that factor is a mirror image.
    """
    U, _, Vt = np.linalg.svd(M)
    U[..., :, 2] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    return U @ Vt


def rigid(T: Array) -> Array:
    """Take arrays (..., 4, 4) to the nearest rigid transforms in metres; ValueError: none is near.

    Those that are rigid stay as they are.
    """
    R, t = np.clip(T[..., :3, :3], -2, 2), T[..., :3, 3]  # so that no product overflows
    handed, found = np.linalg.det(R).min(initial=1), T
    if np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(initial=0) > 2e-6:
        found = T.copy()
        found[..., :3, :3] = nearest_rotation(R)
        found.setflags(write=T.flags.writeable)
    if np.abs(found - T).max(initial=0) > ROUNDED or handed < 0:
        problem = "left-handed axes or" if handed < 0 else "a quaternion that is not normalised, or"
        raise ValueError(
            f"expected a rigid transform, found {problem} a rotation part that is not a rotation"
        )
    if (largest := np.abs(t).max(initial=0)) > MAX_M:
        raise ValueError(f"expected a translation in metres, found {largest:g}")
    if np.abs(T[..., 3, :] - [0, 0, 0, 1]).max(initial=0) > 1e-9:
        raise ValueError("expected a last row of 0 0 0 1")
    return found


_validate44, _serialise = _shaped(4, 4)
Transform = Annotated[
    Array,
    PlainValidator(lambda value: rigid(_validate44.func(value))),  # pyright: ignore
    _serialise,
]
"""A (4, 4) rigid transform."""
_validate_many, _serialise_many = _shaped(None, 4, 4)
Transforms = Annotated[
    Array,
    PlainValidator(lambda value: rigid(_validate_many.func(value))),  # pyright: ignore
    _serialise_many,
]
"""Rigid transforms (n, 4, 4)."""


def floats(name: str, value: ArrayLike) -> Array:
    """Convert an argument to an array of numbers; VergenceError names an invalid one."""
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise VergenceError(
            f"{name} takes numbers, as many in each row; found {value!r:.60}."
        ) from None


def replace_unchecked(instance: _Instance, **changes: Any) -> _Instance:
    """Replace values of a dataclass without its checks, which take most of the time."""
    changed = object.__new__(type(instance))
    for value in changes.values():
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
    own = vars(instance)  # also has what was cached, which would be wrong
    names = type(instance).__dataclass_fields__  # pyright: ignore[reportAttributeAccessIssue]
    vars(changed).update({name: own[name] for name in names} | changes)
    return changed


def scatter_add(values: Array, places: tuple[np.ndarray, ...], shape: tuple[int, ...]) -> Array:
    """Sum values by their place in an array; six times as fast as np.add.at.

    `places`: one array of indices for each dimension of the shape; they broadcast to the values.
    """
    flat = np.ravel_multi_index(np.broadcast_arrays(*places), shape)
    flat = np.broadcast_to(flat, values.shape).ravel()
    sums = np.bincount(flat, values.ravel(), int(np.prod(shape)))
    return sums.astype(float, copy=False).reshape(shape)


_limiting = threading.Lock()
_before: list[tuple[LibController, int]] = []  # libraries and their threads, while limited
_users = [0]  # of the limit, which is the whole process's


@cache
def _blas() -> list[LibController]:
    return ThreadpoolController().select(user_api="blas").lib_controllers


@contextmanager
def single_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread; also a decorator.

    Threads that wait for a busy core make products of small matrices ten times slower. A number of
    threads in the environment is respected. Takes 4 us; with threadpoolctl's own context 10 us.
    """
    if "OMP_NUM_THREADS" in os.environ or "OPENBLAS_NUM_THREADS" in os.environ:
        yield
        return
    with _limiting:
        _users[0] += 1
        if _users[0] == 1:
            _before[:] = [(library, library.get_num_threads() or 1) for library in _blas()]
            for library, _ in _before:
                library.set_num_threads(1)
    try:
        yield
    finally:
        with _limiting:
            _users[0] -= 1
            if not _users[0]:
                for library, threads in _before:
                    library.set_num_threads(threads)
