"""`head.toml` beside an MJCF or a URDF: what makes it a head; `docs/own_head.md` explains it."""

from __future__ import annotations

import tomllib
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from vergence.arrays import Vector3
from vergence.files import read_parsed, validated
from vergence.geometry.camera import MAX_IMAGE_PX
from vergence.geometry.kinematics import Side
from vergence.geometry.lens import CameraModel

Name = Annotated[str, Field(min_length=1, max_length=200)]
Pixels = Annotated[int, Field(gt=0, le=MAX_IMAGE_PX)]


class _Table(BaseModel):
    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True
    )


class LensFile(_Table):
    """A lens: the first of these that is stated, or else the model's."""

    camera_info: str | None = None
    """ROS's camera_info, a YAML file beside head.toml."""
    fov_deg: Annotated[float, Field(gt=0, lt=179)] | None = None
    """Horizontal field of view, without distortion."""
    focal_mm: Annotated[float, Field(gt=0, le=1000)] | None = None
    """Focal length, for the size of the sensor that the model states."""
    model: CameraModel = "radial-tangential"
    distortion: tuple[float, ...] = ()
    """Coefficients in the order of `geometry.lens.COEFFICIENTS`; empty: none."""


class CameraFile(LensFile):
    """A camera of the model, or a link that is one."""

    eye: Side | None = None
    camera: Name | None = None
    """Its name in the model; None: its name here."""
    body: Name | None = None
    """Body or link that carries it, where the model has no such camera."""
    pos_m: Vector3 | None = None
    """Its place in that body; None: the origin."""
    forward: Vector3 | None = None
    """Direction in that body in which it looks; None: that of the head, with joints at zero."""
    up: Vector3 | None = None
    size: tuple[Pixels, Pixels] | None = None
    """Width and height of its images [px]."""


class LensChoice(LensFile):
    """A lens that may be put into some cameras."""

    cameras: tuple[Name, ...]


class JointFile(_Table):
    """A joint of the model, or one that is added to a body."""

    readings: dict[Name, float] = {}
    """Its angle is the sum of factor times reading; empty: as the model has it."""
    range_deg: tuple[float, float] | None = None
    speed_deg_s: Annotated[float, Field(gt=0)] | None = None
    body: Name | None = None
    """Body to which this joint is added; None: the model has the joint."""
    axis: Vector3 | None = None
    """Its axis in that body."""
    pos_m: Vector3 | None = None
    """A point on its axis in that body; None: the origin."""


class HeadFile(_Table):
    """Content of head.toml; `head_guess.completed` finds in the model what it leaves open."""

    model: Name
    """MJCF or URDF file, beside this one."""
    base: Name = ""
    """Body that is the head: joints beyond it move the cameras, those before it are the neck's."""
    forward: Vector3 | None = None
    """Direction in the base's frame in which the eyes look with every joint at zero."""
    up: Vector3 | None = None
    """Direction in the base's frame that is up."""
    cameras: dict[Name, CameraFile] = {}
    eyes: dict[Side, tuple[Name, ...]] = {}
    """By eye its joints, from the base outwards."""
    neck: tuple[Name, ...] | None = None
    """Joints of the neck, from the body outwards."""
    joints: dict[Name, JointFile] = {}
    lenses: dict[Name, LensChoice] = {}
    """Lenses to choose from by name, the first by default."""
    format: Literal["vergence-head-1"] = "vergence-head-1"


def models_folder() -> Path:
    """Find the folder of the models, in the installed package or in the checkout."""
    packaged = Path(str(resources.files("vergence"))) / "models"
    return packaged if packaged.is_dir() else Path(__file__).parents[3] / "models"


DEFAULT = "cbi_head"
"""Folder of the head that is used where no other is named."""


def load_head_file(path: Path | None = None) -> tuple[HeadFile, Path]:
    """Read a head.toml, and resolve the path of its model; None: that of the default head.

    Of a model itself, which has no .toml in its name, nothing is stated. Raises VergenceError if
    the file is missing or is not a head.toml.
    """
    path = models_folder() / DEFAULT / "head.toml" if path is None else path
    if path.suffix != ".toml":
        return HeadFile(model=path.name), path
    found = read_parsed(
        path,
        "a description of a head",
        lambda content: validated(content, HeadFile),
        tomllib.loads,
        most_bytes=2**18,
    )
    return found, path.parent / found.model
