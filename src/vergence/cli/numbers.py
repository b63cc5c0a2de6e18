"""Numbers on the command line: what is none is answered in words, not in Python's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, TypeVar

from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

T = TypeVar("T", int, float)

NUMBERS = ConstructorRegistry()
"""tyro's rules for numbers."""


@NUMBERS.primitive_rule
def _numbers(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    if info.type in (int, int | None):
        return _rule(1, "INT", lambda words: _whole(words[0]))
    if info.type in (float, float | None):
        return _rule(1, "FLOAT", lambda words: _number(words[0]))
    if info.type in (tuple[float, ...], tuple[float, ...] | None):
        return _rule("*", "[FLOAT [FLOAT ...]]", lambda words: tuple(map(_number, words)))
    if info.type == tuple[int, ...]:
        return _rule("*", "[INT [INT ...]]", lambda words: tuple(map(_whole, words)))
    return None


def _rule(
    count: Any, shown: str, read: Callable[[list[str]], Any]
) -> PrimitiveConstructorSpec[Any]:
    """Return the rule for options of so many words, which help shows in some way."""
    return PrimitiveConstructorSpec(
        nargs=count,
        metavar=shown,
        instance_from_str=read,
        is_instance=lambda value: isinstance(value, int | float | tuple),
        str_from_instance=lambda value: list(
            map(str, value if isinstance(value, tuple) else [value])
        ),
    )


def _whole(word: str) -> int:
    return _read(int, word, "a whole number")


def _number(word: str) -> float:
    return _read(float, word, "a number without a unit")


def _read(kind: Callable[[str], T], word: str, what: str) -> T:
    try:
        return kind(word)
    except ValueError:
        raise ValueError(f"expected {what}, found {word!r}") from None


def _board(words: list[str]) -> tuple[int, int, float]:
    return _whole(words[0]), _whole(words[1]), _number(words[2])


Board = Annotated[tuple[int, int, float] | None, _rule(3, "COLUMNS ROWS SQUARE_M", _board)]
"""Inner corners in a row and in a column, and side of a square [m]."""
