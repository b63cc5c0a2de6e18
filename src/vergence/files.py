"""Write files complete under their final name, or not at all."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vergence.errors import VergenceError


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a `with` block a temporary file, which gets its final name when the block ends well.

    A block that raises leaves no file behind, and an earlier file of that name as it was. Parent
    folders are created.

    Args:
        path: final name of the file; an earlier file of that name is replaced.

    Yields:
        Path of an empty file in the same folder, for the block to fill and to close.

    Raises:
        VergenceError: the file cannot be written.
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
    """Write a UTF-8 text file complete or not at all.

    Raises:
        VergenceError: the file cannot be written.
    """
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8", newline="\n")
