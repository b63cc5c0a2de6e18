"""What dataset.json states: cameras, board, joints and the columns of frames.csv."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field
from pydantic.dataclasses import dataclass

from vergence.arrays import Vector3
from vergence.geometry.board import Charuco, Chessboard
from vergence.geometry.camera import MAX_IMAGE_PX, Camera, check_image_size
from vergence.geometry.head import MAX_CAMERAS, check_camera_name
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import AXIS_NAMES, EYE_JOINTS, EYES, Kinematics, Side, pan_tilt
from vergence.geometry.neck import NECK_JOINTS

DESCRIPTION, FRAMES = "dataset.json", "frames.csv"
TIME, JOINT_TIME, PLACEMENT, MOVING = "time_s", "joint_time_s", "placement", "moving"
"""Columns of frames.csv besides joints, poses and cameras."""

MAX_SQUARE_M = 1.0
"""A larger side was probably given in millimetres; boards of unknown size have squares of 1."""

JOINTS: tuple[str, ...] = (*EYE_JOINTS, *NECK_JOINTS)
"""Names of the joints whose readings a dataset can hold without stating its kinematics."""
_STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)
_Pixels = Annotated[int, Field(gt=0, le=MAX_IMAGE_PX, strict=True)]


@dataclass(frozen=True, eq=False, config=_STRICT)
class DatasetCamera:
    """One camera of a dataset."""

    eye: Side
    """The eye that carries it."""
    width: _Pixels
    """Image width [px]."""
    height: _Pixels
    """Image height [px]."""
    intrinsics: Camera | None = None
    """What is known of the camera, for other programs: calibration does not use it."""
    bits: Annotated[int, Field(ge=8, le=16)] | None = None
    """How many bits of its 16-bit images the camera fills, such as 10 or 12; None: guessed
    from the brightest of a dozen of them."""


@dataclass(frozen=True, eq=False, config=_STRICT)
class DatasetJoint:
    """Column, unit and sign of a joint's readings in frames.csv."""

    column: str
    unit: Literal["rad", "deg"]
    sign: Literal[1, -1] = 1
    """-1 where the head's encoder counts in the opposite direction; here pan is positive to the
    left, tilt positive down (docs/conventions.md)."""


@dataclass(frozen=True, eq=False, config=_STRICT)
class DatasetReading:
    """Unit and sign of a column of frames.csv from which joints' angles are made."""

    unit: Literal["rad", "deg"]
    sign: Literal[1, -1] = 1
    """-1 where the encoder counts in the opposite direction."""


def _direction(axis: Any) -> Any:
    """Return the direction of an axis that has a name; ValueError if it is none."""
    if isinstance(axis, str) and axis in AXIS_NAMES:
        return AXIS_NAMES[axis]
    numbers = isinstance(axis, list | tuple | np.ndarray) and np.shape(axis) == (3,)
    if not numbers or not 0.1 < np.linalg.norm(np.array(axis, dtype=float)) < 10:
        raise ValueError(
            f"expected {', '.join(AXIS_NAMES)} or a direction such as [0, 0, 1], found {axis!r:.80}"
        )
    return axis


@dataclass(frozen=True, eq=False, config=_STRICT)
class EyeJoint:
    """A joint of an eye as designed: angle = sum of factor * reading."""

    name: str
    axis: Annotated[Vector3, BeforeValidator(_direction)]
    """Axis of a right-handed turn, with every joint at zero: up, to the left, ahead, or a vector in
    the axes of the head (x ahead, y left, z up)."""
    readings: dict[str, float]
    """By column of frames.csv its factor."""
    point_m: Vector3 = field(default_factory=lambda: np.zeros(3))
    """A point on the axis, in the eye's base."""


@dataclass(frozen=True, eq=False, config=_STRICT)
class Description:
    """Content of dataset.json: cameras, board and joints."""

    cameras: dict[str, DatasetCamera]
    board: Annotated[Chessboard | Charuco, Field(discriminator="kind")]
    joints: dict[str, DatasetJoint] = field(default_factory=dict)
    """Pan and tilt of each eye that has cameras, unless `kinematics` or poses are given; optionally
    the neck's."""
    kinematics: dict[Side, tuple[EyeJoint, ...]] | None = None
    """The joints of each eye that has cameras, from the head outwards; None: pan, then tilt."""
    readings: dict[str, DatasetReading] = field(default_factory=dict)
    """By column the unit and the sign of the readings that `kinematics` speaks of."""
    eye_motion: Literal["pan-tilt", "poses"] = "pan-tilt"
    """Whether frames.csv gives joint angles, or 4x4 poses of the eyes in their bases."""
    note: str = ""
    format: Literal["vergence-dataset-1"] = "vergence-dataset-1"

    def __post_init__(self) -> None:
        self._check_cameras()
        self._check_board()
        for name in self.joints:
            if name not in JOINTS:
                raise ValueError(f"joints.{name}: expected one of {', '.join(JOINTS)}")
        self._check_kinematics()
        self._check_pan_and_tilt()
        self._check_columns()
        _ = self.head_kinematics  # its joints are checked when they are made

    def _check_cameras(self) -> None:
        if not 1 <= len(self.cameras) <= MAX_CAMERAS:
            found = f"found {len(self.cameras)}" if self.cameras else "cameras is empty"
            raise ValueError(f"a dataset has 1 to {MAX_CAMERAS} cameras; {found}")
        for name, camera in self.cameras.items():
            check_camera_name(name)
            check_image_size(camera.width, camera.height)
            side = name.partition("_")[0]
            if side in EYES and side != camera.eye:
                raise ValueError(
                    f"cameras.{name}.eye is {camera.eye!r}, but {name} sits in the {side} eye; "
                    "perhaps left and right are exchanged"
                )
            known = camera.intrinsics
            if known and (known.width, known.height) != (camera.width, camera.height):
                raise ValueError(
                    f"cameras.{name} has images of {camera.width} x {camera.height}, but its "
                    f"intrinsics are of {known.width} x {known.height}"
                )

    def _check_board(self) -> None:
        if self.board.square_m > MAX_SQUARE_M:
            raise ValueError(
                f"board.square_m is {self.board.square_m} m; the side of a square is given in "
                "metres, such as 0.03"
            )
        columns, rows = self.board.columns, self.board.rows
        in_range = 3 <= min(columns, rows) <= max(columns, rows) <= 100
        if self.board.kind == "chessboard" and not in_range:
            raise ValueError(
                "board.columns and board.rows count inner corners, 3 to 100 each; found "
                f"{columns} x {rows}"
            )

    def _check_pan_and_tilt(self) -> None:
        """Check that `joints` has pan and tilt of the eyes that need them, and of no others."""
        for name in EYE_JOINTS:
            if self.eye_motion == "poses" and name in self.joints:
                raise ValueError(f"eye_motion is poses, but joints has {name}; give one of the two")
            needed = self.eye_motion == "pan-tilt" and name.partition("_")[0] in self.eyes
            if needed and self.kinematics is None and name not in self.joints:
                raise ValueError(f"joints.{name} is missing; that eye has a camera")

    def _check_columns(self) -> None:
        """Check that no camera and no joint has the name of another column."""
        reserved = {TIME, JOINT_TIME, PLACEMENT, MOVING, *self.pose_columns}
        if clash := reserved & set(self.cameras):
            raise ValueError(f"no camera can be called {min(clash)}, which is another column")
        for name, joint in self.joints.items():
            if joint.column in reserved | set(self.cameras) or not joint.column.strip():
                raise ValueError(
                    f"joints.{name}.column is {joint.column!r}, which is not the name of a column "
                    "of joint readings"
                )

    def _check_kinematics(self) -> None:
        if self.kinematics is None:
            if self.readings:
                raise ValueError("readings are those of kinematics, which is missing")
            return
        if self.eye_motion == "poses":
            raise ValueError("eye_motion is poses, but kinematics is given; give one of the two")
        if both := [name for name in EYE_JOINTS if name in self.joints]:
            raise ValueError(f"kinematics is given, and joints.{both[0]} too; give one of the two")
        for eye in self.eyes:
            if eye not in self.kinematics:
                raise ValueError(f"kinematics.{eye} is missing; that eye has a camera")
            if not self.kinematics[eye]:
                raise ValueError(
                    f"kinematics.{eye} has no joint, but that eye has a camera, whose place in the "
                    "eye is found by turning it; describe the joints of what carries it"
                )
        joints = [joint for own in self.kinematics.values() for joint in own]
        used = {column for joint in joints for column in joint.readings}
        if odd := used ^ set(self.readings):
            name = min(odd)
            known = "is in no joint of kinematics" if name in self.readings else "is missing"
            raise ValueError(f"readings.{name} {known}; each column has its unit there once")
        reserved = {TIME, JOINT_TIME, PLACEMENT, MOVING, *self.cameras}
        reserved |= {*self.joints, *(joint.column for joint in self.joints.values())}
        if clash := reserved & used:
            raise ValueError(f"no reading can be called {min(clash)}, which is another column")

    @property
    def sources(self) -> dict[str, DatasetJoint]:
        """Column, unit and sign of each reading of eyes and neck that has a column, by its name."""
        own = {
            name: DatasetJoint(column=name, unit=reading.unit, sign=reading.sign)
            for name, reading in self.readings.items()
        }
        return self.joints | own

    @cached_property
    def head_kinematics(self) -> Kinematics:
        """The joints of both eyes as designed; an eye without cameras may have none.

        Pan and tilt joints that share a column share one reading, which has the name of the first
        of them.
        """
        if self.kinematics is None:
            return _pan_and_tilt({n: j for n, j in self.joints.items() if n in EYE_JOINTS})
        eyes: dict[Side, tuple[Joint, ...]] = {
            eye: tuple(map(_joint, self.kinematics.get(eye, ()))) for eye in EYES
        }
        return Kinematics(eyes, tuple(self.readings))

    @property
    def eyes(self) -> tuple[Side, ...]:
        """The eyes that have a camera, left before right."""
        return tuple(eye for eye in EYES if any(c.eye == eye for c in self.cameras.values()))

    @property
    def pose_columns(self) -> list[str]:
        """Columns of frames.csv with the eyes' poses, 16 each; none if it has joint angles."""
        poses = self.eye_motion == "poses"
        return [name for eye in self.eyes for name in pose_columns(eye)] if poses else []

    @property
    def columns(self) -> list[str]:
        """Columns of frames.csv, of which `moving` may be missing."""
        joints = dict.fromkeys(joint.column for joint in self.joints.values())
        fixed = [TIME, JOINT_TIME, PLACEMENT, MOVING]
        return [*fixed, *joints, *self.readings, *self.pose_columns, *self.cameras]


def _pan_and_tilt(joints: Mapping[str, DatasetJoint]) -> Kinematics:
    first: dict[str, str] = {}  # by column the joint that names its reading
    for name in EYE_JOINTS:
        if name in joints:
            first.setdefault(joints[name].column, name)
    if len(first) == len(joints):
        return Kinematics()
    eyes: dict[Side, tuple[Joint, ...]] = {}
    for eye in EYES:
        pan, tilt = (joints.get(f"{eye}_{joint.name}") for joint in pan_tilt(eye))
        if pan is None or tilt is None:  # of an eye without cameras
            eyes[eye] = ()
            continue
        if pan.column == tilt.column:
            raise ValueError(f"joints.{eye}_tilt has the column of {eye}_pan, {pan.column!r}")
        own = []
        for joint, stated in zip(pan_tilt(eye), (pan, tilt), strict=True):
            name = first[stated.column]
            if stated.unit != joints[name].unit:
                raise ValueError(f"joints.{eye}_{joint.name}.unit differs from joints.{name}.unit")
            factor = float(stated.sign * joints[name].sign)
            own.append(replace(joint, readings={name: factor}))
        eyes[eye] = tuple(own)
    return Kinematics(eyes, tuple(first.values()))


def _joint(stated: EyeJoint) -> Joint:
    return Joint(
        name=stated.name,
        axis=stated.axis / np.linalg.norm(stated.axis),
        readings=stated.readings,
        point_m=stated.point_m,
    )


def pose_columns(eye: str) -> list[str]:
    """Return the 16 names of the columns with an eye's pose T_base_eye, in row-major order."""
    return [f"{eye}_T{row}{column}" for row in range(4) for column in range(4)]
