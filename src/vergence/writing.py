"""Every file is written here: whole, under its final name, or not at all.

Writers work on a temporary file beside the target, under a lock that ends with the process, so that
what killed processes left behind can be told from what another process is writing, and is removed.
"""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from vergence.errors import VergenceError
from vergence.writable import UNFINISHED, check_folder, check_new, reason_of, writable_file

if sys.platform != "win32":
    import fcntl

_UMASK = os.umask(0o077)  # which can only be read by setting it
os.umask(_UMASK)

_finished: list[Path] = []


def finished_files() -> tuple[Path, ...]:
    """Return the files and datasets that this process has written so far, in that order."""
    return tuple(_finished)


def add_finished(files: Iterable[Path]) -> None:
    """Count among the files of this process those that others have written for it."""
    _finished.extend(files)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a `with` block a temporary file, which gets its final name when the block ends well.

    An earlier file of that name is replaced; a block that raises leaves it as it was, and no other
    file behind. Parent folders are created. VergenceError if the file cannot be written.
    """
    target = writable_file(path)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with _temporary(target) as (handle, part):
            yield part
            os.fsync(handle)  # a full disk may show only now
            part.chmod(_mode(target))
            part.replace(target)
    except OSError as error:
        kept = "; the file of that name is as it was" if target.is_file() else ""
        raise VergenceError(f"Cannot write {path}: {reason_of(error)}{kept}.") from error
    _finished.append(path)


def _mode(target: Path) -> int:
    """Return the permissions of a file that is replaced, or those of a new one."""
    if target.exists():
        return stat.S_IMODE(target.stat().st_mode)
    return 0o666 & ~_UMASK


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Give a `with` block a temporary folder, which gets its final name when the block ends well.

    A folder of that name may be there if it is empty. VergenceError if the folder cannot be written
    or is not empty.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with _temporary(folder, is_folder=True) as (_, part):
            part.chmod(0o777 & ~_UMASK)
            yield part
            check_new(folder)
            if folder.is_dir():
                folder.rmdir()
            part.rename(folder)
    except OSError as error:
        if error.errno in (errno.ENOTEMPTY, errno.EEXIST):
            check_new(folder)
        raise VergenceError(f"Cannot write the folder {folder}: {reason_of(error)}.") from error
    _finished.append(folder)


@contextmanager
def _temporary(target: Path, *, is_folder: bool = False) -> Iterator[tuple[int, Path]]:
    """Make a temporary file or folder beside the target, locked; yield its handle and path.

    Remains of killed processes with the same target are removed.
    """
    prefix = f".{target.name[:60]}."
    for remains in target.parent.glob(f"{_literal(prefix)}*.part"):
        _remove_abandoned(remains)
    while True:
        make = tempfile.mkdtemp if is_folder else tempfile.mkstemp
        made = make(dir=target.parent, prefix=prefix, suffix=".part")
        handle, part = (-1, Path(made)) if isinstance(made, str) else (made[0], Path(made[1]))
        if is_folder and sys.platform != "win32":
            handle = os.open(part, os.O_RDONLY)
        if handle < 0 or _lock(handle, part):
            break
        os.close(handle)  # another process took it for remains, and has removed it
    try:
        yield handle, part
    finally:
        if is_folder:
            shutil.rmtree(part, ignore_errors=True)
        else:
            part.unlink(missing_ok=True)
        if handle >= 0:
            os.close(handle)


def _literal(text: str) -> str:
    """Return a text as a pattern that matches itself alone."""
    return "".join(f"[{letter}]" if letter in "*?[" else letter for letter in text)


def _lock(handle: int, path: Path) -> bool:
    """Lock an open file or folder until the process ends; False if another has it, or removed it.

    Where the system has no locks the answer is True.
    """
    if sys.platform != "win32":
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:
            return True
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:
        return False


def _remove_abandoned(path: Path) -> None:
    """Remove a temporary file or folder if no process has it locked."""
    if sys.platform == "win32":
        return
    with contextlib.suppress(OSError):
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        finally:
            os.close(handle)


def unfinished(folder: Path) -> bool:
    """Return whether a run into a folder of results was stopped before its end, or is under way."""
    return os.path.exists(folder / UNFINISHED)


@contextmanager
def results_folder(folder: Path | None) -> Iterator[None]:
    """Mark a folder of results as unfinished until a `with` block ends well; None: there is none.

    A block that raises leaves the mark if it has written anything there: results of two runs may
    stand side by side then. VergenceError if the folder cannot be written, or another process is
    writing into it: the block has the whole work in it, so that this shows before.
    """
    if folder is None:
        yield
        return
    check_folder(folder)
    mark, before, ours = folder / UNFINISHED, len(_finished), True
    try:
        new = not folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
        known = mark.exists()
        handle = -1
        try:  # from before the mark is made: a run may be stopped as soon as it is there
            handle = os.open(mark, os.O_RDWR | os.O_CREAT, 0o666)
            ours = _lock(handle, mark)
            if not ours:
                raise VergenceError(
                    f"Another process is writing results into {folder}; wait for it, or name "
                    "another folder."
                )
            os.ftruncate(handle, 0)
            os.write(handle, _notice().encode())
            yield
            mark.unlink(missing_ok=True)
        except BaseException:
            written = any(path.parent == folder for path in _finished[before:])
            if ours and not known and not written:
                mark.unlink(missing_ok=True)
                if new:
                    with contextlib.suppress(OSError):  # it is not empty
                        folder.rmdir()
            raise
        finally:
            if handle >= 0:
                os.close(handle)
    except OSError as error:
        raise VergenceError(
            f"Cannot write into the folder {folder}: {reason_of(error)}."
        ) from error


def _notice() -> str:
    return (
        f"The run that began at {time.strftime('%Y-%m-%d %H:%M:%S')} has not finished: files of "
        "this folder may be of different runs. A run that finishes removes this file.\n"
    )


def write_whole(path: Path, text: str) -> None:
    """Write a UTF-8 text file as `whole_file` does."""
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8", newline="\n")


def write_json(value: Any, path: Path) -> None:
    """Write a dataclass or a dictionary as JSON as `whole_file` does; NaN and infinity are null."""
    write_whole(path, as_json(value))


def as_json(value: Any, digits: int | None = None) -> str:
    """Return a dataclass or a dictionary as JSON; NaN and infinity are null.

    Numbers have so many significant digits; None: as many as they have.
    """
    adapter: TypeAdapter[Any] = TypeAdapter(type(value))
    if digits is None:
        return adapter.dump_json(value, indent=1).decode() + "\n"
    return json.dumps(_rounded(adapter.dump_python(value, mode="json"), digits), indent=1) + "\n"


def _rounded(value: Any, digits: int) -> Any:
    """Return plain values, their numbers rounded to significant digits."""
    if isinstance(value, dict):
        return {name: _rounded(each, digits) for name, each in value.items()}
    if isinstance(value, list):
        return [_rounded(each, digits) for each in value]
    if isinstance(value, float):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else None
    return value


def markdown_table(heading: str, rows: Iterable[Sequence[object]]) -> str:
    """Return a table in markdown, whose heading has its cells divided by vertical bars."""
    lines = [f"| {heading} |", "|" + "---|" * (heading.count("|") + 1)]
    return "\n".join(lines + ["| " + " | ".join(map(str, row)) + " |" for row in rows])
