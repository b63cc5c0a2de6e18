"""Write complete datasets; docs/dataset.md describes the format."""

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
from vergence.data.reader import load_dataset
from vergence.errors import VergenceError
from vergence.files import whole_folder
from vergence.geometry.kinematics import EYES


@dataclass(frozen=True, eq=False)
class DatasetRow:
    """A frame to be written, with the other columns of its row in frames.csv."""

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

    Images become grey PNG files: detection uses no colour, and they have a third of the size.
    Threads encode them, so that an iterator of rows, in order of time, can go on. `beside` writes
    other files into the temporary folder after the last row.

    Raises VergenceError if the folder is not empty or cannot be written, there are no rows, or
    `load_dataset` would refuse one.
    """
    with whole_folder(Path(folder)) as part:
        (part / "images").mkdir()
        (part / DESCRIPTION).write_text(as_text(description), encoding="utf-8")
        _write_frames(part, description, rows)
        beside(part)
        try:
            load_dataset(part)
        except VergenceError as error:
            raise VergenceError(str(error).replace(str(part), str(folder))) from None


def as_text(description: Description) -> str:
    """Write a description as dataset.json has it."""
    adapter = TypeAdapter(Description)
    return adapter.dump_json(description, indent=1, exclude_none=True).decode() + "\n"


def _write_frames(folder: Path, description: Description, rows: Iterable[DatasetRow]) -> None:
    workers = os.cpu_count() or 1
    pending: deque[Future[None]] = deque()
    number = -1
    with (
        (folder / FRAMES).open("w", encoding="utf-8", newline="") as file,
        ThreadPoolExecutor(workers) as pool,
    ):
        table = csv.DictWriter(file, description.columns, restval="", lineterminator="\n")
        table.writeheader()
        for number, row in enumerate(rows):
            cells, images = row_cells(description, number, row)
            table.writerow(cells)
            for camera, image in row.frame.images.items():
                # A copy, since a driver may write its next image into the same array.
                copied = np.array(image)
                pending.append(pool.submit(_write_image, folder / images[camera], copied))
            while len(pending) > 8 * workers:  # bounds the memory of images that wait
                pending.popleft().result()
        for each in pending:
            each.result()
    if number < 0:
        raise VergenceError("A dataset has one row or more; found none.")


def row_cells(
    description: Description, number: int, row: DatasetRow
) -> tuple[dict[str, object], dict[str, str]]:
    """Make the cells of a row by column, and the names of its images by camera.

    VergenceError if it does not fit the description.
    """
    check_images(description, row.frame)
    images = {camera: f"images/{number:05d}_{camera}.png" for camera in row.frame.images}
    return _cells(description, row) | images, images


def _cells(description: Description, row: DatasetRow) -> dict[str, object]:
    """Make a row's cells by column, without its images."""
    frame = row.frame
    cells: dict[str, object] = {
        TIME: frame.time_s,
        JOINT_TIME: frame.joint_time_s,
        PLACEMENT: row.placement,
        MOVING: int(row.moving),
    }
    names = *description.head_kinematics.readings, *description.neck_joints
    neck = frame.neck_angles if description.neck_joints else ()
    try:
        readings = np.concatenate([frame.eye_angles, neck], dtype=float)
    except (TypeError, ValueError):
        readings = np.zeros(0)
    if readings.shape != (len(names),):
        raise VergenceError(
            f"The row at {frame.time_s} s needs numbers of the readings {', '.join(names)}; found "
            f"{frame.eye_angles!r:.80} and {frame.neck_angles!r:.80}."
        )
    angles = dict(zip(names, readings.tolist(), strict=True))
    for name, joint in description.sources.items():
        if name in angles:  # otherwise another joint has this column
            angle = joint.sign * angles[name]
            cells[joint.column] = float(np.degrees(angle)) if joint.unit == "deg" else angle
    if description.eye_motion == "poses":
        if row.T_base_eye is None or np.shape(row.T_base_eye) != (2, 4, 4):
            raise VergenceError(
                f"The row at {frame.time_s} s needs the poses of both eyes, T_base_eye (2, 4, 4); "
                f"found {row.T_base_eye!r:.80}."
            )
        poses = np.asarray(row.T_base_eye)[[EYES.index(eye) for eye in description.eyes]]
        cells |= dict(zip(description.pose_columns, poses.ravel().tolist(), strict=True))
    return cells


def check_images(description: Description, frame: Frame) -> None:
    """Raise VergenceError for images of another camera, size or type than described."""
    for name, image in frame.images.items():
        where = f"The row at {frame.time_s} s has an image of"
        if name not in description.cameras:
            raise VergenceError(
                f"{where} {name!r}; the cameras described are {', '.join(description.cameras)}."
            )
        size = description.cameras[name].height, description.cameras[name].width
        dtype = getattr(image, "dtype", type(image).__name__)
        if dtype not in (np.uint8, np.uint16) or image.shape not in (size, (*size, 3)):
            raise VergenceError(
                f"{where} {name} of shape {np.shape(image)} and {dtype}; images are arrays of "
                f"uint8 or uint16, here of shape {(*size, 3)}."
            )


def _write_image(path: Path, image: np.ndarray) -> None:
    path.write_bytes(encode_image(image))


def encode_image(image: np.ndarray) -> bytes:
    """Encode an image (H, W) or (H, W, 3) as a grey PNG file."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    # More compression takes ten times as long for a tenth of the size: noise does not compress.
    encoded, data = cv2.imencode(".png", grey, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    assert encoded
    return data.tobytes()
