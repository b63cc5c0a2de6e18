"""The one exception for whatever a user can mend, the text of errors found in files, the words for
numbers of things, and the check of a seed, which commands of several rooms take.
"""

from collections.abc import Mapping, Sequence

from pydantic import ValidationError

MOST_CHARACTERS = 1000
"""Longest message about a file that is passed on: a parser may cite the whole line."""
MOST_NAMES = 10
"""Most names of found fields that a message about a missing one lists."""


class VergenceError(Exception):
    """What was asked, what was found, and what would be right, in one sentence.

    The command line prints it without a traceback and exits with 2.
    """


def explain(error: Exception) -> str:
    """Return what an error found in a file, in one line without a full stop.

    Of several pydantic errors it is the first one, with the path of its field:
    `joints.left_pan.unit: ...`.
    """
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
        elif first["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
            said = "there is no such field"
        elif first["type"] != "value_error" and isinstance(first["input"], str | int | float):
            said += f"; found {first['input']!r:.80}"
        text = (f"{where}: " if where else "") + said
    return " ".join(text[:MOST_CHARACTERS].split()).rstrip(".")


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
