"""Read folders of tables: joints in csv, images in folders or videos, with their stamps.

A csv needs a column of times. Its columns of numbers are joints, and its columns of file names are
images. The stamps of a video, or of a folder of images, are in a csv that has its name or begins
with it, such as left_stamps.csv of left.mp4; without one the names of images are their stamps.
"""

from __future__ import annotations

import os
import posixpath
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path, PurePosixPath

import numpy as np

from vergence.errors import VergenceError, counted
from vergence.files import file_inside
from vergence.recordings.csv_table import IMAGE_SUFFIXES, CsvTable, read_csv
from vergence.recordings.recording import Channel, Content, JointSample, Recording
from vergence.recordings.series import Series, read_image, recording_of, unused
from vergence.recordings.stamps import nanoseconds, recognise_unit
from vergence.recordings.video import VIDEO_SUFFIXES, open_video

MAX_FOLDERS = 1000
"""Most folders of a recording; each camera has one."""
_STAMPS = r"([/_.-]?(time|stamp|frame)\w*)?"
"""What may follow the name of images in the name of a csv of their stamps."""
_LAST_NUMBER = re.compile(r"(\d{1,30}(?:\.\d{1,30})?)\D*$")


def recognise(path: Path) -> bool:
    """Test whether a path is a csv, or a folder with one that is not a dataset."""
    if path.is_dir() and not (path / "dataset.json").exists():
        return any(file.suffix.lower() == ".csv" for file in _files(path))
    return path.suffix.lower() == ".csv" and path.is_file()


def _files(root: Path) -> Iterator[Path]:
    """List the files of a folder in their natural order; links to folders are not followed."""
    for count, (folder, folders, names) in enumerate(os.walk(root)):
        folders.sort()
        if count == MAX_FOLDERS:
            return
        yield from (Path(folder) / name for name in sorted(names, key=_natural))


def _natural(name: str) -> list[tuple[int, str]]:
    """Make a key that sorts 9.png before 10.png."""
    parts = re.split(r"(\d{1,30})", name)
    return [(int(part), "") if part.isdecimal() else (0, part) for part in parts]


@contextmanager
def open_recording(path: Path) -> Iterator[Recording]:
    """Open a folder of tables, or a csv; VergenceError if it is damaged."""
    root = path if path.is_dir() else path.parent
    series: list[Series] = []
    tables: dict[str, CsvTable] = {}
    videos: dict[str, Path] = {}
    folders: dict[str, list[str]] = {}
    for file in _files(root) if root == path else [path]:
        within, suffix = file.relative_to(root), file.suffix.lower()
        name = within.with_suffix("").as_posix()
        if suffix == ".csv":
            table = read_csv(file_inside(root, str(within), str(file), of="recording"))
            if table is None:
                series.append(unused(name, "csv without a column of times"))
            else:
                tables[name] = table
        elif suffix in VIDEO_SUFFIXES:
            videos[name] = file_inside(root, str(within), str(file), of="recording")
        elif suffix in IMAGE_SUFFIXES:
            folders.setdefault(within.parent.as_posix(), []).append(within.as_posix())
    with ExitStack() as stack:
        series += _series(root, tables, videos, folders, stack)
        yield recording_of(path, series, "a recording")


def _series(
    root: Path,
    tables: Mapping[str, CsvTable],
    videos: Mapping[str, Path],
    folders: Mapping[str, list[str]],
    stack: ExitStack,
) -> Iterator[Series]:
    """Find out which tables are stamps of which images."""
    listed, stamps = set(), set()
    for name, table in tables.items():
        for column in table.images:
            each, parents = _listed_images(root, name, table, column)
            listed |= parents
            yield each
    for name in (*videos, *folders):
        if name in folders and name in listed:
            continue
        of_name = re.compile(re.escape(name) + _STAMPS)
        own = [n for n in tables if of_name.fullmatch(n) and not tables[n].images]
        stamps.update(own[:1])
        table = tables[own[0]] if own else None
        if name in folders:
            yield _folder(root, name, folders[name], table)
        elif table is None:
            yield unused(name, f"video without a csv of its stamps, such as {name}.csv")
        else:
            video = stack.enter_context(open_video(videos[name]))
            yield _stamped(name, "video", table, len(video.time_s), video.frame)
    for name, table in tables.items():
        if name in stamps or (table.images and not table.names):
            continue
        if not table.names or not len(table.values):
            yield unused(name, "csv of times without numbers")
        else:
            channel = Channel(name, "joints", f"csv, times in {table.unit}", len(table.values))
            yield Series(channel, table.stamp_ns, table.stamp_ns, partial(_joints, table))


def _joints(table: CsvTable, k: int) -> JointSample:
    values = table.values[k]
    known = np.isfinite(values)
    names = table.names if known.all() else tuple(np.array(table.names)[known].tolist())
    return JointSample(names, values[known])


def _listed_images(root: Path, name: str, table: CsvTable, column: str) -> tuple[Series, set[str]]:
    """Take images from a column of file names; also return the folders in which they are."""
    cells = table.images[column]
    rows = np.flatnonzero([cell is not None for cell in cells])
    files = [str(cells[row]).replace("\\", "/") for row in rows]
    base = table.file.parent.relative_to(root)
    if files and not os.path.isfile(root / base / files[0]):
        inner = base / table.file.stem  # as in data.csv beside a folder data
        base = inner if os.path.isfile(root / inner / files[0]) else base
    files = [posixpath.normpath((base / file).as_posix()) for file in files]
    stamps = table.stamp_ns[rows]
    channel = Channel(
        f"{name}/{column}", "images", f"csv of files, times in {table.unit}", len(rows)
    )
    series = Series(channel, stamps, stamps, partial(_image, root, files))
    return series, {posixpath.dirname(file) or "." for file in files}


def _image(root: Path, files: list[str], k: int) -> np.ndarray:
    return read_image(root, files[k], f"{root}: image {files[k][:200]!r}")


def _stamped(
    name: str, type_name: str, table: CsvTable, count: int, content: Callable[[int], Content]
) -> Series:
    """Give images the stamps of a csv; VergenceError if there are not as many."""
    if len(table.stamp_ns) != count:
        raise VergenceError(
            f"{table.file} has {counted(len(table.stamp_ns), 'stamp')}, but {name} has "
            f"{counted(count, 'image')}."
        )
    channel = Channel(name, "images", f"{type_name}, times in {table.unit}", count)
    return Series(channel, table.stamp_ns, table.stamp_ns, content)


def _folder(root: Path, name: str, files: list[str], table: CsvTable | None) -> Series:
    """Take the images of a folder, with the stamps of a csv or those in their names."""
    if table is not None:
        return _stamped(name, "images", table, len(files), partial(_image, root, files))
    numbers = [_LAST_NUMBER.search(PurePosixPath(file).stem) for file in files]
    try:
        texts = [number[1] for number in numbers if number]
        values = np.array([int(text) if text.isdecimal() else float(text) for text in texts])
        unit = recognise_unit(values, "the number in the names of images", f"{root / name}")
        stamps = nanoseconds(values, unit, f"{root / name}")
    except VergenceError as error:
        return unused(name, f"images without stamps: {error}", len(files))
    if len(stamps) < len(files):
        return unused(name, "images without stamps in their names or in a csv", len(files))
    order = np.argsort(stamps, kind="stable")
    channel = Channel(name, "images", f"images, times in {unit} in their names", len(files))
    files = [files[k] for k in order]
    return Series(channel, stamps[order], stamps[order], partial(_image, root, files))
