"""Writing datasets to disk, completely or not at all. docs/dataset.md describes the format."""

from __future__ import annotations

import csv
import os
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
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
from vergence.errors import VergenceError
from vergence.geometry.kinematics import EYES
from vergence.geometry.neck import NECK_JOINTS
from vergence.writing import check_new, whole_folder


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
        VergenceError: the folder is not empty, or cannot be written; or a row has other cameras,
            sizes of images or readings than the description, numbers that are not finite, or time
            stamps that do not increase.
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
        before: Frame | None = None
        for number, row in enumerate(rows):
            _check_times(row.frame, before)
            _check_images(description, row.frame)
            before = row.frame
            images = {camera: f"images/{number:05d}_{camera}.png" for camera in row.frame.images}
            table.writerow(_cells(description, row) | images)
            for camera, image in row.frame.images.items():
                pending.append(pool.submit(_write_image, folder / images[camera], image))
            while len(pending) > 8 * workers:  # bounds the memory of images that wait
                pending.popleft().result()
        for each in pending:
            each.result()


def _cells(description: Description, row: DatasetRow) -> dict[str, object]:
    """Return a row's cells by column, without its images."""
    frame = row.frame
    cells: dict[str, object] = {
        TIME: float(frame.time_s),
        JOINT_TIME: float(frame.joint_time_s),
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
                f"The row at {frame.time_s:g} s needs the readings {', '.join(names)}; found an "
                f"array of shape {np.shape(found)}."
            )
        angles |= dict(zip(names, found, strict=True))
    for name, joint in description.sources.items():
        if name not in angles:
            continue  # it shares its column with another
        angle = joint.sign * angles[name]
        cells[joint.column] = float(np.degrees(angle) if joint.unit == "deg" else angle)
    if description.eye_motion == "poses":
        if row.T_base_eye is None or row.T_base_eye.shape != (2, 4, 4):
            found = "none" if row.T_base_eye is None else f"shape {row.T_base_eye.shape}"
            raise VergenceError(
                f"The row at {frame.time_s:g} s needs the poses of both eyes, T_base_eye (2, 4, 4);"
                f" found {found}."
            )
        poses = row.T_base_eye[[EYES.index(eye) for eye in description.eyes]]
        cells |= dict(zip(description.pose_columns, poses.ravel().tolist(), strict=True))
    for column, value in cells.items():
        if isinstance(value, float) and not np.isfinite(value):
            raise VergenceError(
                f"The row at {frame.time_s:g} s needs finite numbers; {column} is {value}."
            )
    return cells


def _check_times(frame: Frame, before: Frame | None) -> None:
    """Raise a VergenceError if time stamps do not increase."""
    if before is None:
        return
    for name, now, then in (
        (TIME, frame.time_s, before.time_s),
        (JOINT_TIME, frame.joint_time_s, before.joint_time_s),
    ):
        if now <= then:
            raise VergenceError(
                f"Time stamps increase from row to row; {name} = {now:g} s follows {then:g} s."
            )


def _check_images(description: Description, frame: Frame) -> None:
    """Raise a VergenceError if images are of another camera or size than described."""
    where = f"The row at {frame.time_s:g} s has"
    for name, image in frame.images.items():
        if name not in description.cameras:
            raise VergenceError(
                f"{where} an image of {name!r}; the cameras described are "
                f"{', '.join(description.cameras)}."
            )
        camera, shape = description.cameras[name], np.shape(image)
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
