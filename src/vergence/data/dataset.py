"""What a head hands out: frames of images and joint readings, and recordings of them.

A recording is a folder that anybody's program can write and read: see docs/dataset.md. This
module says what it holds; `dataset_files` reads and writes it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass as plain_dataclass
from dataclasses import field
from pathlib import Path
from typing import Annotated, Literal, get_args

import cv2
import numpy as np
from pydantic import AfterValidator, ConfigDict, Field
from pydantic.dataclasses import dataclass

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.board import Charuco, Chessboard
from vergence.geometry.camera import Camera
from vergence.geometry.head import Side
from vergence.geometry.kinematics import EYE_JOINTS, EYES, NECK_JOINTS


def _one_of(names: tuple[str, ...]) -> AfterValidator:
    def check(name: str) -> str:
        if name not in names:
            raise ValueError(f"expected one of {', '.join(names)}")
        return name

    return AfterValidator(check)


def _plain(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]{0,63}", name) or name in EYES:
        raise ValueError(
            "a camera's name begins with a letter, has letters, digits, - and _, and is not the "
            "name of an eye"
        )
    return name


CameraName = Annotated[str, AfterValidator(_plain)]
JointName = Annotated[str, _one_of((*EYE_JOINTS, *NECK_JOINTS))]

DESCRIPTION, FRAMES = "dataset.json", "frames.csv"
TIME, JOINT_TIME, PLACEMENT, MOVING = "time_s", "joint_time_s", "placement", "moving"
"""Columns of frames.csv besides joints, poses and cameras; `moving` may be left out."""

LARGEST_SQUARE_M = 1.0
"""A square given in millimetres is larger; boards of unknown size have squares of 1."""
LARGEST_IMAGE_PX = 20_000


@plain_dataclass(frozen=True, eq=False)
class Frame:
    """One moment as the software sees it."""

    time_s: float
    """Time stamp of the images."""
    joint_time_s: float
    """Time stamp of the joint readings."""
    eye_angles: Array
    """(4,) readings [rad] in the order of kinematics.EYE_JOINTS."""
    neck_angles: Array
    """(3,) readings [rad] in the order of kinematics.NECK_JOINTS."""
    images: Mapping[str, np.ndarray]
    """By camera: (H, W, 3) uint8, RGB."""


_STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)
_Pixels = Annotated[int, Field(gt=0, le=LARGEST_IMAGE_PX, strict=True)]


@dataclass(frozen=True, eq=False, config=_STRICT)
class DatasetCamera:
    """One camera of a dataset."""

    eye: Side
    """Which eye it sits in."""
    width: _Pixels
    """Image width [px]."""
    height: _Pixels
    """Image height [px]."""
    intrinsics: Camera | None = None
    """To start from, where something is known."""


@dataclass(frozen=True, eq=False, config=_STRICT)
class DatasetJoint:
    """Where a joint's readings stand in frames.csv, and how they are to be read."""

    column: str
    unit: Literal["rad", "deg"]
    sign: Literal[1, -1] = 1
    """-1 where the head counts the joint against this project's sense: pan positive to the left,
    tilt positive down (docs/conventions.md)."""


@dataclass(frozen=True, eq=False, config=_STRICT)
class Description:
    """dataset.json: all of a dataset but its frames."""

    cameras: dict[CameraName, DatasetCamera]
    board: Annotated[Chessboard | Charuco, Field(discriminator="kind")]
    joints: dict[JointName, DatasetJoint] = field(default_factory=dict)
    """Joints of the eyes that have cameras, unless their poses are given; perhaps the neck's."""
    eye_motion: Literal["pan-tilt", "poses"] = "pan-tilt"
    """Whether frames.csv gives angles, or 4x4 poses of the eyes in their bases."""
    note: str = ""
    format: Literal["vergence-dataset-1"] = "vergence-dataset-1"

    def __post_init__(self) -> None:
        if not self.cameras:
            raise ValueError("cameras is empty; a dataset has at least one")
        for name, camera in self.cameras.items():
            side = name.partition("_")[0]
            if side in EYES and side != camera.eye:
                raise ValueError(
                    f"cameras.{name}.eye is {camera.eye!r}; {name} sits in the {side} eye: are "
                    "left and right exchanged?"
                )
            known = camera.intrinsics
            if known and (known.width, known.height) != (camera.width, camera.height):
                raise ValueError(
                    f"cameras.{name} has images of {camera.width} x {camera.height}, but its "
                    f"intrinsics are of {known.width} x {known.height}"
                )
        if self.board.square_m > LARGEST_SQUARE_M:
            raise ValueError(
                f"board.square_m is {self.board.square_m} m; the side of a square is given in "
                "metres, such as 0.03"
            )
        if self.board.kind == "chessboard" and not (
            min(self.board.columns, self.board.rows) >= 3
            and max(self.board.columns, self.board.rows) <= 100
        ):
            raise ValueError(
                "board.columns and board.rows count inner corners, 3 to 100 each; found "
                f"{self.board.columns} x {self.board.rows}"
            )
        wanted = [f"{eye}_{joint}" for eye in self.eyes for joint in ("pan", "tilt")]
        given = [name for name in self.joints if name in EYE_JOINTS]
        if self.eye_motion == "poses" and given:
            raise ValueError(f"eye_motion is poses, but joints has {given[0]}; give one of the two")
        missing = [name for name in wanted if name not in self.joints]
        if self.eye_motion == "pan-tilt" and missing:
            raise ValueError(f"joints.{missing[0]} is missing; that eye has a camera")
        reserved = {TIME, JOINT_TIME, PLACEMENT, MOVING, *self.cameras}
        taken = {TIME, JOINT_TIME, PLACEMENT, MOVING} & set(self.cameras)
        if self.eye_motion == "poses":
            taken |= {name for eye in EYES for name in pose_columns(eye)} & set(self.cameras)
        if taken:
            raise ValueError(f"no camera can be called {min(taken)}, which is another column")
        for name, joint in self.joints.items():
            if joint.column in reserved or not joint.column.strip():
                raise ValueError(
                    f"joints.{name}.column is {joint.column!r}, which is not the name of a column "
                    "of joint readings"
                )

    @property
    def eyes(self) -> tuple[Side, ...]:
        """The eyes that have a camera."""
        there = {camera.eye for camera in self.cameras.values()}
        return tuple(eye for eye in get_args(Side) if eye in there)


def pose_columns(eye: str) -> list[str]:
    """Return the 16 columns of an eye's pose in its base, T_base_eye, row by row."""
    return [f"{eye}_T{row}{column}" for row in range(4) for column in range(4)]


@plain_dataclass(frozen=True, eq=False)
class Dataset:
    """A recording: N rows of frames.csv, checked, in this project's units and senses."""

    folder: Path
    description: Description
    lines: np.ndarray
    """(N,) line of each row in frames.csv, for messages."""
    time_s: Array
    """(N,) time stamps of the images; they rise."""
    joint_time_s: Array
    """(N,) time stamps of the joint readings; they rise."""
    eye_angles: Array
    """(N, 4) [rad] in the order of kinematics.EYE_JOINTS; 0 for an eye without cameras, NaN
    where poses are given."""
    T_base_eye: Array | None
    """(N, 2, 4, 4) poses of the left and the right eye in their bases, where they are given; the
    identity for an eye without cameras."""
    neck_angles: Array
    """(N, 3) [rad] in the order of kinematics.NECK_JOINTS; 0 for joints that are not given."""
    placement: np.ndarray
    """(N,) of int: rows with the same number show the board at the same place in the head."""
    moving: np.ndarray
    """(N,) of bool: whether the eyes were moving, so that the moment of the reading matters."""
    files: Mapping[str, tuple[str | None, ...]]
    """By camera: N image files, relative to the folder."""
    remarks: tuple[str, ...] = ()
    """What is odd, though it may be right: for the report."""

    def __len__(self) -> int:
        return len(self.time_s)

    def image(self, camera: str, row: int) -> np.ndarray | None:
        """Return an image (H, W, 3) uint8, RGB; None where the camera has none in this row.

        Raises:
            VergenceError: the file cannot be read, or has not the size that dataset.json states.
        """
        name = self.files[camera][row]
        if name is None:
            return None
        image = decode(self.folder / name)
        if image is None:
            raise VergenceError(f"{self.where(row)}: {camera}: {name} is not a readable image.")
        self.check_size(camera, row, image)
        return image

    def check_size(self, camera: str, row: int, image: np.ndarray) -> None:
        """Raise VergenceError where an image has not the size that dataset.json states."""
        stated = self.description.cameras[camera]
        height, width = image.shape[:2]
        if (width, height) != (stated.width, stated.height):
            raise VergenceError(
                f"{self.where(row)}: {camera}: {self.files[camera][row]} has {width} x {height} "
                f"pixels, but dataset.json says {stated.width} x {stated.height}."
            )

    def frame(self, row: int) -> Frame:
        """Return a row with all its images, as a head's driver would give it.

        Raises:
            VergenceError: as `image`.
        """
        images = {name: self.image(name, row) for name in self.files}
        return Frame(
            time_s=float(self.time_s[row]),
            joint_time_s=float(self.joint_time_s[row]),
            eye_angles=self.eye_angles[row],
            neck_angles=self.neck_angles[row],
            images={name: image for name, image in images.items() if image is not None},
        )

    def where(self, row: int) -> str:
        """Return how a message calls a row."""
        return f"{self.folder / FRAMES}, line {self.lines[row]}"


def decode(path: Path) -> np.ndarray | None:
    """Return an image file as (H, W, 3) uint8, RGB; None where it cannot be read."""
    try:
        data = np.fromfile(path, np.uint8)
        # Turned as the sensor was read, whatever the file says of how it should be shown.
        flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imdecode(data, flags)
    except (OSError, ValueError, cv2.error):
        return None
    return None if image is None else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


LONGEST_GAP_S = 0.2
"""Between rows of one motion."""


def runs(dataset: Dataset) -> np.ndarray:
    """Return (N,) of int: rows of one motion share a number from 1; 0 where the eyes stood still.

    Raises:
        VergenceError: a motion has fewer than three rows, which do not tell how fast it was.
    """
    late = np.diff(dataset.joint_time_s, prepend=-np.inf) > LONGEST_GAP_S
    before = np.concatenate([[False], dataset.moving[:-1]])
    run = np.cumsum(dataset.moving & (late | ~before)) * dataset.moving
    for number in range(1, run.max(initial=0) + 1):
        rows = np.flatnonzero(run == number)
        if len(rows) < 3:
            raise VergenceError(
                f"{dataset.where(rows[0])}: moving rows come at least 3 in sequence, not more than "
                f"{LONGEST_GAP_S} s apart; found {len(rows)}."
            )
    return run
