"""Frames of images and joint readings, and datasets, which are recordings of frames on disk.

`data.description` describes a dataset, `data.reader` reads and `data.writer` writes one.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.data.description import DESCRIPTION, FRAMES, Description
from vergence.data.images import MAX_IMAGE_BYTES, UNREADABLE, decode_image, to_8_bits
from vergence.data.timing import JointStream, Timing, moved_readings
from vergence.errors import VergenceError, counted
from vergence.files import read_bytes
from vergence.findings import Finding
from vergence.geometry.board import Board
from vergence.geometry.camera import check_image_fits
from vergence.geometry.head import HeadCalibration, pair_names

MAX_GAP_S = 0.25
"""Longest time [s] between successive rows of one motion; images at 5 Hz, whose stamps vary."""
LEAST_MOVING = 3
"""Fewest rows of a motion, so that its velocity can be estimated."""


@dataclass(frozen=True, eq=False)
class Frame:
    """Images and joint readings of one moment, from the twin or from a real head's driver."""

    time_s: float
    """Time stamp of the images."""
    joint_time_s: float
    """Time stamp of the joint readings."""
    eye_angles: Array
    """(r,) joint readings of the eyes [rad] in the order of the head's kinematics.readings."""
    neck_angles: Array
    """(n,) joint readings of the neck [rad] in the order of its joints, from the body outwards."""
    images: Mapping[str, np.ndarray]
    """By camera name: (H, W, 3) uint8, RGB."""


@dataclass(frozen=True, eq=False)
class Dataset:
    """A recording of N frames, checked; angles in radians, positive as docs/conventions.md says."""

    folder: Path
    description: Description
    lines: np.ndarray
    """(N,) line numbers of the rows in frames.csv, for messages."""
    time_s: Array
    """(N,) time stamps of the images, strictly increasing."""
    joint_time_s: Array
    """(N,) time stamps of the joint readings, strictly increasing."""
    eye_angles: Array
    """(N, r) [rad] in the order of description.head_kinematics.readings; 0 for an eye without
    cameras, NaN where poses are given."""
    T_base_eye: Array | None
    """(N, 2, 4, 4) poses of the left and the right eye in their bases, the identity for an eye
    without cameras; None where joint angles are given instead."""
    neck_angles: Array
    """(N, n) [rad] in the order of description.neck_joints."""
    placement: np.ndarray
    """(N,) of int: rows with the same number show the board at the same pose in frame head."""
    moving: np.ndarray
    """(N,) of bool: whether the eyes were moving, so that the time of the reading matters."""
    files: Mapping[str, tuple[str | None, ...]]
    """By camera name: N image files, relative to the folder; None where there is no image."""
    stream: JointStream | None = None
    """Readings of the eyes at their own rate, on the clock of joint_time_s; None: not recorded."""
    findings: tuple[Finding, ...] = ()
    """What looks unusual but may be right, one sentence each, for the report."""

    def __len__(self) -> int:
        return len(self.time_s)

    def __repr__(self) -> str:
        return f"<Dataset {self.folder}: {counted(len(self), 'frame')} of {', '.join(self.files)}>"

    @property
    def board(self) -> Board:
        """The board that the images show; VergenceError if none is described."""
        if self.description.board is None:
            raise VergenceError(
                f"{self.folder / DESCRIPTION} describes no board, so that the recording serves "
                "self-calibration and depth only."
            )
        return self.description.board

    def image(self, camera: str, row: int) -> np.ndarray | None:
        """Read an image (H, W, 3) uint8, RGB; None where the camera has none in this row.

        VergenceError if the file cannot be read, or its size differs from dataset.json.
        """
        image = self.readable_image(camera, row)
        if image is None and self.files[camera][row] is not None:
            raise VergenceError(
                f"{self.where(row)}: {camera}: {self.files[camera][row]} {UNREADABLE}."
            )
        return image

    def readable_image(self, camera: str, row: int) -> np.ndarray | None:
        """Read an image as `image` does, but return None for a damaged file."""
        if camera not in self.files:
            raise VergenceError(
                f"No camera is called {camera!r}; the dataset has {', '.join(self.files)}."
            )
        name, stated = self.files[camera][row], self.description.cameras[camera]
        if name is None:
            return None
        image = decode_image(read_bytes(self.folder / name, MAX_IMAGE_BYTES))
        if image is None:
            return None
        height, width = image.shape[:2]
        if (width, height) != (stated.width, stated.height):
            raise VergenceError(
                f"{self.where(row)}: {camera}: {name} has {width} x {height} pixels, but "
                f"dataset.json says {stated.width} x {stated.height}."
            )
        if image.ndim == 2:
            image = cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)
        return to_8_bits(image, stated.bits)

    def frame(self, row: int, cameras: Sequence[str] | None = None) -> Frame:
        """Read a row with the images of some cameras, None: all; errors as in `image`."""
        images = {name: self.image(name, row) for name in cameras or self.files}
        return Frame(
            time_s=float(self.time_s[row]),
            joint_time_s=float(self.joint_time_s[row]),
            eye_angles=self.eye_angles[row],
            neck_angles=self.neck_angles[row],
            images={name: image for name, image in images.items() if image is not None},
        )

    def where(self, row: int) -> str:
        """Cite the file and line of a row."""
        return f"{self.folder / FRAMES}, line {self.lines[row]}"


def number_motions(time_s: Array, moving: np.ndarray) -> np.ndarray:
    """Number the motion of each row (N,) of int from 1; 0 for eyes at rest.

    A motion ends where the eyes rest or rows are more than MAX_GAP_S apart.
    """
    late = np.diff(time_s, prepend=-np.inf) > MAX_GAP_S
    return np.cumsum(moving & (late | ~np.roll(moving, 1))) * moving


def runs(dataset: Dataset) -> np.ndarray:
    """Number the motions of a dataset; VergenceError if one has fewer than LEAST_MOVING rows."""
    run = number_motions(dataset.joint_time_s, dataset.moving)
    for number in np.flatnonzero(np.bincount(run)[1:] < LEAST_MOVING) + 1:
        rows = np.flatnonzero(run == number)
        raise VergenceError(
            f"{dataset.where(rows[0])}: moving rows come at least {LEAST_MOVING} in sequence, "
            f"not more than {MAX_GAP_S} s apart; found {len(rows)}."
        )
    return run


@dataclass(frozen=True, eq=False)
class StereoRows:
    """N rows of a dataset that have an image of each of two cameras, in order of time."""

    dataset: Dataset
    cameras: tuple[str, str]
    """Names of the cameras of the left and the right eye."""
    rows: np.ndarray
    """(N,) of int: which rows."""
    joints: Array
    """(N, r) readings at the moments of the images [rad], or eye poses (N, 2, 4, 4)."""

    def frame(self, k: int) -> Frame:
        """Read the k-th row with the images of both cameras; errors as in `Dataset.image`."""
        frame = self.dataset.frame(int(self.rows[k]), self.cameras)
        measured = self.joints.ndim > 2  # then angles are NaN
        angles = frame.eye_angles if measured else self.joints[k]
        return replace(frame, joint_time_s=frame.time_s, eye_angles=angles)


def stereo_rows(dataset: Dataset, head: HeadCalibration) -> StereoRows:
    """Select the rows with images of both main cameras of a head.

    While the eyes move, readings are moved to the moments of the images by the calibrated time
    offset or, without one, by the time stamps. VergenceError if head and dataset do not match.
    """
    cameras, folder = pair_names(head), dataset.folder
    if not {*cameras} <= dataset.files.keys():
        raise VergenceError(
            f"The calibration's main cameras are {' and '.join(cameras)}; {folder} has "
            f"{', '.join(dataset.files)}."
        )
    check_fits(dataset.description, head, folder, cameras)
    pairs = zip(*(dataset.files[name] for name in cameras), strict=True)
    rows = np.flatnonzero([None not in pair for pair in pairs])
    if not len(rows):
        raise VergenceError(f"No row of {folder} has images of both {' and '.join(cameras)}.")
    return StereoRows(dataset, cameras, rows, readings_at_images(dataset, head)[rows])


def check_fits(
    description: Description, head: HeadCalibration, where: Path | str, cameras: Iterable[str]
) -> None:
    """Raise VergenceError if described cameras or readings are not those of a head."""
    for name in cameras:
        size = description.cameras[name].height, description.cameras[name].width
        check_image_fits(name, head.camera(name).intrinsics, size, whose=f"those of {where}")
    read, known = description.head_kinematics.readings, head.kinematics.readings
    if read != known and description.eye_motion != "poses":
        raise VergenceError(
            f"The calibration is for the joint readings {', '.join(known)}; {where} has "
            f"{', '.join(read) or 'none'}."
        )


def readings_at_images(dataset: Dataset, head: HeadCalibration) -> Array:
    """Move readings (M, r) [rad], or eye poses (M, 2, 4, 4), of all rows to their images."""
    readings = dataset.eye_angles if dataset.T_base_eye is None else dataset.T_base_eye
    if not dataset.moving.any():
        return readings
    timing = Timing(dataset.joint_time_s, runs(dataset), dataset.stream)
    return moved_readings(readings, timing, time_offset(dataset, head))


def time_offset(dataset: Dataset, head: HeadCalibration) -> float:
    """Take the calibrated time from a reading to its image [s] or, without one, the stamps'."""
    apart = (dataset.time_s - dataset.joint_time_s)[dataset.moving]
    return head.time_offset_s or (float(np.median(apart)) if len(apart) else 0.0)
