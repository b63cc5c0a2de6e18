"""Read folders of tables: joints in csv, images in folders or videos, with their stamps.

A csv needs a header and a column of times. Its columns of numbers are joints, and its columns of
file names are images. The stamps of a video, or of a folder of images, are in a csv that has its
name or begins with it, such as left_stamps.csv of left.mp4; else the names of images are stamps.
"""

from __future__ import annotations

import os
import posixpath
import re
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path, PurePosixPath

import numpy as np
import pyarrow
from pyarrow import csv, types

from vergence.arrays import Array
from vergence.errors import VergenceError, explain
from vergence.files import read_bytes
from vergence.recordings import series
from vergence.recordings.recording import Recording
from vergence.recordings.series import Series, read_stamps
from vergence.recordings.video import VIDEO_SUFFIXES, open_video

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".ppm", ".pgm", ".bmp", ".tif", ".tiff", ".webp")
MAX_TABLE_BYTES, MAX_CELLS = 2**27, 20_000_000
"""Largest csv [bytes, cells]; ten joints at 100 Hz for three hours have 110 MB in 12 million."""
_TIME = re.compile(r"time|stamp|(^|[^a-z])(ts?|secs?|seconds|[mun]s)([^a-z]|$)")
_STAMPS = r"([/_.-]?(time|stamp|frame)\w*)?"
"""What may follow the name of images in the name of a csv of their stamps."""
_NUMBER = re.compile(r"[+-]?\d*\.?\d+(e[+-]?\d+)?", re.IGNORECASE)
_LAST_NUMBER = re.compile(r"(?<!\d)(\d{1,19}(?:\.\d{1,30})?)\D*$")

_Table = tuple[str, np.ndarray, dict[str, Array], dict[str, list[str | None]]]
"""Of N rows: the unit of the times as it was recognised, stamps (N,) [ns], and by column numbers
(N,), NaN for empty cells, and names of image files."""


def recognise(path: Path) -> bool:
    """Test whether a path is a csv, or a folder with one that is not a dataset."""
    if os.path.isdir(path) and not os.path.exists(path / "dataset.json"):
        return any(file.suffix.lower() == ".csv" for file in series.files_in(path))
    return path.suffix.lower() == ".csv" and os.path.isfile(path)


@contextmanager
def open_recording(path: Path) -> Iterator[Recording]:
    """Open a folder of tables, or a csv; VergenceError if it is damaged."""
    root = path if path.is_dir() else path.parent
    with ExitStack() as stack:
        files = series.files_in(root) if root == path else [Path(path.name)]
        yield series.recording_of(path, _channels(root, files, stack))


def _channels(root: Path, files: Iterable[Path], stack: ExitStack) -> Iterator[Series]:
    """Make channels of all images and joints."""
    tables: dict[str, _Table] = {}
    images: dict[str, list[str]] = {}
    for file in files:
        name, suffix = file.with_suffix("").as_posix(), file.suffix.lower()
        if suffix == ".csv":
            if table := _read(series.inside(root, file)):
                tables[name] = table
            else:
                yield series.unused(name, "a csv without a column of times")
        elif suffix in VIDEO_SUFFIXES:
            images[name] = [str(file)]
        elif suffix in IMAGE_SUFFIXES:
            images.setdefault(file.parent.as_posix(), []).append(file.as_posix())
    for name, (unit, stamps, _, listed) in tables.items():
        for column, cells in listed.items():
            rows = np.flatnonzero([cell is not None for cell in cells])
            shown = _paths(root, name, [str(cells[row]) for row in rows])
            for folder in {posixpath.dirname(file) or "." for file in shown}:
                images.pop(folder, None)
            content = partial(series.read_image, root, shown)
            yield Series(f"{name}/{column}", "images", f"times in {unit}", stamps[rows], content)
    for name, shown in images.items():
        of_name = re.compile(re.escape(name) + _STAMPS)
        of_stamps = next((n for n in tables if of_name.fullmatch(n) and not tables[n][3]), None)
        is_video = shown[0].lower().endswith(VIDEO_SUFFIXES)
        try:
            if of_stamps is None and is_video:
                raise VergenceError(f"a csv of its stamps is missing, such as {name}.csv")
            unit, stamps = tables.pop(of_stamps)[:2] if of_stamps else _stamps_in(shown)
        except VergenceError as error:
            yield series.unused(name, f"without stamps: {error}")
            continue
        count, content = len(shown), partial(series.read_image, root, shown)
        if is_video:
            times_s, content = stack.enter_context(open_video(series.inside(root, shown[0])))
            count = len(times_s)
        if len(stamps) != count:
            raise VergenceError(f"{root / name} has {count} images, but {len(stamps)} stamps.")
        yield Series(name, "images", f"times in {unit}", stamps, content)
    for name, (unit, stamps, numbers, listed) in tables.items():
        if numbers and len(stamps):
            values = np.array([*numbers.values()], float).T
            content = partial(series.readings, tuple(numbers), values)
            yield Series(name, "joints", f"csv, times in {unit}", stamps, content)
        elif not listed:
            yield series.unused(name, "a csv of times without numbers")


def _paths(root: Path, name: str, files: list[str]) -> list[str]:
    """Find the files that a csv names, in its folder or, as for data.csv, in one of its name."""
    in_folder = bool(files) and os.path.isfile(root / name / files[0])
    base = name if in_folder else posixpath.dirname(name)
    return [posixpath.normpath(posixpath.join(base, file.replace("\\", "/"))) for file in files]


def _stamps_in(files: list[str]) -> tuple[str, np.ndarray]:
    """Find stamps (N,) [ns] in the names of images, and their unit; VergenceError without any."""
    found = [_LAST_NUMBER.search(PurePosixPath(file).stem) for file in files]
    texts = [match[1] if match else "nan" for match in found]
    values = np.array([int(text) if text.isdecimal() else float(text) for text in texts])
    if values.dtype == object:  # of integers beyond 64 bits
        values = values.astype(float)
    return read_stamps(values, "the number in names of images", posixpath.dirname(files[0]))


def _read(file: Path) -> _Table | None:
    """Read a csv with a header; None if it has no column of times.

    VergenceError if it is damaged, too large, or has text among the numbers of a column.
    """
    content = read_bytes(file, MAX_TABLE_BYTES)
    header = content[: content.find(b"\n") + 1 or None]
    delimiter = max(b",;\t", key=header.count)
    if content.count(b"\n") * (header.count(delimiter) + 1) > MAX_CELLS:
        raise VergenceError(f"{file} is too large: at most {MAX_CELLS:,} cells are read.")
    numbers: dict[str, Array] = {}
    files: dict[str, list[str | None]] = {}
    try:
        table = csv.read_csv(
            pyarrow.py_buffer(content),
            read_options=csv.ReadOptions(use_threads=False),  # so that errors name the row
            parse_options=csv.ParseOptions(delimiter=chr(delimiter)),
            convert_options=csv.ConvertOptions(strings_can_be_null=True),
        )
        titles = [title.strip(" \t#%") for title in table.column_names]
        if len(set(titles)) < len(titles):
            raise ValueError("two columns have one name")
        for name, column in zip(titles, table.columns, strict=True):
            if types.is_integer(column.type) or types.is_floating(column.type):
                numbers[name] = column.to_numpy()
            elif types.is_string(column.type):
                cells = column.to_pylist()
                if any((cell or "").lower().endswith(IMAGE_SUFFIXES) for cell in cells):
                    files[name] = cells
                elif any(_NUMBER.fullmatch(cell or "") for cell in cells):
                    column.cast(pyarrow.float64())  # names the text among them
    except (pyarrow.ArrowException, ValueError) as error:
        raise VergenceError(f"{file} cannot be read as a csv: {explain(error)}.") from error
    times = {name: numbers.pop(name) for name in [*numbers] if _TIME.search(name.lower())}
    if not times:
        return None
    time = next((name for name in times if "stamp" in name.lower()), next(iter(times)))
    return *read_stamps(times[time], time, str(file)), numbers, files
