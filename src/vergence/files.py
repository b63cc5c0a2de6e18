"""Writing files: whole under their final name, or not at all."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from vergence.errors import VergenceError


def write_whole(path: Path, text: str) -> None:
    """Write a text file under a temporary name, then rename it: never half a file."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(text)
            os.chmod(name, 0o644)  # mkstemp's files are private
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise
    except OSError as error:
        raise VergenceError(f"Cannot write {path}: {error.strerror}.") from error
