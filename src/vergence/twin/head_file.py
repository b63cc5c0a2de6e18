"""`head.toml`: how an MJCF or a URDF is a head with eyes.

It lies beside the model and states only what the model does not: `docs/own_head.md` has examples.
Names are those of the model. Lengths are in metres; angles in degrees, as their names say.
"""

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
    """A lens: camera_info, a field of view or a focal length, the first that is stated; else the
    model's."""

    fov_deg: Annotated[float, Field(gt=0, lt=179)] | None = None
    """Horizontal field of view, without distortion."""
    focal_mm: Annotated[float, Field(gt=0, le=1000)] | None = None
    """Focal length, for the size of the sensor that the model states."""
    camera_info: str | None = None
    """ROS's camera_info, a YAML file beside head.toml."""
    model: CameraModel = "radial-tangential"
    """Of the distortion below."""
    distortion: tuple[float, ...] = ()
    """Coefficients in the order of `geometry.lens.COEFFICIENTS`; empty: none."""


class CameraFile(LensFile):
    """A camera; by default a camera of this name in the model, with its place and lens there."""

    eye: Side | None = None
    """Eye that carries it; default: by its place to the left or right of the others, and the left
    one for a single camera."""
    camera: Name | None = None
    """Its name in the model; default: its name here."""
    body: Name | None = None
    """Body or link that carries it, where the model has no such camera."""
    pos_m: Vector3 | None = None
    """Its place in that body; default: the origin."""
    forward: Vector3 | None = None
    """Direction in that body in which it looks; default: that of the head, with every joint at
    zero."""
    up: Vector3 | None = None
    """Direction in that body that is up in its image; default: that of the head."""
    size: tuple[Pixels, Pixels] | None = None
    """Width and height of its images [px]; default: the model's, or 640 x 480."""


class LensChoice(LensFile):
    """A lens that may be put into some cameras."""

    cameras: tuple[Name, ...]


class JointFile(_Table):
    """A joint of the model; by default it has a reading of its own name, and the model's limits."""

    readings: dict[Name, float] | None = None
    """Its angle is the sum of factor times reading; default: the joint's own name, times one, or
    the joint that it mimics in the model."""
    range_deg: tuple[float, float] | None = None
    speed_deg_s: Annotated[float, Field(gt=0)] | None = None
    body: Name | None = None
    """Body to which this joint is added; None: the model has the joint."""
    axis: Vector3 | None = None
    """Its axis in that body."""
    pos_m: Vector3 | None = None
    """A point on its axis in that body; default: the origin."""


class HeadFile(_Table):
    """Content of head.toml."""

    model: Name
    """MJCF or URDF file, beside this one."""
    base: Name | None = None
    """Body that is the head: the joints beyond it move the cameras, those before it are the neck's.
    Default: the body before the joints of the eyes."""
    forward: Vector3 | None = None
    """Direction in the base's frame in which the eyes look with every joint at zero; default: the
    mean of the cameras'."""
    up: Vector3 | None = None
    """Direction in the base's frame that is up; default: the mean of the images'."""
    cameras: dict[Name, CameraFile] = {}
    """By name; default: all cameras of the model that a joint moves."""
    eyes: dict[Side, tuple[Name, ...]] = {}
    """By eye its joints, from the base outwards; default: the hinges between base and cameras."""
    neck: tuple[Name, ...] | None = None
    """Joints of the neck, from the body outwards; default: up to three hinges before the base. All
    others stand still, at the model's keyframe "home" or at zero."""
    joints: dict[Name, JointFile] = {}
    """By the joint's name."""
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
