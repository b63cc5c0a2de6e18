"""Write files complete under their final name, or not at all; read and write JSON."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from vergence.errors import VergenceError, explain

T = TypeVar("T")


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a `with` block a temporary file, which gets its final name when the block ends well.

    An earlier file of that name is replaced; a block that raises leaves it as it was, and no other
    file behind. Parent folders are created. VergenceError if the file cannot be written.
    """
    part: Path | None = None
    try:
        if path.is_dir():  # os.replace would find this out only after all the work
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        os.close(handle)
        part = Path(name)
        yield part
        part.chmod(0o644)  # mkstemp's files are private
        part.replace(path)
    except OSError as error:
        raise VergenceError(f"Cannot write {path}: {error.strerror}.") from error
    finally:
        if part is not None:
            part.unlink(missing_ok=True)


def write_whole(path: Path, text: str) -> None:
    """Write a UTF-8 text file as `whole_file` does."""
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8", newline="\n")


def write_json(value: Any, path: Path) -> None:
    """Write a dataclass as JSON as `whole_file` does."""
    write_whole(path, TypeAdapter(type(value)).dump_json(value, indent=1).decode() + "\n")


def read_json(path: Path, kind: type[T], what: str) -> T:
    """Read a dataclass from JSON.

    Args:
        path: of the file.
        kind: the dataclass.
        what: the file should be, for the error: `a head calibration`.

    Raises:
        VergenceError: the file is missing, not JSON, or a field of it is not valid.
    """
    try:
        return TypeAdapter(kind).validate_json(path.read_bytes())
    except OSError as error:
        raise VergenceError(f"Cannot read {path}: {error.strerror}.") from error
    except ValidationError as error:
        raise VergenceError(f"{path} is not {what}: {explain(error)}.") from None
