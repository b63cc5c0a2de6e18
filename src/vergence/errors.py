"""The one exception for mistakes of the user, and the wording of messages."""

import difflib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

MAX_CHARACTERS = 1000
"""Longest message of a parser that is passed on; it may cite a whole line of a file."""


class VergenceError(Exception):
    """State in one sentence what was asked, what was found and what is possible.

    The command line prints it without a traceback and exits with 2.
    """


def explain(error: Exception, kind: Any = None) -> str:
    """Describe an error in a file in one line without a full stop.

    Of pydantic's errors the first is described. `kind` is the type that was read: the nearest of
    its fields is suggested in place of an unknown one.
    """
    from pydantic import ValidationError  # takes 0.1 s, which `vergence --help` does not need

    text = str(error)
    if isinstance(error, RecursionError):
        text = "it is nested too deeply"
    elif isinstance(error, UnicodeDecodeError):
        text = f"it is not text in UTF-8, see byte {error.start}"
    elif isinstance(error, ValidationError):
        first = error.errors()[0]
        where = ".".join(str(step)[:60] for step in first["loc"] if step != "[key]")
        text = (f"{where}: " if where else "") + _describe(first, kind)
    return " ".join(text[:MAX_CHARACTERS].split()).rstrip(".")


def _describe(error: Any, kind: Any) -> str:
    """Describe one of pydantic's errors with what was found."""
    from pydantic import TypeAdapter

    value, category = error["input"], error["type"]
    if category == "missing" and isinstance(value, Mapping):
        return f"this field is missing; found {', '.join(map(str, value)) or 'no field':.300}"
    if category in ("extra_forbidden", "unexpected_keyword_argument"):
        names = set(_fields(TypeAdapter(kind).json_schema())) if kind is not None else ()
        near = difflib.get_close_matches(str(error["loc"][-1]), sorted(names), n=1)
        return "unknown field" + (f"; perhaps {near[0]} is meant" if near else "")
    message = error["msg"].removeprefix("Value error, ")
    if category != "value_error" and not isinstance(value, Mapping):
        message += f"; found {value!r:.80}"
    return message


def _fields(schema: Any) -> Iterator[str]:
    """List the names of all fields in a JSON schema."""
    if isinstance(schema, Mapping):
        yield from schema.get("properties", ())
        schema = list(schema.values())
    for part in schema if isinstance(schema, list) else ():
        yield from _fields(part)


def counted(number: int, singular: str, plural: str = "") -> str:
    """Format a number with what it counts: 1 frame, 2 frames, 1,200 frames."""
    return f"{number:,} {singular if number == 1 else plural or singular + 's'}"


def listed(words: Sequence[str]) -> str:
    """Join words as in a sentence: a, b and c."""
    return " and ".join(filter(None, (", ".join(words[:-1]), *words[-1:])))


def check_seed(seed: int) -> None:
    """Raise VergenceError for a seed that numpy's generators refuse."""
    if seed < 0:
        raise VergenceError(f"The seed must be a whole number from 0, found {seed}.")
