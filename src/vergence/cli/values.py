"""What is said of an option's value of a wrong kind, such as a word where a number belongs."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

from vergence.errors import VergenceError, counted

_WORDS = {int: "whole number", float: "number"}


def check_values(arguments: list[str], kinds: dict[str, Any], see: str) -> None:
    """Raise VergenceError for the first option with too few values, or one of a wrong kind.

    Args:
        arguments: as typed, behind the name of the command.
        kinds: by option its annotation.
        see: the command that explains the options.
    """
    for option, values in _given(arguments):
        kind = _without_none(kinds.get(option))
        origin, inner = get_origin(kind), get_args(kind)
        if origin is tuple and Ellipsis in inner and get_origin(inner[0]) is not tuple:
            wanted, good = f"{_WORDS[inner[0]]}s", all(_is(inner[0], each) for each in values)
        elif origin is tuple:
            each_of = get_args(inner[0]) if get_origin(inner[0]) is tuple else inner
            wanted = counted(len(each_of), "number")
            if whole := each_of.count(int):
                wanted += f", the first {whole} of them whole"
            values = values[: len(each_of)]
            good = len(values) == len(each_of) and all(map(_is, each_of, values))
        elif origin is Literal:
            values = values[:1]
            wanted, good = f"one of {', '.join(inner)}", bool(values) and values[0] in inner
        elif kind in _WORDS:
            values = values[:1]
            wanted, good = f"a {_WORDS[kind]}", bool(values) and _is(kind, values[0])
        else:
            continue
        if not good:
            found = " ".join(values) or "none"
            raise VergenceError(f"{option} takes {wanted}; found {found:.80}. See {see}.")


def _given(arguments: list[str]) -> Iterator[tuple[str, list[str]]]:
    """Yield each option that was typed, with all words up to the next one."""
    for k, argument in enumerate(arguments):
        if argument.startswith("--"):
            option, equals, value = argument.partition("=")
            rest = itertools.takewhile(lambda word: not word.startswith("--"), arguments[k + 1 :])
            yield option.replace("_", "-"), [value] if equals else [*rest]


def _without_none(kind: Any) -> Any:
    if get_origin(kind) not in (Union, UnionType):
        return kind
    (only,) = (each for each in get_args(kind) if each is not NoneType)
    return only


def _is(kind: type, text: str) -> bool:
    """Return whether a text is a number of a kind, as Python reads it."""
    try:
        kind(text)
    except ValueError:
        return False
    return True
