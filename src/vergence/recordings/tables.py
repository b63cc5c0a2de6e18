"""Read folders of tables: joints in csv, images in folders or videos, with their stamps.

A csv needs a column of times. Its columns of numbers are joints, and its columns of file names are
images. The stamps of a video, or of a folder of images, are in a csv that has its name or begins
with it, such as left_stamps.csv of left.mp4; without one the names of images are their stamps.
"""

from __future__ import annotations

import os
import posixpath
import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path, PurePosixPath

import numpy as np

from vergence.errors import VergenceError, counted
from vergence.files import file_inside
from vergence.recordings.csv_table import IMAGE_SUFFIXES, CsvTable, read_csv
from vergence.recordings.recording import JointSample, Recording
from vergence.recordings.series import (
    Series,
    read_image,
    readings,
    recording_of,
    series,
    unused,
)
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
    """List the files of a folder, 9.png before 10.png; links to folders are not followed."""
    for count, (folder, folders, names) in enumerate(os.walk(root)):
        folders.sort()
        if count == MAX_FOLDERS:
            return
        yield from (Path(folder) / name for name in sorted(names, key=lambda n: (len(n), n)))


@contextmanager
def open_recording(path: Path) -> Iterator[Recording]:
    """Open a folder of tables, or a csv; VergenceError if it is damaged."""
    root = path if path.is_dir() else path.parent
    tables: dict[str, CsvTable] = {}
    videos: dict[str, Path] = {}
    folders: dict[str, list[str]] = {}
    for file in _files(root) if root == path else [path]:
        within, suffix = file.relative_to(root), file.suffix.lower()
        name = within.with_suffix("").as_posix()
        if suffix == ".csv":
            tables[name] = read_csv(file_inside(root, str(within), str(file), of="recording"))
        elif suffix in VIDEO_SUFFIXES:
            videos[name] = file_inside(root, str(within), str(file), of="recording")
        elif suffix in IMAGE_SUFFIXES:
            folders.setdefault(within.parent.as_posix(), []).append(within.as_posix())
    with ExitStack() as stack:
        yield recording_of(path, _series(root, tables, videos, folders, stack), "a recording")


def _series(
    root: Path,
    tables: dict[str, CsvTable],
    videos: dict[str, Path],
    folders: dict[str, list[str]],
    stack: ExitStack,
) -> Iterator[Series]:
    """Make channels of all images and joints; what is used up is taken from the dictionaries."""
    for name, table in tables.items():
        for column in table.images:
            files, rows = _listed(root, table, column)
            for folder in {posixpath.dirname(file) or "." for file in files}:
                folders.pop(folder, None)
            type_name = f"csv of files, times in {table.unit}"
            content = partial(_image, root, files)
            yield series(f"{name}/{column}", "images", type_name, table.stamp_ns[rows], content)
    for name in (*videos, *folders):
        of_name = re.compile(re.escape(name) + _STAMPS)
        own = next((n for n in tables if of_name.fullmatch(n) and not tables[n].images), None)
        if own is None:
            stampless = f"a csv of stamps is missing, such as {name}.csv"
            yield unused(name, stampless) if name in videos else _named(root, name, folders[name])
            continue
        if name in videos:
            video = stack.enter_context(open_video(videos[name]))
            count, content = len(video.time_s), video.frame
        else:
            count, content = len(folders[name]), partial(_image, root, folders[name])
        table = tables.pop(own)
        if len(table.stamp_ns) != count:
            stamps, images = counted(len(table.stamp_ns), "stamp"), counted(count, "image")
            raise VergenceError(f"{table.file} has {stamps}, but {name} has {images}.")
        yield series(name, "images", f"times in {table.unit}", table.stamp_ns, content)
    for name, table in tables.items():
        if table.names and len(table.values):
            content = partial(_joints, table)
            yield series(name, "joints", f"csv, times in {table.unit}", table.stamp_ns, content)
        elif not table.images:
            what = "column of times" if table.unit is None else "number"
            yield unused(name, f"csv without a {what}")


def _joints(table: CsvTable, k: int) -> JointSample:
    return readings(table.names, table.values[k])


def _image(root: Path, files: list[str], k: int) -> np.ndarray:
    return read_image(root, files[k], f"{root}: image {files[k][:200]!r}")


def _listed(root: Path, table: CsvTable, column: str) -> tuple[list[str], np.ndarray]:
    """List the files in a column by their path from the root, and the rows that have one."""
    rows = np.flatnonzero([cell is not None for cell in table.images[column]])
    files = [str(table.images[column][row]).replace("\\", "/") for row in rows]
    base = table.file.parent.relative_to(root.resolve())
    inner = base / table.file.stem  # as for data.csv beside a folder data
    if files and os.path.isfile(root / inner / files[0]):
        base = inner
    return [posixpath.normpath((base / file).as_posix()) for file in files], rows


def _named(root: Path, name: str, files: list[str]) -> Series:
    """Take the images of a folder with the stamps in their names."""
    found = [_LAST_NUMBER.search(PurePosixPath(file).stem) for file in files]
    texts = [match[1] for match in found if match]
    if len(texts) < len(files):
        return unused(name, "images without stamps in their names or in a csv", len(files))
    values = np.array([int(text) if text.isdecimal() else float(text) for text in texts])
    try:
        unit = recognise_unit(values, "the number in the names of images", str(root / name))
        stamps = nanoseconds(values, unit, str(root / name))
    except VergenceError as error:
        return unused(name, f"images without stamps: {error}", len(files))
    order = np.argsort(stamps, kind="stable")
    content = partial(_image, root, [files[k] for k in order])
    return series(name, "images", f"times in {unit} in their names", stamps[order], content)
