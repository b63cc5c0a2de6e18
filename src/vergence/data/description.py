"""Describe a dataset as dataset.json does: cameras, board, joints and the columns of frames.csv."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import field, replace
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field
from pydantic.dataclasses import dataclass

from vergence.arrays import Vector3
from vergence.geometry.board import Board
from vergence.geometry.camera import MAX_IMAGE_PX, Camera, check_image_size
from vergence.geometry.head import MAX_CAMERAS, check_camera_name
from vergence.geometry.joints import Joint, ReadingName
from vergence.geometry.kinematics import (
    AXIS_NAMES,
    EYE_JOINTS,
    EYES,
    FIXED_EYES,
    Kinematics,
    Side,
    pan_tilt,
)

DESCRIPTION, FRAMES, STREAM = "dataset.json", "frames.csv", "joints.csv"
TIME, JOINT_TIME, PLACEMENT, MOVING = "time_s", "joint_time_s", "placement", "moving"
"""Columns of frames.csv other than joints, poses and cameras."""
MAX_SQUARE_M = 1.0
"""Largest side of a square [m]: larger ones are millimetres; boards of unknown size have 1."""
STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)
"""Unknown fields and numbers that are not finite are refused."""
_Pixels = Annotated[int, Field(gt=0, le=MAX_IMAGE_PX, strict=True)]


@dataclass(frozen=True, eq=False, config=STRICT)
class DatasetCamera:
    """One camera of a dataset."""

    eye: Side
    """The eye that carries it."""
    width: _Pixels
    """Image width [px]."""
    height: _Pixels
    """Image height [px]."""
    intrinsics: Camera | None = None
    """Known intrinsics; without `intrinsics_std_percent` for other programs only."""
    intrinsics_std_percent: Annotated[float, Field(ge=0, le=5)] | None = None
    """How well calibration takes the intrinsics to be known: standard deviation of the focal
    lengths [%], of the principal point [% of half the image], and of what each coefficient moves
    the image's corner [% of its distance]; 0: exactly. None: they are not used."""
    bits: Annotated[int, Field(ge=8, le=16)] | None = None
    """Bits that 16-bit images of the camera fill; None: by the range that each image fills."""


@dataclass(frozen=True, eq=False, config=STRICT)
class DatasetReading:
    """Unit and sign of a column of readings that `kinematics` uses."""

    unit: Literal["rad", "deg"]
    sign: Literal[1, -1] = 1
    """-1: the encoder counts in the opposite direction (docs/conventions.md)."""


@dataclass(frozen=True, eq=False, config=STRICT)
class DatasetJoint:
    """Column, unit and sign of the readings of a joint."""

    column: str
    unit: Literal["rad", "deg"]
    sign: Literal[1, -1] = 1
    """-1: the encoder counts in the opposite direction; pan is positive to the left, tilt down."""


def _direction(axis: Any) -> Any:
    """Convert the name of an axis to its direction; ValueError for an invalid axis."""
    if isinstance(axis, str) and axis in AXIS_NAMES:
        return AXIS_NAMES[axis]
    try:
        if 0.1 < np.linalg.norm(np.array(axis, dtype=float).reshape(3)) < 10:
            return axis
    except (TypeError, ValueError):
        pass
    raise ValueError(
        f"expected {', '.join(AXIS_NAMES)} or a direction such as [0, 0, 1], found {axis!r:.80}"
    )


@dataclass(frozen=True, eq=False, config=STRICT)
class EyeJoint:
    """A joint of an eye as designed: its angle is the sum of factor times reading."""

    name: str
    axis: Annotated[Vector3, BeforeValidator(_direction)]
    """Axis of a right-handed turn, with every joint at zero: pan, tilt, roll, or a vector in the
    axes of the head (x ahead, y left, z up)."""
    readings: dict[str, float]
    """Factor of each column of frames.csv."""
    point_m: Vector3 = field(default_factory=lambda: np.zeros(3))
    """A point on the axis in the eye's base [m]."""


@dataclass(frozen=True, eq=False, config=STRICT, kw_only=True)
class BoardAndJoints:
    """Board and joints, as dataset.json and the map of a recording describe them."""

    board: Annotated[Board, Field(discriminator="kind")] | None = None
    """None: a recording without a board, for self-calibration and depth."""
    joints: dict[ReadingName, DatasetJoint] = field(default_factory=dict)
    """Pan and tilt of each eye that has cameras, unless `kinematics` or poses are given; all others
    are the neck's, from the body outwards."""
    kinematics: dict[Side, tuple[EyeJoint, ...]] | None = None
    """Joints of each eye that has cameras, from the head outwards; None: pan, then tilt."""
    readings: dict[str, DatasetReading] = field(default_factory=dict)
    """Unit and sign of each column that `kinematics` uses."""
    note: str = ""


@dataclass(frozen=True, eq=False, config=STRICT, kw_only=True)
class Description(BoardAndJoints):
    """Content of dataset.json: cameras, board and joints."""

    cameras: dict[str, DatasetCamera]
    eye_motion: Literal["pan-tilt", "poses", "fixed"] = "pan-tilt"
    """Whether frames.csv gives joint readings, or 4x4 poses of the eyes in their bases, or the
    cameras stand still to each other."""
    format: Literal["vergence-dataset-1"] = "vergence-dataset-1"

    def __post_init__(self) -> None:
        for name, camera in self.cameras.items():
            check_camera_name(name)
            check_image_size(camera.width, camera.height)
        for contradiction in self._contradictions():
            raise ValueError(contradiction)
        _ = self.head_kinematics  # checks its joints

    def _contradictions(self) -> Iterator[str]:
        if not 1 <= len(self.cameras) <= MAX_CAMERAS:
            found = f"found {len(self.cameras)}" if self.cameras else "cameras is empty"
            yield f"a dataset has 1 to {MAX_CAMERAS} cameras; {found}"
        for name, camera in self.cameras.items():
            size = camera.intrinsics.size if camera.intrinsics is not None else None
            if camera.intrinsics_std_percent is not None and size != (camera.width, camera.height):
                yield f"cameras.{name}.intrinsics_std_percent needs intrinsics of that image size"
            side = name.partition("_")[0]
            if side in EYES and side != camera.eye:
                yield (
                    f"cameras.{name}.eye is {camera.eye!r}, but {name} sits in the {side} eye; "
                    "perhaps left and right are exchanged"
                )
        if self.board is not None:
            yield from _board_contradictions(self.board)
        yield from self._contradictory_motion()
        name, uses = Counter(self.columns).most_common(1)[0]
        if uses > 1 or not all(name.strip() for name in self.columns):
            yield f"the name of the column {name!r} is used twice, or a column has no name"

    def _contradictory_motion(self) -> Iterator[str]:
        """Check that each eye with a camera has its joints, described in one way."""
        usual = [f"joints has {name}" for name in EYE_JOINTS if name in self.joints]
        ways = [f"eye_motion is {self.eye_motion}"] * (self.eye_motion != "pan-tilt")
        ways += ["kinematics is given"] * (self.kinematics is not None) + usual[:1]
        if len(ways) > 1:
            yield f"{ways[0]}, but {ways[1]}; give one of the two"
        chains = self.kinematics or {}
        for eye in self.eyes:
            if self.kinematics is not None and not chains.get(eye):
                yield (
                    f"kinematics.{eye} has no joint; that eye has a camera, whose place in the eye "
                    "is found by turning it"
                )
            for name in (f"{eye}_pan", f"{eye}_tilt") if ways == usual[:1] else ():
                if name not in self.joints:
                    yield f"joints.{name} is missing; that eye has a camera"
        used = {column for chain in chains.values() for joint in chain for column in joint.readings}
        for name in sorted(used ^ set(self.readings)):
            problem = "is in no joint of kinematics" if name in self.readings else "is missing"
            yield f"readings.{name} {problem}; each column has its unit there once"

    @property
    def sources(self) -> dict[str, DatasetJoint]:
        """Column, unit and sign of each reading of eyes and neck by its name."""
        readings = {
            name: DatasetJoint(column=name, unit=reading.unit, sign=reading.sign)
            for name, reading in self.readings.items()
        }
        return self.joints | readings

    @property
    def neck_joints(self) -> tuple[str, ...]:
        """Names of the joints of the neck, in their order."""
        return tuple(name for name in self.joints if name not in EYE_JOINTS)

    @cached_property
    def head_kinematics(self) -> Kinematics:
        """Joints of both eyes as designed; an eye without cameras may have none.

        Pan and tilt joints that share a column share one reading, with the name of the first.
        """
        if self.eye_motion == "fixed":
            return FIXED_EYES
        if self.kinematics is None:
            return _pan_and_tilt({n: j for n, j in self.joints.items() if n in EYE_JOINTS})
        eyes: dict[Side, tuple[Joint, ...]] = {
            eye: tuple(
                Joint(
                    name=joint.name,
                    axis=joint.axis / np.linalg.norm(joint.axis),
                    readings=joint.readings,
                    point_m=joint.point_m,
                )
                for joint in self.kinematics.get(eye, ())
            )
            for eye in EYES
        }
        return Kinematics(eyes, tuple(self.readings))

    @property
    def eyes(self) -> tuple[Side, ...]:
        """Eyes that have a camera, left before right."""
        return tuple(eye for eye in EYES if any(c.eye == eye for c in self.cameras.values()))

    @property
    def pose_columns(self) -> list[str]:
        """Columns with the eyes' poses, 16 each; empty where joint readings are given."""
        poses = self.eye_motion == "poses"
        return [name for eye in self.eyes for name in pose_columns(eye)] if poses else []

    @property
    def columns(self) -> list[str]:
        """Columns of frames.csv; those of `optional_columns` may be missing."""
        joints = dict.fromkeys(joint.column for joint in self.joints.values())
        fixed = [TIME, JOINT_TIME, PLACEMENT, MOVING]
        return [*fixed, *joints, *self.readings, *self.pose_columns, *self.cameras]

    @property
    def optional_columns(self) -> tuple[str, ...]:
        """Columns that frames.csv may lack; cameras that stand still need their images only."""
        still = self.eye_motion == "fixed"
        return (TIME, JOINT_TIME, PLACEMENT, MOVING) if still else (MOVING,)


def _board_contradictions(board: Board) -> Iterator[str]:
    """Check the size of a board and the number of its corners."""
    if board.square_m > MAX_SQUARE_M:
        yield (
            f"board.square_m is {board.square_m} m; the side of a square is given in metres, "
            "such as 0.03"
        )
    sides = board.columns, board.rows
    if board.kind == "chessboard" and not 3 <= min(sides) <= max(sides) <= 100:
        yield (
            "board.columns and board.rows count inner corners, 3 to 100 each; found "
            f"{sides[0]} x {sides[1]}"
        )


def _pan_and_tilt(stated: Mapping[str, DatasetJoint]) -> Kinematics:
    """Make pan and tilt joints; some may share a column."""
    reading_of: dict[str, str] = {}  # by column
    for name in EYE_JOINTS:
        if name in stated:
            reading_of.setdefault(stated[name].column, name)
    if len(reading_of) == len(stated):
        return Kinematics()
    eyes: dict[Side, tuple[Joint, ...]] = {}
    for eye in EYES:
        chain = []
        for joint in pan_tilt(eye):
            if not {f"{eye}_pan", f"{eye}_tilt"} <= stated.keys():
                continue  # an eye without cameras
            name = f"{eye}_{joint.name}"
            reading = reading_of[stated[name].column]
            if reading == f"{eye}_pan" != name:
                raise ValueError(f"joints.{name} has the column of {reading}")
            if stated[name].unit != stated[reading].unit:
                raise ValueError(f"joints.{name}.unit differs from joints.{reading}.unit")
            factor = float(stated[name].sign * stated[reading].sign)
            chain.append(replace(joint, readings={reading: factor}))
        eyes[eye] = tuple(chain)
    return Kinematics(eyes, tuple(reading_of.values()))


def pose_columns(eye: str) -> list[str]:
    """Name the 16 columns of an eye's pose T_base_eye in row-major order."""
    return [f"{eye}_T{row}{column}" for row in range(4) for column in range(4)]
