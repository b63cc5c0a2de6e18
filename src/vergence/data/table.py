"""frames.csv as rows of text whose cells are read as numbers, or refused with line and column."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, nan
from pathlib import Path

import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError, explain


@dataclass(frozen=True)
class TableRow:
    """One row of frames.csv as text."""

    where: str
    """File and line, for messages."""
    line: int
    cells: Mapping[str, str]

    def number(self, column: str) -> float:
        """Return a cell as a finite number; VergenceError if it is none."""
        text = self.cells[column]
        try:  # float() also takes 1_000 and digits of other scripts, which other readers do not
            value = float(text) if text.isascii() and "_" not in text else nan
        except ValueError:
            value = nan
        if not isfinite(value):
            found = f"{text[:40]!r}" if text else "blank"
            raise VergenceError(
                f"{self.where}: {column} is {found}, not a finite number such as 0.25."
            )
        return value

    def whole_number(self, column: str, largest: int) -> int | None:
        """Return a cell as a number from 0 to largest, None if blank; VergenceError otherwise."""
        text = self.cells.get(column, "")
        if not text:
            return None
        digits = text.isascii() and text.isdecimal() and len(text) <= 10
        if not digits or int(text) > largest:
            raise VergenceError(
                f"{self.where}: {column} is {text[:40]!r}; expected blank or a whole number from 0 "
                f"to {largest}."
            )
        return int(text)


def column(rows: list[TableRow], name: str) -> Array:
    """Return a column's numbers (N,); VergenceError where a cell is no finite number."""
    return np.array([row.number(name) for row in rows])


def read_table(path: Path) -> tuple[list[str], list[TableRow]]:
    """Read the names of the columns and the rows that are not blank.

    Raises:
        VergenceError: the file is missing, not a table in UTF-8, or has no rows.
        OSError: it cannot be read.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file, strict=True)
            header = [" ".join(name.split()) for name in next(reader, [])]
            if not any(header):
                raise VergenceError(f"{path} is empty; its first line names the columns.")
            if len(header) == 1 and ";" in header[0]:
                raise VergenceError(f"{path} is separated by semicolons; use commas.")
            if repeated := [name for name in header if header.count(name) > 1]:
                raise VergenceError(f"{path}: the column {repeated[0]!r} is repeated.")
            rows = []
            for cells in reader:
                if not any(cell.strip() for cell in cells):
                    continue  # editors leave blank lines at the end
                where = f"{path}, line {reader.line_num}"
                if len(cells) != len(header):
                    raise VergenceError(
                        f"{where}: found {len(cells)} fields for {len(header)} columns."
                    )
                texts = dict(zip(header, map(str.strip, cells), strict=True))
                rows.append(TableRow(where, reader.line_num, texts))
    except FileNotFoundError:
        raise VergenceError(f"There is no {path.name} in {path.parent}.") from None
    except (csv.Error, UnicodeDecodeError) as error:
        raise VergenceError(f"{path} is not a CSV file in UTF-8: {explain(error)}.") from None
    if not rows:
        raise VergenceError(f"{path} has no frames, only a header.")
    return header, rows
