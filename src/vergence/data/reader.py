"""Reading datasets from disk, with every doubt put into words.

The format is described, with an example, in docs/dataset.md; `dataset_writer` writes it.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from vergence.arrays import Array
from vergence.data.dataset import (
    DESCRIPTION,
    FRAMES,
    JOINT_TIME,
    MOVING,
    PLACEMENT,
    TIME,
    Dataset,
    Description,
    pose_columns,
)
from vergence.errors import VergenceError
from vergence.geometry.kinematics import EYE_JOINTS, EYES, NECK_JOINTS

_ADAPTER = TypeAdapter(Description)
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_NOT_FINITE = re.compile(r"[+-]?(nan|inf(inity)?)", re.IGNORECASE)
LONGEST_DELAY_S = 1.0
"""Between an image and its joint reading; more is another clock."""
IMPLAUSIBLE_EYE_RAD = 1.2
"""No eye turns this far: small angles in degrees, given as radians, often do."""
STILL_NECK_RAD = 0.02
"""By which the neck may seem to move while the board stays at its place in the head."""
ROTATION_TOLERANCE = 1e-6


def load(folder: Path) -> Dataset:
    """Read a dataset and check all but the pixels, which are read when they are asked for.

    Raises:
        VergenceError: anything that makes the dataset incomplete or doubtful, in one sentence
            with the file and the field or line.
    """
    folder = Path(folder)
    try:
        if not folder.is_dir():
            raise VergenceError(f"There is no dataset folder {folder}.")
        description = _description(folder / DESCRIPTION)
        header, rows = _table(folder / FRAMES)
        return _dataset(folder, description, header, rows)
    except OSError as error:
        raise VergenceError(f"Cannot read the dataset {folder}: {error.strerror}.") from error


def _description(path: Path) -> Description:
    try:
        raw = json.loads(path.read_text(encoding="utf-8-sig"), object_pairs_hook=_no_repeats)
        return _ADAPTER.validate_python(raw)
    except FileNotFoundError:
        raise VergenceError(f"There is no {path.name} in {path.parent}.") from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(
            str(part) for part in first["loc"] if part not in ("chessboard", "charuco")
        )
        reason = first["msg"].removeprefix("Value error, ")
        raise VergenceError(_sentence(f"{path}: {where + ': ' if where else ''}{reason}")) from None
    except (ValueError, RecursionError) as error:  # not JSON, not UTF-8, or a key twice
        raise VergenceError(_sentence(f"{path} is not valid JSON: {error}")) from None


def _sentence(text: str) -> str:
    return " ".join(text.split()).rstrip(".") + "."


def _no_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"{twice!r} stands there twice")
    return found


@dataclass(frozen=True)
class _Row:
    where: str
    line: int
    cells: Mapping[str, str]

    def number(self, column: str) -> float:
        text = self.cells[column]
        if _NOT_FINITE.fullmatch(text):
            raise VergenceError(f"{self.where}: {column} is {text}; every number is finite.")
        if not _NUMBER.fullmatch(text) or not np.isfinite(float(text)):
            found = "blank" if not text else f"{text[:40]!r}"
            raise VergenceError(f"{self.where}: {column} is {found}, not a number such as 0.25.")
        return float(text)

    def whole_number(self, column: str, most: int) -> int | None:
        text = self.cells.get(column, "")
        if not text:
            return None
        if not re.fullmatch(r"\d{1,10}", text, re.ASCII) or int(text) > most:
            raise VergenceError(
                f"{self.where}: {column} is {text[:40]!r}; it is blank or a whole number from 0 "
                f"to {most}."
            )
        return int(text)


def _table(path: Path) -> tuple[list[str], list[_Row]]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file, strict=True)
            header = [" ".join(name.split()) for name in next(reader, [])]
            if not any(header):
                raise VergenceError(f"{path} is empty; its first line names the columns.")
            if len(header) == 1 and ";" in header[0]:
                raise VergenceError(f"{path} is separated by semicolons; use commas.")
            twice = [name for name in header if header.count(name) > 1]
            if twice:
                raise VergenceError(f"{path}: the column {twice[0]!r} stands there twice.")
            rows = []
            for cells in reader:
                if not any(cell.strip() for cell in cells):
                    continue  # editors leave blank lines at the end
                where = f"{path}, line {reader.line_num}"
                if len(cells) != len(header):
                    raise VergenceError(
                        f"{where}: found {len(cells)} fields for {len(header)} columns."
                    )
                stripped = (cell.strip() for cell in cells)
                rows.append(_Row(where, reader.line_num, dict(zip(header, stripped, strict=True))))
    except FileNotFoundError:
        raise VergenceError(f"There is no {path.name} in {path.parent}.") from None
    except (csv.Error, UnicodeDecodeError) as error:
        raise VergenceError(_sentence(f"{path} is not a CSV file in UTF-8: {error}")) from None
    if not rows:
        raise VergenceError(f"{path} has no frames, only a header.")
    return header, rows


def _dataset(
    folder: Path, description: Description, header: list[str], rows: list[_Row]
) -> Dataset:
    path = folder / FRAMES
    poses = description.eye_motion == "poses"
    wanted = [TIME, JOINT_TIME, PLACEMENT, *description.cameras]
    wanted += [joint.column for joint in description.joints.values()]
    wanted += [name for eye in description.eyes for name in pose_columns(eye)] if poses else []
    for name in wanted:
        if name not in header:
            raise VergenceError(
                f"{path}: the column {name!r} is missing; found {', '.join(header)}."
            )
    for name in header:
        if name not in (*wanted, MOVING) and not name.startswith("_"):
            raise VergenceError(
                f"{path}: the column {name!r} is not known; begin its name with an underscore if "
                "it is your own."
            )
    times = {name: np.array([row.number(name) for row in rows]) for name in (TIME, JOINT_TIME)}
    for name, stamps in times.items():
        _check_rising(name, stamps, rows)
    apart = np.abs(times[TIME] - times[JOINT_TIME])
    if (apart > LONGEST_DELAY_S).any():
        row = rows[int(np.argmax(apart > LONGEST_DELAY_S))]
        raise VergenceError(
            f"{row.where}: {TIME} and {JOINT_TIME} lie {apart.max():.3g} s apart; both are of the "
            f"same clock, and at most {LONGEST_DELAY_S:g} s apart."
        )
    angles = {name: _angles(description, name, rows) for name in (*EYE_JOINTS, *NECK_JOINTS)}
    eye_angles = np.stack([angles[name] for name in EYE_JOINTS], axis=-1)
    neck_angles = np.stack([angles[name] for name in NECK_JOINTS], axis=-1)
    numbers = [row.whole_number(PLACEMENT, 10**9) for row in rows]
    _check_neck(neck_angles, numbers, rows)
    return Dataset(
        folder=folder,
        description=description,
        lines=np.array([row.line for row in rows]),
        time_s=times[TIME],
        joint_time_s=times[JOINT_TIME],
        eye_angles=np.full_like(eye_angles, np.nan) if poses else eye_angles,
        T_base_eye=_poses(description, rows) if poses else None,
        neck_angles=neck_angles,
        placement=_placements(numbers),
        moving=np.array([bool(row.whole_number(MOVING, 1)) for row in rows]),
        files=_files(folder, description, rows),
        remarks=() if poses else _remarks(description, eye_angles, rows),
    )


def _check_rising(name: str, stamps: Array, rows: list[_Row]) -> None:
    late = np.flatnonzero(np.diff(stamps) <= 0)
    if len(late):
        row, before = rows[late[0] + 1], rows[late[0]]
        found = "repeats" if stamps[late[0] + 1] == stamps[late[0]] else "is earlier than"
        raise VergenceError(
            f"{row.where}: {name} = {row.cells[name]} {found} that of line {before.line}; rows are "
            "in order of time, each with its own time stamps."
        )


def _angles(description: Description, name: str, rows: list[_Row]) -> Array:
    """Return a joint's angles (N,) [rad] in this project's sense; zeros where it is not given."""
    joint = description.joints.get(name)
    if joint is None:
        return np.zeros(len(rows))
    read = np.array([row.number(joint.column) for row in rows])
    angles = joint.sign * (np.radians(read) if joint.unit == "deg" else read)
    far = np.abs(angles) > np.pi
    if far.any():
        row = rows[int(far.argmax())]
        advice = f'; if it is in degrees, set joints.{name}.unit to "deg"'
        raise VergenceError(
            f"{row.where}: {joint.column} = {row.cells[joint.column]} {joint.unit} is more than "
            f"half a turn{advice if joint.unit == 'rad' else ''}."
        )
    return angles


def _check_neck(neck_angles: Array, numbers: list[int | None], rows: list[_Row]) -> None:
    first: dict[int, int] = {}
    for k, number in enumerate(numbers):
        if number is None:
            continue
        start = first.setdefault(number, k)
        moved = np.abs(neck_angles[k] - neck_angles[start])
        if (moved > STILL_NECK_RAD).any():
            raise VergenceError(
                f"{rows[k].where}: {NECK_JOINTS[int(moved.argmax())]} has moved by "
                f"{moved.max():.3f} rad since line {rows[start].line}, so the board is no longer "
                f"at the same place in the head; give it another {PLACEMENT} than {number}."
            )


def _placements(numbers: list[int | None]) -> np.ndarray:
    """Return (N,) numbers; rows whose place is not known get one of their own."""
    free = 1 + max((number for number in numbers if number is not None), default=-1)
    blank = np.array([number is None for number in numbers])
    own = free + np.cumsum(blank) - 1
    return np.where(blank, own, np.array([number or 0 for number in numbers]))


def _poses(description: Description, rows: list[_Row]) -> Array:
    T = np.tile(np.eye(4), (len(rows), len(EYES), 1, 1))
    for eye in description.eyes:
        columns = pose_columns(eye)
        for k, row in enumerate(rows):
            found = np.array([row.number(name) for name in columns]).reshape(4, 4)
            R = found[:3, :3]
            skewed = np.abs(R @ R.T - np.eye(3)).max() > ROTATION_TOLERANCE or np.linalg.det(R) < 0
            if skewed or (found[3] != [0, 0, 0, 1]).any():
                raise VergenceError(
                    f"{row.where}: {columns[0]} to {columns[-1]} are not a rigid transform: a "
                    f"rotation to {ROTATION_TOLERANCE:g}, a translation, and 0 0 0 1."
                )
            T[k, EYES.index(eye)] = found
    return T


def _files(
    folder: Path, description: Description, rows: list[_Row]
) -> dict[str, tuple[str | None, ...]]:
    inside = folder.resolve()
    used: dict[Path, str] = {}
    files: dict[str, list[str | None]] = {name: [] for name in description.cameras}
    for row in rows:
        for camera, found in files.items():
            name = row.cells[camera]
            found.append(name or None)
            if not name:
                continue
            here = f"{row.where}: {camera}: {name[:80]!r}"
            try:
                path = (inside / name).resolve()
                is_file = path.is_file()
            except (OSError, ValueError, RuntimeError):  # too long, a zero byte, a loop of links
                raise VergenceError(f"{here} is not a possible file name.") from None
            if not path.is_relative_to(inside):
                raise VergenceError(f"{here} leads out of the dataset's folder.")
            if not is_file:
                raise VergenceError(f"{here}: there is no such file.")
            if path in used:
                raise VergenceError(f"{here} is also the image of {used[path]}.")
            used[path] = f"{camera} in line {row.line}"
    return {camera: tuple(found) for camera, found in files.items()}


def _remarks(description: Description, eye_angles: Array, rows: list[_Row]) -> tuple[str, ...]:
    remarks = []
    for k, name in enumerate(EYE_JOINTS):
        joint = description.joints.get(name)
        if joint is None:
            continue
        largest = int(np.abs(eye_angles[:, k]).argmax())
        value = rows[largest].cells[joint.column]
        if abs(eye_angles[largest, k]) > IMPLAUSIBLE_EYE_RAD:
            remarks.append(
                f"{name} reaches {value} {joint.unit} in line {rows[largest].line}, further than "
                f"eyes turn: is its unit {'deg' if joint.unit == 'rad' else 'right'}?"
            )
        elif joint.unit == "deg" and 0.05 < abs(float(value)) < IMPLAUSIBLE_EYE_RAD:
            remarks.append(f"{name} never exceeds {value} degrees: are these radians?")
    return tuple(remarks)
