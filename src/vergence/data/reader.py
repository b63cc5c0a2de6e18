"""Reading datasets from disk. The format is described, with an example, in docs/dataset.md.

Whatever is missing, doubtful or impossible is refused with the file, the line and the column.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from vergence.arrays import Array, Transform
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
from vergence.data.table import TableRow, column, read_table
from vergence.errors import VergenceError, explain
from vergence.geometry.kinematics import EYE_JOINTS, EYES, NECK_JOINTS

_DESCRIPTION = TypeAdapter(Description)
_TRANSFORM = TypeAdapter(Transform)
MAX_DELAY_S = 1.0
"""Largest time between an image and its joint reading; more means that the clocks differ."""
MAX_EYE_RAD = 1.2
"""Larger angles of an eye are implausible: probably degrees that were declared as radians."""
MAX_NECK_MOTION_RAD = 0.02
"""Largest apparent motion of the neck among rows of one placement."""


def load_dataset(folder: str | Path) -> Dataset:
    """Read a dataset and check everything except the images, which are read on demand.

    Args:
        folder: with dataset.json, frames.csv and the images; see docs/dataset.md.

    Raises:
        VergenceError: the dataset is incomplete or implausible; the message names the file and
            the field or line.
    """
    folder = Path(folder)
    try:
        if not folder.is_dir():
            raise VergenceError(f"There is no dataset folder {folder}.")
        description = _read_description(folder / DESCRIPTION)
        header, rows = read_table(folder / FRAMES)
        _check_header(folder / FRAMES, header, description)
        return _dataset(folder, description, rows)
    except OSError as error:
        raise VergenceError(f"Cannot read the dataset {folder}: {error.strerror}.") from error


def _read_description(path: Path) -> Description:
    try:
        raw = json.loads(path.read_text(encoding="utf-8-sig"), object_pairs_hook=_unique_keys)
        return _DESCRIPTION.validate_python(raw)
    except FileNotFoundError:
        raise VergenceError(f"There is no {path.name} in {path.parent}.") from None
    except ValidationError as error:
        reason = re.sub(r"^board\.(chessboard|charuco)", "board", explain(error))
        raise VergenceError(f"{path}: {reason}.") from None
    except (ValueError, RecursionError) as error:  # not JSON, not UTF-8, or a repeated key
        raise VergenceError(f"{path} is not valid JSON: {explain(error)}.") from None


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    counts = Counter(name for name, _ in pairs)
    if repeated := [name for name, count in counts.items() if count > 1]:
        raise ValueError(f"the key {repeated[0]!r} is repeated")
    return dict(pairs)


def _check_header(path: Path, header: list[str], description: Description) -> None:
    required = [TIME, JOINT_TIME, PLACEMENT, *description.cameras]
    required += [joint.column for joint in description.joints.values()]
    if description.eye_motion == "poses":
        required += [name for eye in description.eyes for name in pose_columns(eye)]
    for name in required:
        if name not in header:
            raise VergenceError(
                f"{path}: the column {name!r} is missing; found {', '.join(header)}."
            )
    for name in header:
        if name not in (*required, MOVING) and not name.startswith("_"):
            raise VergenceError(
                f"{path}: the column {name!r} is not known; names of additional columns begin with "
                "an underscore."
            )


def _dataset(folder: Path, description: Description, rows: list[TableRow]) -> Dataset:
    poses = description.eye_motion == "poses"
    time_s, joint_time_s = _time_stamps(rows)
    eye_angles, neck_angles = (
        np.stack([_joint_angles(description, name, rows) for name in names], axis=-1)
        for names in (EYE_JOINTS, NECK_JOINTS)
    )
    return Dataset(
        folder=folder,
        description=description,
        lines=np.array([row.line for row in rows]),
        time_s=time_s,
        joint_time_s=joint_time_s,
        eye_angles=np.full_like(eye_angles, np.nan) if poses else eye_angles,
        T_base_eye=_eye_poses(description, rows) if poses else None,
        neck_angles=neck_angles,
        placement=_placements(neck_angles, rows),
        moving=np.array([bool(row.whole_number(MOVING, 1)) for row in rows]),
        files=_image_files(folder, description, rows),
        remarks=() if poses else _remarks(description, eye_angles, rows),
    )


def _time_stamps(rows: list[TableRow]) -> tuple[Array, Array]:
    """Return the time stamps of the images and of the joint readings, (N,) each [s]."""
    time_s, joint_time_s = column(rows, TIME), column(rows, JOINT_TIME)
    for name, steps in ((TIME, np.diff(time_s)), (JOINT_TIME, np.diff(joint_time_s))):
        if (steps <= 0).any():
            k = int((steps <= 0).argmax())
            found = "repeats" if steps[k] == 0 else "is earlier than"
            raise VergenceError(
                f"{rows[k + 1].where}: {name} = {rows[k + 1].cells[name]} {found} that of line "
                f"{rows[k].line}; time stamps increase from row to row."
            )
    delay = np.abs(time_s - joint_time_s)
    if (delay > MAX_DELAY_S).any():
        k = int((delay > MAX_DELAY_S).argmax())
        raise VergenceError(
            f"{rows[k].where}: {TIME} and {JOINT_TIME} lie {delay[k]:.3g} s apart; both come from "
            f"the same clock and differ by at most {MAX_DELAY_S:g} s."
        )
    return time_s, joint_time_s


def _joint_angles(description: Description, name: str, rows: list[TableRow]) -> Array:
    """Return a joint's angles (N,) [rad], sign applied; zeros where it has no column."""
    joint = description.joints.get(name)
    if joint is None:
        return np.zeros(len(rows))
    readings = column(rows, joint.column)
    angles = joint.sign * (np.radians(readings) if joint.unit == "deg" else readings)
    too_large = np.abs(angles) > np.pi
    if too_large.any():
        row = rows[int(too_large.argmax())]
        advice = f'; if it is in degrees, set joints.{name}.unit to "deg"'
        raise VergenceError(
            f"{row.where}: {joint.column} = {row.cells[joint.column]} {joint.unit} is more than "
            f"half a turn{advice if joint.unit == 'rad' else ''}."
        )
    return angles


def _placements(neck_angles: Array, rows: list[TableRow]) -> np.ndarray:
    """Return the placements (N,); rows without one get a number of their own."""
    stated = [row.whole_number(PLACEMENT, 10**9) for row in rows]
    unused = 1 + max((number for number in stated if number is not None), default=-1)
    placements, first = [], dict[int, int]()
    for k, number in enumerate(stated):
        if number is None:
            number, unused = unused, unused + 1
        start = first.setdefault(number, k)
        motion = np.abs(neck_angles[k] - neck_angles[start])
        if (motion > MAX_NECK_MOTION_RAD).any():
            raise VergenceError(
                f"{rows[k].where}: {NECK_JOINTS[int(motion.argmax())]} has moved by "
                f"{motion.max():.3f} rad since line {rows[start].line}, so the board is no longer "
                f"at the same place in the head; give it another {PLACEMENT} than {number}."
            )
        placements.append(number)
    return np.array(placements)


def _eye_poses(description: Description, rows: list[TableRow]) -> Array:
    """Return T_base_eye (N, 2, 4, 4); the identity for an eye without cameras."""
    T = np.tile(np.eye(4), (len(rows), len(EYES), 1, 1))
    for eye in description.eyes:
        columns = pose_columns(eye)
        for k, row in enumerate(rows):
            numbers = np.array([row.number(name) for name in columns])
            try:
                T[k, EYES.index(eye)] = _TRANSFORM.validate_python(numbers.reshape(4, 4))
            except ValidationError as error:
                where = f"{row.where}: {columns[0]} to {columns[-1]}"
                raise VergenceError(f"{where}: {explain(error)}.") from None
    return T


def _image_files(
    folder: Path, description: Description, rows: list[TableRow]
) -> dict[str, tuple[str | None, ...]]:
    """Return the N image files of each camera, after checking that they exist in the folder."""
    root = folder.resolve()
    used: dict[Path, str] = {}
    for row in rows:
        for camera in description.cameras:
            name = row.cells[camera]
            if not name:
                continue
            where = f"{row.where}: {camera}: {name[:80]!r}"
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
            used[path] = f"{camera} in line {row.line}"
    return {
        camera: tuple(row.cells[camera] or None for row in rows) for camera in description.cameras
    }


def _remarks(description: Description, eye_angles: Array, rows: list[TableRow]) -> tuple[str, ...]:
    """Return a sentence for each joint whose angles look like another unit."""
    remarks = []
    for k, name in enumerate(EYE_JOINTS):
        joint = description.joints.get(name)
        if joint is None:
            continue
        largest = int(np.abs(eye_angles[:, k]).argmax())
        reading = rows[largest].cells[joint.column]
        if abs(eye_angles[largest, k]) > MAX_EYE_RAD:
            remarks.append(
                f"{name} reaches {reading} {joint.unit} in line {rows[largest].line}, further than "
                f"eyes turn: is its unit {'deg' if joint.unit == 'rad' else 'right'}?"
            )
        elif joint.unit == "deg" and 0.05 < abs(float(reading)) < MAX_EYE_RAD:
            remarks.append(f"{name} never exceeds {reading} degrees: are these radians?")
    return tuple(remarks)
