"""The one exception for whatever a user can mend, and the text of errors found in files."""

from pydantic import ValidationError

MOST_CHARACTERS = 1000
"""Of what is said of a file: a parser may cite the whole line."""


class VergenceError(Exception):
    """What was asked, what was found, and what would be right, in one sentence.

    The command line prints it without a traceback and exits with 2.
    """


def explain(error: Exception) -> str:
    """Return what an error found in a file, in one line without a full stop.

    Of pydantic's errors it is the first, with the path of its field: `joints.left_pan.unit: ...`.
    """
    text = "it is nested too deeply" if isinstance(error, RecursionError) else str(error)
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        where = ".".join(str(step)[:60] for step in first["loc"])
        text = (f"{where}: " if where else "") + first["msg"].removeprefix("Value error, ")
    return " ".join(text[:MOST_CHARACTERS].split()).rstrip(".")
