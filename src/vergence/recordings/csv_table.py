"""Read a csv with a column of times, columns of numbers and columns of names of image files."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
from pyarrow import csv, types

from vergence.arrays import Array
from vergence.errors import VergenceError, explain
from vergence.files import read_bytes
from vergence.recordings.stamps import nanoseconds, recognise_unit

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".ppm", ".pgm", ".bmp", ".tif", ".tiff", ".webp")
MAX_TABLE_BYTES = 256 * 2**20
"""Largest csv [bytes]; twenty joints at 100 Hz for three hours have 200 MB."""
MAX_CELLS = 30_000_000
"""Most cells of a csv; as floats they have 240 MB."""
_NUMBER = re.compile(r"\s*[+-]?\d+\.?\d*(e[+-]?\d+)?\s*", re.IGNORECASE)
_TIME = re.compile(r"time|stamp|(^|[^a-z])(ts?|secs?|seconds|[mun]s)([^a-z]|$)")


@dataclass(frozen=True, eq=False)
class CsvTable:
    """A csv of N rows with C columns of numbers."""

    file: Path
    unit: str | None
    """Of its times, as it was recognised; None: it has no column of times."""
    stamp_ns: np.ndarray
    """(N,) of int64."""
    names: tuple[str, ...]
    """(C,)"""
    values: Array
    """(N, C), NaN where a cell is empty."""
    images: dict[str, list[str | None]]
    """By column names of files (N,)."""


def read_csv(file: Path) -> CsvTable:
    """Read a csv with a header.

    VergenceError if it is damaged, too large, or has text among the numbers of a column.
    """
    content = read_bytes(file, MAX_TABLE_BYTES)
    header = content[: content.find(b"\n") + 1 or None]
    delimiter = max(b",;\t", key=header.count)
    cells = content.count(b"\n") * (header.count(delimiter) + 1)
    if cells > MAX_CELLS:
        raise VergenceError(f"{file} has {cells:,} cells; at most {MAX_CELLS:,} are read.")
    try:
        table = csv.read_csv(
            pyarrow.py_buffer(content),
            read_options=csv.ReadOptions(use_threads=False),  # so that errors name the row
            parse_options=csv.ParseOptions(delimiter=chr(delimiter)),
            convert_options=csv.ConvertOptions(strings_can_be_null=True),
        )
    except (pyarrow.ArrowException, ValueError) as error:
        raise VergenceError(f"{file} cannot be read as a csv: {explain(error)}.") from error
    names = [name.strip(" \t#%") for name in table.column_names]
    columns = dict(zip(names, table.columns, strict=True))
    if len(columns) < len(names):
        raise VergenceError(f"{file} has two columns of one name among {', '.join(names):.300}.")
    texts = {name: column for name, column in columns.items() if types.is_string(column.type)}
    images = {}
    for name, column in texts.items():
        cells = column.to_pylist()
        if any(Path(cell or "").suffix.lower() in IMAGE_SUFFIXES for cell in cells[:100]):
            images[name] = cells
        else:
            _check_texts(cells, f"{file}, column {name}")
    readable = {name: column for name, column in columns.items() if _is_readable(column.type)}
    times = [name for name in readable if _TIME.search(name.lower())]
    if not times:
        return CsvTable(file, None, np.zeros(0, np.int64), (), np.zeros((0, 0)), {})
    time = next((name for name in times if "stamp" in name.lower()), times[0])
    unit, stamp_ns = _stamps(readable[time], time, file)
    numbers = {
        name: column.cast(pyarrow.float64(), safe=False).to_numpy()
        for name, column in readable.items()
        if name not in times and not (types.is_timestamp(column.type) or types.is_null(column.type))
    }
    values = np.stack([*numbers.values()], axis=-1) if numbers else np.zeros((len(stamp_ns), 0))
    return CsvTable(file, unit, stamp_ns, tuple(numbers), values, images)


def _is_readable(kind: Any) -> bool:
    tests = types.is_integer, types.is_floating, types.is_timestamp, types.is_null
    return any(test(kind) for test in tests)


def _check_texts(cells: list[str | None], where: str) -> None:
    """Raise VergenceError for a column of numbers and texts."""
    number = [cell is None or _NUMBER.fullmatch(cell) is not None for cell in cells]
    if any(each and cell for each, cell in zip(number, cells, strict=True)):
        k = number.index(False)
        raise VergenceError(f"{where}: row {k + 1} below the header has {cells[k]!r:.60}.")


def _stamps(column: Any, name: str, file: Path) -> tuple[str, np.ndarray]:
    """Convert a column of times to a unit and nanoseconds (N,)."""
    import pyarrow

    where = f"{file}, column {name}"
    if column.null_count:
        row = column.is_null().to_pylist().index(True) + 1
        raise VergenceError(f"{where}: row {row} below the header has no time.")
    if types.is_timestamp(column.type):
        naive = column.cast(pyarrow.timestamp("ns", column.type.tz)).cast(pyarrow.int64())
        return "dates", naive.to_numpy()
    empty = types.is_null(column.type)
    values = (column.cast(pyarrow.float64()) if empty else column).to_numpy()
    unit = recognise_unit(values, name, where)
    return unit, nanoseconds(values, unit, where)
