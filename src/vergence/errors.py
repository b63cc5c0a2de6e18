"""The one exception for whatever a user can mend, the text of errors found in files, the words for
numbers of things, and the check of a seed, which commands of several rooms take.
"""

import difflib
from collections.abc import Mapping, Sequence
from typing import Any

MOST_CHARACTERS = 1000
"""Longest message about a file that is passed on: a parser may cite the whole line."""
MOST_NAMES = 10
"""Most names of found fields that a message about a missing one lists."""


class VergenceError(Exception):
    """What was asked, what was found, and what would be right, in one sentence.

    The command line prints it without a traceback and exits with 2.
    """


def explain(error: Exception, kind: Any = None) -> str:
    """Return what an error found in a file, in one line without a full stop.

    Of several pydantic errors it is the first one, with the path of its field:
    `joints.left_pan.unit: ...`. `kind` is the type that was to be read, whose fields are suggested
    in place of an unknown one; None: none are.
    """
    from pydantic import ValidationError  # takes 0.1 s, which `vergence --help` does not need

    text = "it is nested too deeply" if isinstance(error, RecursionError) else str(error)
    if isinstance(error, UnicodeDecodeError):
        text = f"it is not text in UTF-8, see byte {error.start}"
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        steps, is_key = first["loc"], first["loc"][-1:] == ("[key]",)
        where = ".".join(str(step)[:60] for step in (steps[:-2] if is_key else steps))
        said = first["msg"].removeprefix("Value error, ")
        if first["type"] == "missing" and isinstance(first["input"], Mapping):
            found = ", ".join(str(name)[:60] for name in list(first["input"])[:MOST_NAMES])
            said = f"this field is missing; found {found or 'none'}"
        elif first["type"] in ("dataclass_type", "model_type", "dict_type"):
            said = f"expected fields by their names, found {_kind(first['input'])}"
        elif first["type"] == "too_short":
            said = "expected one value or more, found none"
        elif is_key:
            said = f"there is no field {first['input']!r:.80} here"
        elif first["type"] == "union_tag_invalid":
            of = first.get("ctx", {})
            said = f"{of['discriminator']} is one of {of['expected_tags']}; found {of['tag']!r:.80}"
        elif first["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
            said = "there is no such field" + _suggestion(str(steps[-1]), _fields(kind, steps[:-1]))
        elif first["type"] in ("tuple_type", "list_type"):
            said = f"expected a list, found {_kind(first['input'])}"
        elif first["type"] != "value_error" and isinstance(first["input"], str | int | float):
            said += f"; found {first['input']!r:.80}"
        text = (f"{where}: " if where else "") + said
    return " ".join(text[:MOST_CHARACTERS].split()).rstrip(".")


def _suggestion(unknown: str, fields: Sequence[str]) -> str:
    """Return what may have been meant by a field that is unknown, or all that there are."""
    near = difflib.get_close_matches(unknown, fields, n=1)
    if near:
        return f"; perhaps {near[0]} is meant"
    return f"; there are {', '.join(fields)}" if fields else ""


def _fields(kind: Any, steps: Sequence[int | str]) -> list[str]:
    """Return the fields of the objects to which a path of steps leads in a type, by its schema."""
    if kind is None:
        return []
    from pydantic import TypeAdapter

    whole = TypeAdapter(kind).json_schema()
    here = _alternatives(whole, whole)
    for step in steps:
        below = [
            inner
            for each in here
            for inner in (
                each.get("properties", {}).get(step),
                each.get("additionalProperties"),
                each.get("items"),
            )
            if isinstance(inner, dict)
        ]
        if below:  # else the step names one of several kinds of object
            here = [each for inner in below for each in _alternatives(inner, whole)]
    return list(dict.fromkeys(name for each in here for name in each.get("properties", {})))


def _alternatives(schema: dict[str, Any], whole: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the schemas that one stands for: those of a reference or of a choice."""
    if "$ref" in schema:
        return _alternatives(whole["$defs"][schema["$ref"].rpartition("/")[2]], whole)
    choices = schema.get("anyOf", schema.get("oneOf", []))
    return [each for inner in choices for each in _alternatives(inner, whole)] or [schema]


def _kind(found: object) -> str:
    """Return what a message calls a value that should have been an object with fields."""
    if isinstance(found, list | tuple):
        return "a list"
    return "nothing" if found is None else f"{found!r:.80}"


def counted(number: int, singular: str, plural: str = "") -> str:
    """Return a number with the word for what it counts: 1 frame, 2 frames, 1,200 frames."""
    return f"{number:,} {singular if number == 1 else plural or singular + 's'}"


def listed(words: Sequence[str]) -> str:
    """Return words as a list in a sentence: a, b and c."""
    return " and ".join(filter(None, (", ".join(words[:-1]), *words[-1:])))


def check_seed(seed: int) -> None:
    """Raise VergenceError for a seed that numpy's generators do not take."""
    if seed < 0:
        raise VergenceError(f"The seed must be a whole number from 0, found {seed}.")
