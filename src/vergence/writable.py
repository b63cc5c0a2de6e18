"""Whether results can be written: checked before any work is done for them."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from collections.abc import Collection, Iterable
from pathlib import Path

from vergence.errors import VergenceError, explain

REPORT = "report.md"
UNFINISHED = "UNFINISHED.txt"
"""Stands in a folder of results while they are being written, and after a run that was stopped."""


OWNED = {
    "dataset.json": "a dataset",
    "dataset.rrd": "a report of calibrate",
    "depth.rrd": "results of depth",
    "design.json": "results of design",
    "foveate.rrd": "results of foveate",
    "grasp.rrd": "results of grasp",
    "statistics.json": "results of reproduce",
    "track.rrd": "results of track",
}
"""Files by which a folder is known to be of one command alone, and what it is then."""


def check_outputs(
    *outputs: Path | None,
    figure: Path | None = None,
    folder: Path | None = None,
    names: Iterable[str] = (),
    title: str = "",
    inputs: Iterable[Path] = (),
) -> None:
    """Check before any work that files can be written, and a folder of results.

    Nothing is made.

    Args:
        outputs: the files; None: not asked for.
        figure: another one, a picture in PNG.
        folder: of the results.
        names: of files that are written into the folder.
        title: with which the folder's report.md begins; one of something else would be lost.
        inputs: files that the same command reads.

    Raises:
        VergenceError: a path cannot be written, two are the same, one of them is an input or the
            folder, the folder is a dataset, has the results of another command or the report of
            something else, or the name of the figure does not end in .png.
    """
    if figure is not None and figure.suffix.lower() != ".png":
        raise VergenceError(f"A figure is a PNG file, whose name ends in .png; found {figure}.")
    taken = {place: "the file that is read" for place in map(_place, inputs)}
    names = tuple(names)
    if folder is not None:
        check_folder(folder)
        outputs = (*outputs, *(folder / name for name in (*names, UNFINISHED)))
        place = _place(folder)
        taken |= dict.fromkeys((place, *place.parents), "a folder of other results")
    for path in filter(None, (*outputs, figure)):
        place = writable_file(path)
        if place in taken:
            raise VergenceError(f"Cannot write {path}: it is also {taken[place]}.")
        taken[place] = "the file of another result"
    if folder is not None:
        _check_owner(folder, names)
        if title:
            _check_report(folder / REPORT, title)


def check_new(folder: Path) -> None:
    """Raise VergenceError if a folder cannot be made, or is there and not empty."""
    check_folder(folder)
    try:
        filled = folder.is_dir() and any(folder.iterdir())
    except OSError as error:
        raise VergenceError(f"Cannot write the folder {folder}: {reason_of(error)}.") from error
    if filled:
        raise VergenceError(
            f"{folder} already exists and is not empty; name another folder, or remove it."
        )


def _check_owner(folder: Path, names: Collection[str]) -> None:
    for name, what in OWNED.items():
        if name not in names and os.path.exists(folder / name):
            raise VergenceError(
                f"{folder} is {what}, since it has {name}: other results do not go into it. Name "
                "another folder."
            )


def _check_report(path: Path, title: str) -> None:
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            found = file.readline(80).strip()
    except FileNotFoundError:
        return
    except OSError as error:
        raise VergenceError(f"Cannot read {path}: {error.strerror}.") from error
    if not found.startswith(title):
        raise VergenceError(
            f"{path} is the report of something else, and would be lost: it begins with {found!r}, "
            f"not with {title!r}. Name another folder, or remove that file."
        )


def _place(path: Path) -> Path:
    """Return the file that a path leads to, or the path itself if it cannot lead to any."""
    try:
        return Path(os.path.realpath(path))  # for links in a circle too, unlike Path.resolve
    except ValueError:
        return path


def writable_file(path: Path) -> Path:
    """Return the file that a path leads to; VergenceError if it cannot be written."""
    try:
        target = path.resolve()  # through links: these stay
        with contextlib.suppress(FileNotFoundError):
            mode = target.stat().st_mode
            if stat.S_ISDIR(mode):
                raise VergenceError(
                    f"Cannot write {path}: it is a folder, and a file is to be written; name one "
                    "in it or beside it."
                )
            if not stat.S_ISREG(mode):
                raise VergenceError(f"Cannot write {path}: it is not a regular file.")
        _check_writable(target.parent)
    except (OSError, RuntimeError) as error:  # RuntimeError: links in a circle
        raise VergenceError(f"Cannot write {path}: {reason_of(error)}.") from error
    except ValueError:
        raise VergenceError(f"{str(path)!r} is not a possible file name.") from None
    return target


def check_folder(folder: Path) -> None:
    try:
        if folder.exists() and not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        _check_writable(folder.resolve())
    except (OSError, RuntimeError) as error:
        raise VergenceError(
            f"Cannot write into the folder {folder}: {reason_of(error)}."
        ) from error
    except ValueError:
        raise VergenceError(f"{str(folder)!r} is not a possible file name.") from None


def _check_writable(folder: Path) -> None:
    """Raise OSError if no file can be made in a folder, which need not be there yet."""
    while not folder.exists():
        folder = folder.parent
    if not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, f"{folder} is not a folder")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, f"no permission to write into {folder}")


def reason_of(error: Exception) -> str:
    return getattr(error, "strerror", None) or explain(error)
