"""Error profiles: every imperfection of the twin, in one frozen configuration.

Error sources are in the hardware (`[mounting]`, `[axes]`, `[optics]`, `[image]`, `[joints]`) or in
the calibration procedure (`[calibration]`). Errors that are injected into a finished calibration
have a section of their own, `[by_hand]`. The profile gives standard deviations; random values are
drawn with the seed of the run.
"""

from __future__ import annotations

import tomllib
from importlib import resources
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from vergence.calibration.lenses import LensModel
from vergence.errors import VergenceError
from vergence.files import read_parsed, validated

StdDeg = Annotated[float, Field(ge=0, le=10)]
StdMm = Annotated[float, Field(ge=0, le=50)]
"""Standard deviations of heads that can be built."""
Degrees = Annotated[float, Field(ge=-45, le=45)]
Millimetres = Annotated[float, Field(ge=-100, le=100)]
Percent = Annotated[float, Field(ge=-50, le=50)]


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Mounting(_Section):
    """Mounting of the cameras in the as-built head, which calibration estimates."""

    rotation_deg: StdDeg = 0.0
    """Standard deviation of each camera's mounting, about each axis."""
    translation_mm: StdMm = 0.0
    """Standard deviation of each camera's mounting, along each axis."""
    base_rotation_deg: StdDeg = 0.0
    """Standard deviation of the right eye's base relative to the left eye's, about each axis."""
    base_translation_mm: StdMm = 0.0
    """Standard deviation of the right eye's rotation centre, along each axis."""
    baseline_mm: Annotated[float, Field(ge=20, le=300)] | None = None
    """Distance of the eyes' rotation centres; None: that of the model."""


class Axes(_Section):
    """Deviation of the eyes' axes from orthogonal and intersecting ones: left, right."""

    nonorthogonality_deg: tuple[Degrees, Degrees] = (0.0, 0.0)
    """Turn of the tilt axis about the eye's forward axis."""
    distance_mm: tuple[Millimetres, Millimetres] = (0.0, 0.0)
    """Distance of the tilt axis ahead of the pan axis."""


class Optics(_Section):
    """Lenses and sensors of the as-built head."""

    focal_percent: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Standard deviation of each camera's focal length, in percent of the nominal one."""
    principal_px: Annotated[float, Field(ge=0, le=100)] = 0.0
    """Standard deviation of each camera's principal point, along each axis."""
    distortion: bool = True
    """Whether the wide lenses distort."""


class Image(_Section):
    """Imperfections of the image sensor."""

    noise_grey: Annotated[float, Field(ge=0, le=50)] = 0.0
    """Standard deviation of white noise in each pixel and colour [grey levels]."""
    blur_px: Annotated[float, Field(ge=0, le=5)] = 0.0
    """Standard deviation of a Gaussian blur [px]."""


class Joints(_Section):
    """The joint sensors: reading = gain * (angle a delay ago, plus backlash) + offset + noise.

    All of it is in terms of the joint: where motors are read before a gear, their readings have
    errors that are as much larger as the motor turns farther.

    Four numbers are those of left pan, left tilt, right pan, right tilt.
    """

    noise_deg: StdDeg = 0.0
    """Standard deviation of white noise in each reading."""
    counts_per_turn: Annotated[int, Field(ge=0, le=2**32)] = 0
    """Steps of the encoder in a full turn; 0: no quantisation."""
    gain_percent: tuple[Percent, Percent, Percent, Percent] = (0.0, 0.0, 0.0, 0.0)
    """Scale error of each reading."""
    offset_deg: tuple[Degrees, Degrees, Degrees, Degrees] = (0.0, 0.0, 0.0, 0.0)
    """Constant error of each reading."""
    backlash_deg: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Width of the play between the sensor and the eye."""
    delay_ms: Annotated[float, Field(ge=-200, le=200)] = 0.0
    """Age of the reading when the image is taken; negative: the image is the older one."""


class CalibrationProcedure(_Section):
    """Errors in the calibration procedure."""

    wide_lens: LensModel = "radial-tangential"
    """Distortion model with which the wide cameras are calibrated."""
    square_percent: Annotated[float, Field(gt=-50, lt=50, allow_inf_nan=False)] = 0.0
    """Excess of the printed squares over the size given to the calibration."""


class ByHand(_Section):
    """Errors injected into the finished calibration, each for both eyes.

    T_rbase_lbase is recomputed by Eq. 10, so that straight gaze stays exact, as on a robot.
    """

    focal_percent_28: Percent = 0.0
    """Error of the focal length of the 2.8 mm lenses."""
    focal_percent_40: Percent = 0.0
    """Error of the focal length of the 4.0 mm lenses."""
    roll_deg: Degrees = 0.0
    """Rotation of the mounting about the optical axis: + in the left eye, - in the right."""
    axial_mm: Millimetres = 0.0
    """Shift of the mounting along the optical axis."""


class Fitted(_Section):
    """One parameter of the profile that was fitted to the paper's figures."""

    name: str
    value: float
    unit: str
    meaning: str
    how: str


class ErrorProfile(_Section):
    """All imperfections; the default profile has none."""

    name: str = "none"
    description: str = ""
    mounting: Mounting = Mounting()
    axes: Axes = Axes()
    optics: Optics = Optics()
    image: Image = Image()
    joints: Joints = Joints()
    calibration: CalibrationProcedure = CalibrationProcedure()
    by_hand: ByHand = ByHand()
    fitted: tuple[Fitted, ...] = ()


def shipped() -> list[str]:
    """List the profiles in the package."""
    folder = resources.files("vergence.twin") / "profiles"
    return sorted(p.name.removesuffix(".toml") for p in folder.iterdir())


def load_profile(name_or_file: str) -> ErrorProfile:
    """Read a shipped profile by its name, or a TOML file; VergenceError if it is not a profile."""
    if name_or_file in shipped():
        shipped_file = resources.files("vergence.twin") / "profiles" / f"{name_or_file}.toml"
        return ErrorProfile.model_validate(tomllib.loads(shipped_file.read_text(encoding="utf-8")))
    if not name_or_file.endswith(".toml"):
        raise VergenceError(
            f"No error profile is called {name_or_file!r}; there are {', '.join(shipped())}, "
            "and files that end in .toml."
        )
    return read_parsed(
        Path(name_or_file),
        "an error profile",
        lambda content: validated(content, ErrorProfile),
        tomllib.loads,
        most_bytes=2**14,  # those that are shipped have at most 2 kB
    )
