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

    The first of several errors of pydantic is described, with the path of its field. `kind` is the
    type that was read: its fields are suggested in place of an unknown one.
    """
    from pydantic import ValidationError  # takes 0.1 s, which `vergence --help` does not need

    text = "it is nested too deeply" if isinstance(error, RecursionError) else str(error)
    if isinstance(error, UnicodeDecodeError):
        text = f"it is not text in UTF-8, see byte {error.start}"
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        steps = first["loc"]
        if is_key := steps[-1:] == ("[key]",):
            steps = steps[:-2]
        where = ".".join(str(step)[:60] for step in steps)
        text = (f"{where}: " if where else "") + _sentence(first, is_key, kind)
    return " ".join(text[:MAX_CHARACTERS].split()).rstrip(".")


def _sentence(error: Any, is_key: bool, kind: Any) -> str:
    """Describe one error of pydantic in the user's words."""
    from pydantic import TypeAdapter

    input, category = error["input"], error["type"]
    if is_key:
        return f"there is no field {input!r:.80} here"
    if category == "missing" and isinstance(input, Mapping):
        return f"this field is missing; found {', '.join(map(str, input)) or 'no field':.300}"
    if category in ("dataclass_type", "model_type", "dict_type"):
        return f"expected fields by their names, found {_found(input)}"
    if category in ("tuple_type", "list_type"):
        return f"expected a list, found {_found(input)}"
    if category == "too_short":
        return "expected one value or more, found none"
    if category == "union_tag_invalid":
        context = error["ctx"]
        expected, found = context["expected_tags"], context["tag"]
        return f"{context['discriminator']} is one of {expected}; found {found!r:.80}"
    if category in ("extra_forbidden", "unexpected_keyword_argument"):
        names = sorted(set(_fields(TypeAdapter(kind).json_schema()))) if kind is not None else []
        near = difflib.get_close_matches(str(error["loc"][-1]), names, n=1)
        return "there is no such field" + (f"; perhaps {near[0]} is meant" if near else "")
    message = error["msg"].removeprefix("Value error, ")
    if category != "value_error" and isinstance(input, str | int | float):
        message += f"; found {input!r:.80}"
    return message


def _fields(schema: Any) -> Iterator[str]:
    """List the names of all fields in a JSON schema."""
    if isinstance(schema, Mapping):
        yield from schema.get("properties", ())
        schema = list(schema.values())
    if isinstance(schema, list):
        for part in schema:
            yield from _fields(part)


def _found(value: object) -> str:
    if isinstance(value, list | tuple):
        return "a list"
    return "nothing" if value is None else f"{value!r:.80}"


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
