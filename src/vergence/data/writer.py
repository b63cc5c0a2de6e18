"""Writing datasets to disk, completely or not at all. docs/dataset.md describes the format."""

from __future__ import annotations

import csv
import os
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path

import cv2
import numpy as np
from pydantic import TypeAdapter

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.data.description import (
    DESCRIPTION,
    FRAMES,
    JOINT_TIME,
    MOVING,
    PLACEMENT,
    TIME,
    Description,
)
from vergence.data.table import Table, joint_angles, measured_eye_poses, placements, time_stamps
from vergence.errors import VergenceError
from vergence.files import check_new, whole_folder
from vergence.geometry.kinematics import EYES
from vergence.geometry.neck import NECK_JOINTS

_Cells = dict[str, object]
"""A row of frames.csv by column, without its images."""
_Line = tuple[int, _Cells]


@dataclass(frozen=True, eq=False)
class DatasetRow:
    """A frame to be written, and what frames.csv says of it besides."""

    frame: Frame
    placement: int | None = None
    """Rows with the same number show the board at the same pose in frame head; None: this row
    has a placement of its own."""
    moving: bool = False
    """Whether the eyes were moving."""
    T_base_eye: Array | None = None
    """(2, 4, 4) poses of the left and right eye, needed if the description has poses."""


def write_dataset(
    folder: Path | str,
    description: Description,
    rows: Iterable[DatasetRow],
    *,
    beside: Callable[[Path], None] = lambda folder: None,
) -> None:
    """Write a dataset into a temporary folder that is renamed when it is complete.

    Images become grey PNG files, a third of the size of colour ones and all that detection uses.
    They are encoded in worker threads while the next rows are being made.

    Args:
        folder: new or empty.
        description: of the cameras, the board and the joints.
        rows: in order of time; an iterator may make them one by one.
        beside: is called with the temporary folder after the last row, to write other files there.

    Raises:
        VergenceError: the folder is not empty, or cannot be written; there are no rows; a row has
            other cameras, sizes of images or readings than the description, or images that are not
            uint8 or uint16; or `load_dataset` would refuse a row.
    """
    folder = Path(folder)
    check_new(folder)
    with whole_folder(folder) as part:
        (part / "images").mkdir()
        adapter = TypeAdapter(Description)
        text = adapter.dump_json(description, indent=1, exclude_none=True) + b"\n"
        (part / DESCRIPTION).write_bytes(text)
        _write_frames(part, description, rows)
        beside(part)


def _write_frames(folder: Path, description: Description, rows: Iterable[DatasetRow]) -> None:
    workers = os.cpu_count() or 1
    pending: deque[Future[None]] = deque()
    with (
        (folder / FRAMES).open("w", encoding="utf-8", newline="") as file,
        ThreadPoolExecutor(workers) as pool,
    ):
        table = csv.DictWriter(file, description.columns, restval="", lineterminator="\n")
        table.writeheader()
        first = before = None
        of_placement: dict[str, _Line] = {}  # the first of each
        for number, row in enumerate(rows):
            if not isinstance(row, DatasetRow):
                raise VergenceError(f"Row {number} is not a DatasetRow; found {row!r:.80}.")
            now = number + 2, _cells(description, row)
            _check_images(description, row.frame)
            first, before = first or now, before or now
            same = of_placement.setdefault(str(row.placement), now)
            # What the reader compares a row with: the first, the one before, and its placement's.
            _check_lines(description, dict(sorted((first, same, before, now), key=itemgetter(0))))
            before = now
            images = {camera: f"images/{number:05d}_{camera}.png" for camera in row.frame.images}
            table.writerow(now[1] | images)
            for camera, image in row.frame.images.items():
                # A copy, since a driver may write its next image into the same array.
                own = np.array(image)
                pending.append(pool.submit(_write_image, folder / images[camera], own))
            while len(pending) > 8 * workers:  # bounds the memory of images that wait
                pending.popleft().result()
        for each in pending:
            each.result()
    if before is None:
        raise VergenceError("A dataset has one row or more; found none.")


def _cells(description: Description, row: DatasetRow) -> _Cells:
    """Return a row's cells by column, without its images."""
    frame = row.frame
    time_s, joint_time_s = _numbers("time stamps", (frame.time_s, frame.joint_time_s)).tolist()
    cells: _Cells = {
        TIME: time_s,
        JOINT_TIME: joint_time_s,
        PLACEMENT: row.placement,
        MOVING: int(row.moving),
    }
    angles: dict[str, float] = {}
    for names, found in (
        (description.head_kinematics.readings, frame.eye_angles),
        (NECK_JOINTS, frame.neck_angles),
    ):
        if np.shape(found) != (len(names),):
            raise VergenceError(
                f"The row at {time_s:g} s needs the readings {', '.join(names)}; found an "
                f"array of shape {np.shape(found)}."
            )
        angles |= dict(zip(names, _numbers("readings", found).tolist(), strict=True))
    for name, joint in description.sources.items():
        if name not in angles:
            continue  # it shares its column with another
        angle = joint.sign * angles[name]
        cells[joint.column] = float(np.degrees(angle) if joint.unit == "deg" else angle)
    if description.eye_motion == "poses":
        if row.T_base_eye is None or np.shape(row.T_base_eye) != (2, 4, 4):
            found = "none" if row.T_base_eye is None else f"shape {np.shape(row.T_base_eye)}"
            raise VergenceError(
                f"The row at {time_s:g} s needs the poses of both eyes, T_base_eye (2, 4, 4);"
                f" found {found}."
            )
        poses = np.asarray(row.T_base_eye)[[EYES.index(eye) for eye in description.eyes]]
        cells |= dict(zip(description.pose_columns, poses.ravel().tolist(), strict=True))
    return cells


def _numbers(what: str, found: object) -> Array:
    """Return numbers as an array; VergenceError: there is something else."""
    try:
        if None in np.asarray(found, object):
            raise TypeError
        return np.array(found, float)
    except (TypeError, ValueError):
        raise VergenceError(f"The {what} of a row are numbers; found {found!r:.80}.") from None


def _check_lines(description: Description, lines: dict[int, _Cells]) -> None:
    """Raise the VergenceError with which the reader would refuse lines of frames.csv."""
    texts = [["" if cell is None else str(cell) for cell in row.values()] for row in lines.values()]
    columns = dict(zip(next(iter(lines.values())), zip(*texts, strict=True), strict=True))
    table = Table(Path(FRAMES), tuple(lines), columns)
    time_stamps(table)
    joint_angles(description, description.head_kinematics.readings, table)
    placements(joint_angles(description, NECK_JOINTS, table), table)
    if description.eye_motion == "poses":
        measured_eye_poses(description, table)


def _check_images(description: Description, frame: Frame) -> None:
    """Raise a VergenceError if images are of another camera, size or type than described."""
    where = f"The row at {frame.time_s:g} s has"
    for name, image in frame.images.items():
        if name not in description.cameras:
            raise VergenceError(
                f"{where} an image of {name!r}; the cameras described are "
                f"{', '.join(description.cameras)}."
            )
        camera, shape = description.cameras[name], np.shape(image)
        if getattr(image, "dtype", None) not in (np.uint8, np.uint16):
            found = getattr(image, "dtype", type(image).__name__)
            raise VergenceError(
                f"{where} an image of {name} of {found}; images are arrays of uint8, or of uint16."
            )
        if shape not in ((camera.height, camera.width), (camera.height, camera.width, 3)):
            raise VergenceError(
                f"{where} an image of {name} of shape {shape}; {camera.width} x {camera.height} "
                f"pixels are described, shape ({camera.height}, {camera.width}, 3)."
            )


def _write_image(path: Path, image: np.ndarray) -> None:
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    # More compression takes ten times as long for a tenth of the size: noise does not compress.
    encoded, data = cv2.imencode(".png", grey, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    assert encoded
    path.write_bytes(data.tobytes())
