"""Read files within limits, and write files and folders whole or not at all.

docs/security.md states the limits of every reader and the guarantees of writing.
"""

from __future__ import annotations

import errno
import json
import math
import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from vergence.errors import VergenceError, explain

T = TypeVar("T")

MAX_JSON_BYTES = 16 * 2**20
"""Largest JSON file [bytes]; a calibration of 16 cameras has 2 MB, the truth of 18,000 frames 5."""
MAX_KEYS = 20_000
"""Most keys of an object in JSON; a truth has one for each pose of the board."""
MAX_DIGITS = 40
"""Longest number in a file [characters]; a float needs at most 24."""
REPORT = "report.md"
UNFINISHED = "UNFINISHED.txt"
"""Marks a folder of results while a run writes into it, and after a run that was stopped."""
TEMPORARY = ".part"
"""Ending of folders with files that are being written."""

finished_files: list[Path] = []
"""Files and datasets that this process has written, in order."""


def read_bytes(path: Path, most_bytes: int) -> bytes:
    """Read a regular file; VergenceError if it is missing, too large or not a regular file."""
    try:
        if path.exists() and not path.is_file():  # to open a pipe would block
            raise VergenceError(f"Cannot read {path}: it is {_kind(path)}.")
        with path.open("rb") as file:
            large = os.fstat(file.fileno()).st_size > most_bytes
            content = b"" if large else file.read(most_bytes + 1)
    except OSError as error:
        raise VergenceError(f"Cannot read {path}: {error.strerror}.") from error
    except ValueError:
        raise VergenceError(f"{str(path)!r} is not a possible file name.") from None
    if large or len(content) > most_bytes:
        raise VergenceError(
            f"{path} is too large: a file of this kind has at most {most_bytes:,} bytes."
        )
    return content


def file_inside(folder: Path, name: str, where: str, *, of: str) -> Path:
    """Find a regular file by its name in a folder, which no name and no link to a file may leave.

    Links to folders are followed: who named the folder has laid them. `of` names what the folder
    holds, and `where` begins the sentence of a VergenceError.
    """
    root = folder.resolve()
    try:
        path = (root / name).resolve()
        plain = ".." not in Path(name).parts and not Path(name).is_absolute()
        linked = plain and path.parent == (root / name).parent.resolve()
        is_file = path.is_file()
    except (OSError, ValueError, RuntimeError):  # too long, a zero byte, a loop of links
        raise VergenceError(f"{where} is not a possible file name.") from None
    if not path.is_relative_to(root) and not linked:
        raise VergenceError(f"{where} leads out of the {of}'s folder.")
    if not is_file:
        raise VergenceError(f"{where} is missing, or not a regular file.")
    return path


def _kind(path: Path) -> str:
    return "a folder, not a file" if path.is_dir() else "not a regular file"


def read_parsed(
    path: Path,
    what: str,
    build: Callable[[Any], T],
    parse: Callable[[str], Any],
    *,
    most_bytes: int = MAX_JSON_BYTES,
) -> T:
    """Read, parse and build the content of a text file in UTF-8.

    `what` names the kind of file with its article. `parse` makes dictionaries and lists of the
    text, and `build` the result of these; both raise ValueError for invalid content. VergenceError
    if the file is missing, too large or invalid.
    """
    content = read_bytes(path, most_bytes)
    try:
        return build(parse(content.decode("utf-8-sig")))
    # Parsers and numpy raise more than ValueError for odd content.
    except (ValueError, TypeError, LookupError, ArithmeticError, RecursionError) as error:
        raise VergenceError(f"{path} is not {what}: {explain(error)}.") from None


def read_json(path: Path, kind: type[T], what: str) -> T:
    """Read a dataclass from JSON; see `read_parsed`."""
    return read_parsed(path, what, lambda content: validated(content, kind), parse_json)


def validated(content: Any, kind: type[T]) -> T:
    """Convert parsed content to a type; ValueError names the first invalid field."""
    from pydantic import TypeAdapter, ValidationError  # `vergence --help` does not wait for it

    try:
        return TypeAdapter(kind).validate_python(content)
    except ValidationError as error:
        raise ValueError(explain(error, kind)) from None


def parse_json(text: str) -> Any:
    """Parse JSON; ValueError for NaN, infinity, repeated keys and numbers that are too long."""
    return json.loads(
        text,
        object_pairs_hook=unique_keys,
        parse_int=lambda digits: int(_finite(digits)),
        parse_float=lambda digits: float(_finite(digits)),
        parse_constant=_finite,
    )


def unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Make a dictionary of pairs; ValueError for a repeated key or more than MAX_KEYS."""
    content = dict(pairs)
    if len(content) < len(pairs):
        name, _ = Counter(name for name, _ in pairs).most_common(1)[0]
        raise ValueError(f"the key {name[:60]!r} is repeated")
    if len(content) > MAX_KEYS:
        raise ValueError(f"an object has {len(content)} keys; at most {MAX_KEYS} are read")
    return content


def _finite(digits: str) -> str:
    """Check the text of a number."""
    if len(digits) > MAX_DIGITS or not math.isfinite(float(digits)):
        raise ValueError(f"{digits[:60]} is not a finite number of at most {MAX_DIGITS} digits")
    return digits


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Raise errors of the system as VergenceError."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or explain(error)
        raise VergenceError(f"Cannot write {path}: {reason}.") from error


@contextmanager
def _replaced(target: Path) -> Iterator[Path]:
    """Give a `with` block a path in a temporary folder, and rename it to the target afterwards."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(
        dir=target.parent,
        prefix=f".{target.name[:60]}.",
        suffix=TEMPORARY,
        ignore_cleanup_errors=True,
    ) as folder:
        part = Path(folder) / target.name
        yield part
        os.replace(part, target)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a `with` block a temporary file, and rename it to its final name afterwards.

    The file replaces an earlier one of that name; a block that raises leaves the earlier one as it
    was. Parent folders are created. VergenceError if the file cannot be written.
    """
    target = check_writable(path)
    with _writing(path), _replaced(target) as part:
        yield part
        with part.open("rb") as file:
            os.fsync(file.fileno())  # a full disk may show only now
        if target.exists():
            shutil.copymode(target, part)
    finished_files.append(path)


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """Give a `with` block a temporary folder, and rename it to its final name afterwards.

    An empty folder of that name is replaced. VergenceError if the folder cannot be written or is
    not empty.
    """
    check_new(folder)
    with _writing(folder), _replaced(folder) as part:
        part.mkdir()
        yield part
    finished_files.append(folder)


@contextmanager
def results_folder(folder: Path | None) -> Iterator[None]:
    """Mark a folder of results as unfinished until a `with` block ends without an error.

    The block contains the whole work, so that a folder that cannot be written is found before it.
    Another process may not write there meanwhile. None: no results are written. VergenceError if
    the folder cannot be written.
    """
    if folder is None:
        yield
        return
    check_writable(folder, folder=True)
    mark, new, lock = folder / UNFINISHED, not folder.exists(), None
    with _writing(folder):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            lock = _lock(folder)
            for path in folder.glob(f".*{TEMPORARY}"):  # of a process that was killed
                shutil.rmtree(path, ignore_errors=True)
            mark.write_text(
                f"The run that began at {time.strftime('%Y-%m-%d %H:%M:%S')} has not finished: "
                "files of this folder may be of different runs. A run that finishes removes this "
                "file.\n"
            )
            yield
            mark.unlink(missing_ok=True)
        except BlockingIOError:
            raise VergenceError(
                f"Another process is writing results into {folder}; wait for it, or name another "
                "folder."
            ) from None
        except BaseException:
            for path in folder.glob(f".*{TEMPORARY}"):
                shutil.rmtree(path, ignore_errors=True)
            if folder.exists() and set(folder.iterdir()) <= {mark}:  # it holds no results
                mark.unlink(missing_ok=True)
                if new:
                    folder.rmdir()
            raise
        finally:
            if lock is not None:
                os.close(lock)


def _lock(folder: Path) -> int | None:
    """Open and lock a folder; BlockingIOError if another process holds the lock."""
    if sys.platform == "win32":
        return None
    import fcntl

    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise
    except OSError:
        pass  # a network drive without locks
    return handle


def write_whole(path: Path, text: str) -> None:
    """Write a text file in UTF-8; see `whole_file`."""
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8", newline="\n")


def write_json(value: Any, path: Path) -> None:
    """Write a dataclass or a dictionary as JSON; NaN and infinity become null."""
    write_whole(path, as_json(value))


def as_json(value: Any, digits: int = 17) -> str:
    """Convert a dataclass or a dictionary to JSON; NaN and infinity become null.

    `digits`: significant digits of its numbers; 17 distinguish all.
    """
    from pydantic import TypeAdapter

    text = TypeAdapter(type(value)).dump_json(value, indent=1).decode()
    if digits < 17:
        rounded = json.loads(text, parse_float=lambda number: float(f"{float(number):.{digits}g}"))
        text = json.dumps(rounded, indent=1)
    return text + "\n"


def markdown_table(heading: str, rows: Iterable[Sequence[object]]) -> str:
    """Format an aligned table in markdown; vertical bars divide the cells of the heading."""
    cells = [[cell.strip() for cell in heading.split("|")], *([*map(str, row)] for row in rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = [
        f"| {' | '.join(cell.ljust(w) for cell, w in zip(row, widths, strict=True))} |"
        for row in cells
    ]
    lines.insert(1, f"|{'|'.join('-' * (width + 2) for width in widths)}|")
    return "\n".join(lines)


def check_new(folder: Path) -> None:
    """Raise VergenceError if a folder cannot be created, or exists and is not empty."""
    check_writable(folder, folder=True)
    with _writing(folder):
        if folder.is_dir() and any(folder.iterdir()):
            raise VergenceError(
                f"{folder} already exists and is not empty; name another folder, or remove it."
            )


def check_writable(path: Path, *, folder: bool = False) -> Path:
    """Follow the links of a path to a file or folder; VergenceError if it cannot be written."""
    try:
        target = path.resolve()
    except RuntimeError as error:
        raise VergenceError(f"Cannot write {path}: {explain(error)}.") from error
    except ValueError:
        raise VergenceError(f"{str(path)!r} is not a possible file name.") from None
    with _writing(path):
        if target.exists() and not (target.is_dir() if folder else target.is_file()):
            raise VergenceError(f"Cannot write {path}: it is {_kind(target)}.")
        parent = target if folder else target.parent
        while not parent.exists():
            parent = parent.parent
        if not parent.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        if not os.access(parent, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, f"no permission to write into {parent}")
    return target
