"""The table of a dataset, frames.csv: its rows as text, and the numbers that they stand for.

Rows that were read and rows that are to be written are checked alike.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from dataclasses import dataclass
from io import StringIO
from math import nan
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter, ValidationError

from vergence.arrays import Array, Transform
from vergence.data.description import (
    JOINT_TIME,
    MOVING,
    PLACEMENT,
    TIME,
    Description,
    pose_columns,
)
from vergence.errors import VergenceError, counted, explain
from vergence.files import MAX_DIGITS, read_bytes
from vergence.geometry.kinematics import EYES
from vergence.geometry.neck import NECK_JOINTS

MAX_DELAY_S = 1.0
"""Largest time between an image and its joint reading; more means that the clocks differ."""
MAX_TIME_S = 1e11
"""Later than any time since 1970 in seconds."""
MAX_SPAN_S = 1e7
"""A recording does not take a hundred days."""
MAX_NECK_MOTION_RAD = 0.02
"""Largest apparent motion of the neck among rows of one placement."""
# float() and int() also take 1_000 and digits of other scripts, which other readers do not.
NUMBER = re.compile(r"[-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][-+]?[0-9]+)?")
WHOLE_NUMBER = re.compile(r"[0-9]{1,10}")

MAX_TABLE_BYTES = 32 * 2**20
MAX_ROWS = 100_000
MAX_COLUMNS = 1000
MAX_CELL = 4096
"""Characters of a cell, which may be the name of a file."""


@dataclass(frozen=True)
class Table:
    """N rows of frames.csv as text, which are read or are to be written."""

    path: Path
    lines: tuple[int, ...]
    """N line numbers in the file."""
    columns: dict[str, tuple[str, ...]]
    """N cells by the column's name."""

    def where(self, k: int) -> str:
        """Return the file and line of row k, as messages cite it."""
        return f"{self.path}, line {self.lines[k]}"

    def numbers(self, names: list[str]) -> Array:
        """Return the numbers (N, n) of n columns; VergenceError where one is not finite."""
        cells = [self.columns[name] for name in names]
        values = [[_number(text) for text in column] for column in cells]
        values = np.array(values).T
        for k, n in np.argwhere(~np.isfinite(values)).tolist():
            found = repr(cells[n][k][:40]) if cells[n][k] else "blank"
            raise VergenceError(
                f"{self.where(k)}: {names[n]} is {found}, not a finite number such as 0.25."
            )
        return values

    def whole_numbers(self, name: str, largest: int) -> np.ndarray:
        """Return a column's numbers (N,) of int, from 0 to largest; -1 where a cell is blank."""
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


def read_table(path: Path) -> Table:
    """Read the rows that are not blank; editors leave blank lines at the end."""
    content = read_bytes(path, MAX_TABLE_BYTES)
    rows: dict[int, list[str]] = {}
    try:
        reader = csv.reader(StringIO(content.decode("utf-8-sig"), newline=""), strict=True)
        header = [" ".join(name.split()) for name in next(reader, [])]
        for cells in reader:
            if any(len(cell) > MAX_CELL for cell in cells):
                raise ValueError(f"line {reader.line_num} has a cell of over {MAX_CELL} characters")
            stripped = [*map(str.strip, cells)]
            if any(stripped):
                rows[reader.line_num] = stripped
            if len(cells) > MAX_COLUMNS or len(rows) > MAX_ROWS or len(header) > MAX_COLUMNS:
                raise ValueError(f"it has more than {MAX_COLUMNS} columns or {MAX_ROWS} rows")
    except (csv.Error, ValueError) as error:  # ValueError: not UTF-8 too
        raise VergenceError(f"{path} is not a CSV file of frames: {explain(error)}.") from None
    if not any(header):
        raise VergenceError(f"{path} is empty; its first line names the columns.")
    if len(header) == 1 and ";" in header[0]:
        raise VergenceError(f"{path} is separated by semicolons; use commas.")
    if len(set(header)) < len(header):
        name, _ = Counter(header).most_common(1)[0]
        raise VergenceError(f"{path}: the column {name!r} is repeated.")
    for line, cells in rows.items():
        if len(cells) != len(header):
            raise VergenceError(
                f"{path}, line {line}: found {counted(len(cells), 'field')} for "
                f"{counted(len(header), 'column')}."
            )
    if not rows:
        raise VergenceError(f"{path} has no frames, only a header.")
    columns = zip(*rows.values(), strict=True)
    return Table(path, tuple(rows), dict(zip(header, columns, strict=True)))


def check_columns(table: Table, description: Description) -> None:
    """Raise a VergenceError where a column is missing, or is not known."""
    known, found = description.columns, table.columns
    for name in known:
        if name not in found and name != MOVING:
            raise VergenceError(
                f"{table.path}: the column {name!r} is missing; found {', '.join(found)}."
            )
    for name in found:
        if name not in known and not name.startswith("_"):
            raise VergenceError(
                f"{table.path}: the column {name!r} is not known; names of additional columns "
                "begin with an underscore."
            )


def time_stamps(table: Table) -> tuple[Array, Array]:
    """Return the time stamps of the images and of the joint readings, (N,) each [s]."""
    names = [TIME, JOINT_TIME]
    times = table.numbers(names)
    for k, n in np.argwhere(np.abs(times) > MAX_TIME_S).tolist()[:1]:
        raise VergenceError(
            f"{table.where(k)}: {names[n]} = {table.columns[names[n]][k]} is no time in seconds; "
            f"if it is in {_unit(float(times[k, n]))}, convert it."
        )
    span = np.ptp(times[:, 0])
    if span > MAX_SPAN_S:
        raise VergenceError(
            f"{table.path}: {names[0]} spans {span:.3g} s, {span / 86400:.0f} days; convert time "
            "stamps in nanoseconds or microseconds to seconds."
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


def _unit(stamp: float) -> str:
    """Return the unit in which a time since 1970 would be about this large."""
    digits = np.log10(abs(stamp)) - 9.25  # of seconds, in these decades
    units = ("milliseconds", "microseconds", "nanoseconds")
    return units[int(np.clip(round(digits / 3), 1, 3)) - 1]


def joint_angles(description: Description, names: tuple[str, ...], table: Table) -> Array:
    """Return joint angles (N, n) [rad], signs applied; zeros for a joint without a column."""
    angles, sources = np.zeros((len(table.lines), len(names))), description.sources
    for n, name in enumerate(names):
        joint = sources.get(name)
        if joint is None:
            continue
        readings = joint.sign * table.numbers([joint.column])[:, 0]
        turned = np.radians(readings) if joint.unit == "deg" else readings
        if not is_angle(description, name):
            angles[:, n] = turned
            continue
        beyond = (np.abs(turned) > np.pi) & (np.abs(turned) <= 2 * np.pi)  # 359 degrees are -1
        angles[:, n] = turned - np.where(beyond, 2 * np.pi * np.sign(turned), 0.0)
        for k in np.flatnonzero(np.abs(angles[:, n]) > np.pi).tolist():
            where = "joints" if name in description.joints else "readings"
            advice = []
            if joint.unit == "rad":
                advice.append(f'if it is in degrees, set {where}.{name}.unit to "deg"')
            if where == "readings":
                advice.append("if it is of a motor before a gear, give its factor in kinematics")
            raise VergenceError(
                f"{table.where(k)}: {joint.column} = {table.columns[joint.column][k]} {joint.unit} "
                f"{'; '.join(['is more than a turn', *advice])}."
            )
    return angles


def is_angle(description: Description, name: str) -> bool:
    """Return whether a reading is the angle of joints, or adds to it: a turn more is then the same.

    Not of one with another factor, as of a motor before a gear.
    """
    joints = [joint for own in description.head_kinematics.eyes.values() for joint in own]
    return all(abs(joint.readings.get(name, 1.0)) == 1 for joint in joints)


def placements(neck_angles: Array, table: Table) -> np.ndarray:
    """Return the placements (N,); rows without one get a number of their own."""
    stated = table.whole_numbers(PLACEMENT, 10**9)
    placement = np.where(stated < 0, stated.max() + np.cumsum(stated < 0), stated)
    _, first, group = np.unique(placement, return_index=True, return_inverse=True)
    motion = np.abs(neck_angles - neck_angles[first[group]])
    for k in np.flatnonzero((motion > MAX_NECK_MOTION_RAD).any(axis=1)).tolist():
        raise VergenceError(
            f"{table.where(k)}: {NECK_JOINTS[motion[k].argmax()]} has moved by "
            f"{motion[k].max():.3f} rad since line {table.lines[first[group][k]]}, so the board is "
            "no longer at the same place in the head; give it another "
            f"{PLACEMENT} than {placement[k]}."
        )
    return placement


def measured_eye_poses(description: Description, table: Table) -> Array:
    """Return T_base_eye (N, 2, 4, 4); the identity for an eye without cameras."""
    adapter = TypeAdapter(Transform)
    T = np.tile(np.eye(4), (len(table.lines), len(EYES), 1, 1))
    for eye in description.eyes:
        names = pose_columns(eye)
        for k, pose in enumerate(table.numbers(names).reshape(-1, 4, 4)):
            try:
                T[k, EYES.index(eye)] = adapter.validate_python(pose)
            except ValidationError as error:
                where = f"{table.where(k)}: {names[0]} to {names[-1]}"
                raise VergenceError(f"{where}: {explain(error)}.") from None
    return T
