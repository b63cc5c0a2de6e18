"""Reading datasets from disk. The format is described, with an example, in docs/dataset.md.

Whatever is missing, doubtful or impossible is refused with the file, the line and the column.
"""

from __future__ import annotations

import csv
import os
import re
from collections import Counter
from dataclasses import dataclass
from io import StringIO
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from vergence.arrays import Array, Transform
from vergence.data.dataset import Dataset
from vergence.data.description import (
    DESCRIPTION,
    FRAMES,
    JOINT_TIME,
    MOVING,
    PLACEMENT,
    TIME,
    Description,
    pose_columns,
)
from vergence.errors import VergenceError, counted, explain
from vergence.geometry.kinematics import EYES
from vergence.geometry.neck import NECK_JOINTS
from vergence.reading import MAX_DIGITS, parse_json, read_bytes, read_parsed

MAX_DELAY_S = 1.0
"""Largest time between an image and its joint reading; more means that the clocks differ."""
MAX_TIME_S = 1e11
"""Later than any time since 1970 in seconds."""
MAX_SPAN_S = 1e7
"""A recording does not take a hundred days."""
MAX_EYE_RAD = 1.2
"""Larger angles of an eye are implausible: probably degrees that were declared as radians."""
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
MAX_DESCRIPTION_BYTES = 2**20


def load_dataset(folder: str | Path) -> Dataset:
    """Read a dataset and check everything except the images, which are read on demand.

    Raises:
        VergenceError: the dataset is incomplete or implausible; the message names the file and
            the field or line.
    """
    folder = Path(folder)
    if os.path.isfile(folder):
        raise VergenceError(
            f"{folder} is a file; a dataset is a folder with {DESCRIPTION} and {FRAMES}."
        )
    # Those of os.path: methods of Path raise where a name is too long, or may not be looked up.
    if not os.path.isdir(folder):
        raise VergenceError(f"There is no dataset folder {folder}.")
    for name in (DESCRIPTION, FRAMES):
        if not os.path.exists(folder / name):
            raise VergenceError(f"There is no {name} in the folder {str(folder)!r}.")
    description = read_parsed(
        folder / DESCRIPTION,
        "a description of a dataset",
        _description,
        parse_json,
        most_bytes=MAX_DESCRIPTION_BYTES,
    )
    table = _read_table(folder / FRAMES)
    _check_columns(table, description)
    poses = description.eye_motion == "poses"
    time_s, joint_time_s = time_stamps(table)
    eye_angles = joint_angles(description, description.head_kinematics.readings, table)
    neck_angles = joint_angles(description, NECK_JOINTS, table)
    return Dataset(
        folder=folder,
        description=description,
        lines=np.array(table.lines),
        time_s=time_s,
        joint_time_s=joint_time_s,
        eye_angles=np.full_like(eye_angles, np.nan) if poses else eye_angles,
        T_base_eye=eye_poses(description, table) if poses else None,
        neck_angles=neck_angles,
        placement=placements(neck_angles, table),
        moving=table.whole_numbers(MOVING, 1) == 1,
        files=_image_files(folder, description, table),
        remarks=() if poses else _remarks(description, eye_angles, table),
    )


def _description(content: Any) -> Description:
    try:
        return TypeAdapter(Description).validate_python(content)
    except ValidationError as error:
        reason = re.sub(r"^board\.(chessboard|charuco)", "board", explain(error))
        raise ValueError(reason) from None


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


def _read_table(path: Path) -> Table:
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


def _check_columns(table: Table, description: Description) -> None:
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
        if not _is_angle(description, name):
            angles[:, n] = turned
            continue
        beyond = (np.abs(turned) > np.pi) & (np.abs(turned) <= 2 * np.pi)  # 359 degrees are -1
        angles[:, n] = turned - np.where(beyond, 2 * np.pi * np.sign(turned), 0.0)
        for k in np.flatnonzero(np.abs(angles[:, n]) > np.pi).tolist():
            where = "joints" if name in description.joints else "readings"
            advice = f'; if it is in degrees, set {where}.{name}.unit to "deg"'
            raise VergenceError(
                f"{table.where(k)}: {joint.column} = {table.columns[joint.column][k]} {joint.unit} "
                f"is more than a turn{advice if joint.unit == 'rad' else ''}."
            )
    return angles


def _is_angle(description: Description, name: str) -> bool:
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


def eye_poses(description: Description, table: Table) -> Array:
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


def _image_files(
    folder: Path, description: Description, table: Table
) -> dict[str, tuple[str | None, ...]]:
    """Return the N image files of each camera, after checking that they exist in the folder."""
    root = folder.resolve()
    used: dict[Path, str] = {}
    for k, line in enumerate(table.lines):
        for camera in description.cameras:
            name = table.columns[camera][k]
            if not name:
                continue
            where = f"{table.where(k)}: {camera}: {name[:80]!r}"
            try:
                path = (root / name).resolve()
                is_file = path.is_file()
            except (OSError, ValueError, RuntimeError):  # too long, a zero byte, a loop of links
                raise VergenceError(f"{where} is not a possible file name.") from None
            if not path.is_relative_to(root):
                raise VergenceError(f"{where} leads out of the dataset's folder.")
            if not is_file:
                raise VergenceError(f"{where}: there is no such file.")
            if path in used:
                raise VergenceError(f"{where} is also the image of {used[path]}.")
            used[path] = f"{camera} in line {line}"
    return {
        camera: tuple(name or None for name in table.columns[camera])
        for camera in description.cameras
    }


def _remarks(description: Description, eye_angles: Array, table: Table) -> tuple[str, ...]:
    """Return a sentence for each joint whose angles (N, r) look like another unit."""
    remarks, sources = [], description.sources
    for n, name in enumerate(description.head_kinematics.readings):
        joint = sources.get(name)
        if joint is None or not _is_angle(description, name):
            continue
        k = np.abs(eye_angles[:, n]).argmax()
        reading = table.columns[joint.column][k]
        if abs(eye_angles[k, n]) > MAX_EYE_RAD:
            remarks.append(
                f"{name} reaches {reading} {joint.unit} in line {table.lines[k]}, further than "
                f"eyes turn: is its unit {'deg' if joint.unit == 'rad' else 'right'}?"
            )
        elif joint.unit == "deg" and 0.05 < abs(float(reading)) < MAX_EYE_RAD:
            remarks.append(f"{name} never exceeds {reading} degrees: are these radians?")
    return tuple(remarks)
