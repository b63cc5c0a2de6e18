"""What a public function says of an argument of a wrong kind: a path where a head is wanted, None.

Arguments are compared with the annotations only after a function has failed, so that whoever calls
it right, perhaps a thousand times a second, pays nothing.
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Mapping
from functools import wraps
from numbers import Real
from types import UnionType
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError

P = ParamSpec("P")
R = TypeVar("R")

_MADE_BY = {
    "HeadCalibration": 'vg.load_head("head.json") or vg.calibrate(data).head',
    "Dataset": 'vg.load_dataset("folder")',
    "DenseDepth": "vg.dense_depth(...)",
    "RectifiedPair": "vg.rectify(head, joints)",
    "RectifiedView": "the left or right of vg.rectify(head, joints)",
    "Description": "the description of a vg.Dataset",
    "Camera": "vg.Camera(width=640, height=480, matrix=K)",
}
"""By class, where an instance comes from."""
_WORDS = {
    float: "a number",
    int: "a whole number",
    str: "a name",
    bool: "True or False",
    type(None): "None",
    Mapping: "a dictionary",
    Callable: "a function",
    np.ndarray: "an array of numbers",
}
_MANY = {str: "names", float: "numbers", int: "whole numbers"}


def explained(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that raises VergenceError where an argument of a wrong kind makes it fail.

    Other failures, and VergenceErrors of its own, pass unchanged.
    """

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except VergenceError:
            raise
        except Exception as error:
            try:
                given = inspect.signature(function).bind(*args, **kwargs).arguments
            except TypeError:  # one is missing, or there is none of that name: Python has said so
                raise error from None
            if said := _wrong_kind(function, given):
                raise VergenceError(said) from error
            raise

    return call


def explained_fields(kind: type[R]) -> type[R]:
    """Have the constructor of a dataclass explain its arguments as `explained` functions do."""
    kind.__init__ = explained(kind.__init__)
    return kind


def _wrong_kind(function: Callable[..., object], given: Mapping[str, Any]) -> str | None:
    """Return a sentence on the first argument of a kind that its annotation does not name."""
    # ArrayLike is a union that also has text.
    for name, hint in get_type_hints(function, None, {"ArrayLike": Array}).items():
        if name in given and not _fits(given[name], hint):
            who = function.__qualname__.removesuffix(".__init__")
            return f"{who}: {name} is {_wanted(hint)}; found {_found(given[name])}."
    return None


def _fits(value: Any, hint: Any) -> bool:
    """Return whether a value is of the kind that an annotation names; True where in doubt."""
    kind, inner = get_origin(hint) or hint, get_args(hint)
    if kind in (Union, UnionType):
        return any(_fits(value, each) for each in inner)
    if kind is Literal:
        return isinstance(value, str) and value in inner
    if kind is np.ndarray:
        return _is_numeric(value)
    if kind is float:
        return isinstance(value, Real) or (isinstance(value, np.ndarray) and value.ndim == 0)
    if not isinstance(kind, type):
        return True
    if kind is tuple and isinstance(value, list):  # as JSON has it
        kind = list
    if not isinstance(value, kind) or (isinstance(value, str) and kind is not str):
        return False
    if isinstance(value, Mapping) and len(inner) == 2:
        return all(_fits(each, inner[1]) for each in value.values())
    if isinstance(value, list | tuple) and inner:
        each_of = inner[:1] * len(value) if len(inner) == 1 or Ellipsis in inner else inner
        return len(value) == len(each_of) and all(map(_fits, value, each_of))
    return True


def _is_numeric(value: Any) -> bool:
    """Return whether numpy makes numbers of a value without a loss."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # of complex numbers
            np.asarray(value, dtype=float)
    except (TypeError, ValueError, np.exceptions.ComplexWarning):
        return False
    return value is not None


def _wanted(hint: Any) -> str:
    """Return in words what an annotation asks for."""
    kind, inner = get_origin(hint) or hint, get_args(hint)
    if kind in (Union, UnionType):
        words = [_wanted(each) for each in inner]
        path = {"a Path", "a name"}
        if path <= set(words):
            words = ["the name of a file or folder", *(w for w in words if w not in path)]
        return " or ".join(dict.fromkeys(words))
    if kind is Literal:
        return " or ".join(map(repr, inner))
    if kind is tuple and Ellipsis not in inner:
        return f"{len(inner)} {_MANY.get(inner[0], 'values')}"
    if kind in _WORDS:
        return _WORDS[kind]
    name = getattr(kind, "__name__", str(kind))
    if name in _MADE_BY:
        return f"a {name}, such as {_MADE_BY[name]}"
    if name in ("tuple", "Sequence", "Collection", "Iterable"):
        return f"a list of {_MANY.get(inner[0], getattr(inner[0], '__name__', 'values'))}"
    return f"{'an' if name[0] in 'AEIOU' else 'a'} {name}"


def _found(value: Any) -> str:
    """Return what a message calls a value that was found."""
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype}, of shape {value.shape}"
    shown = repr(value)
    return shown if len(shown) <= 60 else f"a {type(value).__name__}, {shown:.40}..."
