"""Read and check the tables of a dataset, frames.csv and joints.csv."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from io import StringIO
from math import nan
from pathlib import Path

import numpy as np

from vergence.arrays import Array
from vergence.data.description import JOINT_TIME, PLACEMENT, STREAM, TIME, Description, pose_columns
from vergence.data.timing import JointStream
from vergence.errors import VergenceError, counted, explain
from vergence.files import MAX_DIGITS, read_bytes
from vergence.findings import Finding
from vergence.geometry.kinematics import EYES
from vergence.geometry.se3 import rigid_poses

NECK_MOVED_RAD = 0.02
"""Turn of a joint of the neck [rad] from which a board is no longer at the same place in the head:
above the noise of encoders."""

MAX_DELAY_S = 1.0
"""Largest time between an image and its joint reading [s]; more means that the clocks differ."""
# float() and int() also accept 1_000 and digits of other scripts.
NUMBER = re.compile(r"[-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]+)?")
WHOLE_NUMBER = re.compile(r"[0-9]{1,10}")
MAX_ROWS = 100_000
"""Most rows: an hour at 30 Hz."""
MAX_COLUMNS = 1000
"""Most columns; poses and 64 cameras need 100."""


@dataclass(frozen=True)
class Table:
    """N rows of a CSV file as text."""

    path: Path
    lines: tuple[int, ...]
    """N line numbers in the file."""
    columns: dict[str, tuple[str, ...]]
    """N cells by column."""

    def where(self, k: int) -> str:
        """Cite the file and line of row k."""
        return f"{self.path}, line {self.lines[k]}"

    def numbers(self, names: list[str]) -> Array:
        """Parse n columns (N, n); VergenceError where a number is not finite."""
        cells = [self.columns[name] for name in names]
        values = np.array([[_number(text) for text in column] for column in cells]).T
        for k, n in np.argwhere(~np.isfinite(values)).tolist():
            found = repr(cells[n][k][:40]) if cells[n][k] else "blank"
            raise VergenceError(
                f"{self.where(k)}: {names[n]} is {found}, not a finite number such as 0.25."
            )
        return values

    def whole_numbers(self, name: str, largest: int) -> np.ndarray:
        """Parse a column (N,) of int from 0 to largest; -1 where a cell is blank."""
        texts = self.columns.get(name, ("",) * len(self.lines))
        for k, text in enumerate(texts):
            if text and not (WHOLE_NUMBER.fullmatch(text) and int(text) <= largest):
                raise VergenceError(
                    f"{self.where(k)}: {name} is {text[:40]!r}; expected blank or a whole number "
                    f"from 0 to {largest}."
                )
        return np.array([int(text or -1) for text in texts])


def _number(text: str) -> float:
    return float(text) if len(text) <= MAX_DIGITS and NUMBER.fullmatch(text) else nan


def read_table(path: Path, known: Sequence[str], optional: Collection[str] = ()) -> Table:
    """Read the rows that are not blank, and check that the columns are the known ones.

    Optional ones may be missing; time stamps then count the rows.
    """
    content = read_bytes(path, 32 * 2**20)  # 100,000 rows of ten columns have 10 MB
    rows: dict[int, list[str]] = {}
    try:
        reader = csv.reader(StringIO(content.decode("utf-8-sig"), newline=""), strict=True)
        header = [" ".join(name.split()) for name in next(reader, []) or [""]]
        for cells in reader:
            stripped = [*map(str.strip, cells)]
            if any(stripped):
                rows[reader.line_num] = stripped
            if len(cells) > MAX_COLUMNS or len(rows) > MAX_ROWS:
                raise ValueError(f"it has more than {MAX_COLUMNS} columns or {MAX_ROWS} rows")
    except (csv.Error, ValueError) as error:  # ValueError: also for text that is not UTF-8
        raise VergenceError(f"{path} is not a CSV file: {explain(error)}.") from None
    name, uses = Counter(header).most_common(1)[0]
    if uses > 1:
        raise VergenceError(f"{path}: the column {name!r} is repeated.")
    for line, cells in rows.items():
        if len(cells) != len(header):
            raise VergenceError(
                f"{path}, line {line}: found {counted(len(cells), 'field')} for "
                f"{counted(len(header), 'column')}."
            )
    for name in known:
        if name not in header and name not in optional:
            raise VergenceError(
                f"{path}: the column {name!r} is missing; found {', '.join(header):.1000}. Columns "
                "are named in the first line and separated by commas."
            )
    for name in header:
        if name not in known and not name.startswith("_"):
            raise VergenceError(
                f"{path}: the column {name!r} is not known; names of additional columns begin with "
                "an underscore."
            )
    if not rows:
        raise VergenceError(f"{path} has no rows, only a header.")
    columns = dict(zip(header, zip(*rows.values(), strict=True), strict=True))
    columns.setdefault(TIME, tuple(map(str, range(len(rows)))))
    columns.setdefault(JOINT_TIME, columns[TIME])
    return Table(path, tuple(rows), columns)


def time_stamps(table: Table) -> tuple[Array, Array]:
    """Parse the time stamps of images and joint readings, (N,) each [s]."""
    names = [TIME, JOINT_TIME]
    times = table.numbers(names)
    # In seconds no time since 1970 is larger, and no recording as long as a hundred days.
    far = (np.abs(times) > 1e11) | (np.abs(times - times[0]) > 1e7)
    for k, n in np.argwhere(far).tolist():
        raise VergenceError(
            f"{table.where(k)}: {names[n]} = {table.columns[names[n]][k]} is no time in seconds of "
            "one recording; convert milliseconds, microseconds or nanoseconds to seconds."
        )
    steps = np.diff(times, axis=0)
    for n, k in np.argwhere(steps.T <= 0).tolist():
        found = "repeats" if steps[k, n] == 0 else "is earlier than"
        raise VergenceError(
            f"{table.where(k + 1)}: {names[n]} = {table.columns[names[n]][k + 1]} {found} that of "
            f"line {table.lines[k]}; time stamps increase from row to row."
        )
    time_s, joint_time_s = times.T
    delay = np.abs(time_s - joint_time_s)
    for k in np.flatnonzero(delay > MAX_DELAY_S).tolist():
        raise VergenceError(
            f"{table.where(k)}: {TIME} and {JOINT_TIME} lie {delay[k]:.3g} s apart; both come from "
            f"the same clock and differ by at most {MAX_DELAY_S:g} s."
        )
    return time_s, joint_time_s


def joint_angles(description: Description, names: tuple[str, ...], table: Table) -> Array:
    """Parse the readings of n joints (N, n) [rad]; zero for a joint without a column."""
    angles, sources = np.zeros((len(table.lines), len(names))), description.sources
    parts = [joint for chain in description.head_kinematics.eyes.values() for joint in chain]
    for n, joint in enumerate(map(sources.get, names)):
        if joint is None:
            continue
        readings = joint.sign * table.numbers([joint.column])[:, 0]
        angles[:, n] = np.radians(readings) if joint.unit == "deg" else readings
        if all(abs(part.readings.get(names[n], 1.0)) == 1 for part in parts):  # without a gear
            angles[:, n] = _within_half_a_turn(description, names[n], angles[:, n], table)
    return angles


def _within_half_a_turn(description: Description, name: str, angles: Array, table: Table) -> Array:
    """Wrap angles (N,) within a turn, such as 359 degrees; VergenceError beyond a turn."""
    joint = description.sources[name]
    beyond = (np.abs(angles) > np.pi) & (np.abs(angles) <= 2 * np.pi)
    wrapped = angles - np.where(beyond, 2 * np.pi * np.sign(angles), 0.0)
    for k in np.flatnonzero(np.abs(wrapped) > np.pi).tolist():
        where = "joints" if name in description.joints else "readings"
        degrees = f'if it is in degrees, set {where}.{name}.unit to "deg"; '
        raise VergenceError(
            f"{table.where(k)}: {joint.column} = {table.columns[joint.column][k]} {joint.unit} is "
            f"more than a turn; {degrees if joint.unit == 'rad' else ''}if it is of a motor before "
            "a gear, give its factor in kinematics."
        )
    return wrapped


def placements(neck: Sequence[str], neck_angles: Array, table: Table) -> np.ndarray:
    """Parse the placements (N,); a row without one gets a number of its own.

    `neck` are the names of the n joints with the angles (N, n) [rad].
    """
    stated = table.whole_numbers(PLACEMENT, 10**9)
    placement = np.where(stated < 0, stated.max() + np.cumsum(stated < 0), stated)
    _, first, group = np.unique(placement, return_index=True, return_inverse=True)
    motion = np.abs(neck_angles - neck_angles[first[group]])
    moved = (motion > NECK_MOVED_RAD).any(axis=1)
    for k in np.flatnonzero(moved).tolist():
        raise VergenceError(
            f"{table.where(k)}: {neck[motion[k].argmax()]} has moved by "
            f"{motion[k].max():.3f} rad since line {table.lines[first[group][k]]}, so the board is "
            "no longer at the same place in the head; give it another "
            f"{PLACEMENT} than {placement[k]}."
        )
    return placement


def read_stream(folder: Path, description: Description) -> JointStream | None:
    """Read the eyes' readings at their own rate, joints.csv, if there are any."""
    path, names = folder / STREAM, description.head_kinematics.readings
    if description.eye_motion != "pan-tilt" or not path.exists():
        return None
    table = read_table(path, [TIME, *(description.sources[name].column for name in names)])
    return JointStream(time_stamps(table)[0], joint_angles(description, names, table))


def measured_eye_poses(description: Description, table: Table) -> tuple[Array, tuple[Finding, ...]]:
    """Parse T_base_eye (N, 2, 4, 4), and note the first that is rounded.

    The identity stands for an eye without cameras.
    """
    T, rounded = np.tile(np.eye(4), (len(table.lines), len(EYES), 1, 1)), ()
    for eye in description.eyes:
        names = pose_columns(eye)
        for k, read in enumerate(table.numbers(names).reshape(-1, 4, 4)):
            where = f"{table.where(k)}: {names[0]} to {names[-1]}"
            T[k, EYES.index(eye)], found = rigid_poses(where, read)
            rounded = rounded or found
    return T, rounded
