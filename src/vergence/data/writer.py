"""Writing datasets to disk, whole or not at all. The format is described in docs/dataset.md."""

from __future__ import annotations

import csv
import os
import shutil
import tempfile
from collections import deque
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from pydantic import TypeAdapter

from vergence.arrays import Array
from vergence.data.dataset import (
    DESCRIPTION,
    FRAMES,
    JOINT_TIME,
    MOVING,
    PLACEMENT,
    TIME,
    DatasetJoint,
    Description,
    Frame,
    pose_columns,
)
from vergence.errors import VergenceError
from vergence.geometry.kinematics import EYE_JOINTS, EYES, NECK_JOINTS

_ADAPTER = TypeAdapter(Description)


@dataclass(frozen=True, eq=False)
class Entry:
    """One row to be written."""

    frame: Frame
    placement: int | None = None
    """Rows with the same number show the board at the same place; None: at one of its own."""
    moving: bool = False
    T_base_eye: Array | None = None
    """(2, 4, 4) poses of the eyes, where the description says that they are given."""


def check_new(folder: Path) -> None:
    """Raise VergenceError where a dataset cannot be written: something is there already."""
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise VergenceError(
                f"{folder} is there already and not empty; name another folder, or remove it."
            )
    except OSError as error:
        raise VergenceError(f"Cannot use the folder {folder}: {error.strerror}.") from error


def write(folder: Path, description: Description, entries: Iterable[Entry]) -> None:
    """Write a dataset, in a temporary folder that is renamed when it is whole.

    Images become grey PNGs, which is all that detection looks at and a third of the size; they
    are encoded in worker threads while the entries are being made.

    Raises:
        VergenceError: the folder is not empty, or cannot be written.
    """
    check_new(folder)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
        try:
            (made / "images").mkdir()
            text = _ADAPTER.dump_json(description, indent=1, exclude_none=True).decode()
            (made / DESCRIPTION).write_text(text + "\n", encoding="utf-8")
            _write_frames(made, description, entries)
            made.chmod(0o755)  # mkdtemp's folders are private
            if folder.is_dir():
                folder.rmdir()
            made.rename(folder)
        except BaseException:
            shutil.rmtree(made, ignore_errors=True)
            raise
    except OSError as error:
        raise VergenceError(f"Cannot write the dataset {folder}: {error.strerror}.") from error


def _write_frames(made: Path, description: Description, entries: Iterable[Entry]) -> None:
    columns = [TIME, JOINT_TIME, PLACEMENT, MOVING]
    joints: dict[str, tuple[str, DatasetJoint]] = {
        joint.column: (name, joint) for name, joint in description.joints.items()
    }
    poses = description.eye_motion == "poses"
    pose_names = [pose_columns(eye) if poses else [] for eye in description.eyes]
    columns += [*joints, *(name for names in pose_names for name in names), *description.cameras]
    workers = os.cpu_count() or 1
    pending: deque[Future[None]] = deque()
    with (
        (made / FRAMES).open("w", encoding="utf-8", newline="") as file,
        ThreadPoolExecutor(workers) as pool,
    ):
        table = csv.DictWriter(file, columns, restval="", lineterminator="\n")
        table.writeheader()
        for number, entry in enumerate(entries):
            frame = entry.frame
            cells: dict[str, object] = {
                TIME: float(frame.time_s),
                JOINT_TIME: float(frame.joint_time_s),
                PLACEMENT: "" if entry.placement is None else entry.placement,
                MOVING: int(entry.moving),
            }
            angles: dict[str, float] = dict(
                zip((*EYE_JOINTS, *NECK_JOINTS), _seven(frame), strict=True)
            )
            for column, (name, joint) in joints.items():
                value = joint.sign * angles[name]
                cells[column] = float(np.degrees(value) if joint.unit == "deg" else value)
            if poses and entry.T_base_eye is not None:
                for eye, names in zip(description.eyes, pose_names, strict=True):
                    values = entry.T_base_eye[EYES.index(eye)].ravel().tolist()
                    cells |= dict(zip(names, values, strict=True))
            for camera, image in frame.images.items():
                cells[camera] = f"images/{number:05d}_{camera}.png"
                pending.append(pool.submit(_write_image, made / str(cells[camera]), image))
            table.writerow(cells)
            while len(pending) > 8 * workers:  # what waits is in memory
                pending.popleft().result()
        for each in pending:
            each.result()


def _seven(frame: Frame) -> list[float]:
    return [*map(float, frame.eye_angles), *map(float, frame.neck_angles)]


def _write_image(path: Path, image: np.ndarray) -> None:
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    # More compression takes ten times as long for a tenth of the size: noise does not compress.
    done, data = cv2.imencode(".png", grey, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    assert done
    path.write_bytes(data.tobytes())
