"""Every file that strangers may have made is read here, within limits.

What is not a regular file, is too large, repeats itself or nests without end is refused before
anything works on it. docs/security.md has the limits of all readers.
"""

from __future__ import annotations

import json
import os
import stat
import tomllib
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from vergence.errors import VergenceError, explain

T = TypeVar("T")

MAX_JSON_BYTES = 16 * 2**20
"""A calibration with the covariance of 16 cameras has 2 MB, the truth of 18,000 frames 5 MB."""
MAX_KEYS = 20_000
"""In one object of a JSON file; a truth has one for each placement of the board."""
MAX_DIGITS = 40
"""Longest number in a file; a float needs at most 24 characters."""


def read_bytes(path: Path, most_bytes: int) -> bytes:
    """Return the content of a regular file; VergenceError if it is none, too large, or missing."""
    try:
        # Opened without waiting: a pipe that nobody writes to would block for ever.
        flags = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        handle = os.open(path, os.O_RDONLY | flags)
        with open(handle, "rb") as file:
            if not stat.S_ISREG(os.fstat(handle).st_mode):
                raise VergenceError(f"Cannot read {path}: it is not a regular file.")
            content = file.read(most_bytes + 1)
    except IsADirectoryError:
        raise VergenceError(
            f"Cannot read {path}: it is a folder, and a file is to be read; name one in it."
        ) from None
    except OSError as error:
        raise VergenceError(f"Cannot read {path}: {error.strerror}.") from error
    except ValueError:
        raise VergenceError(f"{str(path)!r} is not a possible file name.") from None
    if len(content) > most_bytes:
        raise VergenceError(
            f"{path} is too large: a file of this kind has at most {most_bytes:,} bytes."
        )
    return content


def read_parsed(
    path: Path,
    what: str,
    build: Callable[[Any], T],
    parse: Callable[[str], Any],
    *,
    most_bytes: int = MAX_JSON_BYTES,
) -> T:
    """Read a text file.

    Args:
        path: text in UTF-8.
        what: how a message calls such a file, with its article.
        build: makes the result from the parsed content; raises ValueError where that is not valid.
        parse: makes nested dictionaries and lists from the text; raises ValueError.
        most_bytes: that it may have.

    Raises:
        VergenceError: the file is missing, too large, or not what was expected.
    """
    content = read_bytes(path, most_bytes)
    try:
        return build(parse(content.decode("utf-8-sig")))
    # Besides ValueError, which says what is wrong: what parsers and numpy raise on odd content.
    except (ValueError, TypeError, LookupError, ArithmeticError, RecursionError) as error:
        raise VergenceError(f"{path} is not {what}: {explain(error)}.") from None


def read_json(path: Path, kind: type[T], what: str) -> T:
    """Read a dataclass from JSON; `what` and errors are those of `read_parsed`."""
    return read_parsed(path, what, lambda content: validated(content, kind), parse_json)


def validated(content: Any, kind: type[T]) -> T:
    """Return parsed content as a type of pydantic's; ValueError says what is not valid in it."""
    try:
        return TypeAdapter(kind).validate_python(content)
    except ValidationError as error:
        raise ValueError(explain(error, kind)) from None


def parse_json(text: str) -> Any:
    """Parse JSON; ValueError for NaN and infinity, repeated keys, and numbers without end."""
    try:
        return json.loads(
            text,
            object_pairs_hook=unique_keys,
            parse_int=lambda digits: int(_short(digits)),
            parse_float=_finite,
            parse_constant=_finite,
        )
    except json.JSONDecodeError as error:
        raise ValueError(f"it is not valid JSON: {error}") from None


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML; ValueError says where it is none."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"it is not valid TOML: {error}") from None


def unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return a dictionary of pairs; ValueError if a key is repeated, or there are too many."""
    found = dict(pairs)
    if len(found) < len(pairs):
        name, _ = Counter(name for name, _ in pairs).most_common(1)[0]
        raise ValueError(f"the key {name[:60]!r} is repeated")
    if len(found) > MAX_KEYS:
        raise ValueError(f"an object has {len(found)} keys; at most {MAX_KEYS} are read")
    return found


def _short(digits: str) -> str:
    if len(digits) > MAX_DIGITS:
        raise ValueError(f"a number has {len(digits)} digits; at most {MAX_DIGITS} are read")
    return digits


def _finite(text: str) -> float:
    value = float(_short(text))
    if not abs(value) < float("inf"):
        raise ValueError(f"{text} is not a finite number")
    return value
