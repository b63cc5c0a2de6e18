"""Settings of a sweep over designs of a head: values to try, the workspace, and prices.

They come from options of the command, or from a TOML or JSON file: docs/design_and_plan.md.
"""

from __future__ import annotations

import itertools
import math
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from vergence.arrays import Array
from vergence.errors import VergenceError, explain
from vergence.files import parse_json, read_parsed, validated
from vergence.geometry.camera import ImageSide

MAX_DESIGNS = 50_000_000
"""Maximum number of designs of a sweep: their errors take 400 MB for each distance."""


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _Range(_Section):
    first: float
    last: float
    steps: Annotated[int, Field(ge=1, le=1000)]


def _values(value: Any) -> Any:
    """Expand a number or a range {first, last, steps} into values."""
    if isinstance(value, dict):
        each = _Range.model_validate(value)
        return tuple(np.linspace(each.first, each.last, each.steps).tolist())
    if isinstance(value, int | float):
        return (value,)
    return value


def _within(low: float, high: float) -> AfterValidator:
    """Make a validator that raises ValueError for values out of bounds."""

    def check(values: tuple[float, ...]) -> tuple[float, ...]:
        if wrong := [value for value in values if not low <= value <= high]:
            raise ValueError(f"values are from {low:,.12g} to {high:,.12g}, found {wrong[0]:,.12g}")
        return values

    return AfterValidator(check)


Values = Annotated[
    tuple[float, ...], BeforeValidator(_values), Field(min_length=1, max_length=1000)
]


class Designs(_Section):
    """Values of each property of a head; all combinations are tried."""

    baseline_mm: Annotated[Values, _within(10, 1000)] = (60.0, 70.0, 80.0, 90.0, 100.0)
    """Distance of the eyes."""
    focal_px: Annotated[Values, _within(50, 10_000)] = (250.0, 350.0, 450.0, 550.0, 650.0)
    """Focal length of the cameras that locate points."""
    square_mm: Annotated[Values, _within(1, 500)] = (20.0, 30.0)
    """Side of a square of the calibration board."""
    views: Annotated[Values, _within(5, 10_000)] = (20.0, 40.0, 80.0)
    """Views of the board by both eyes that are calibrated with."""
    counts_per_turn: Annotated[Values, _within(0, 2**32)] = (4096.0, 16384.0, 65536.0)
    """Resolution of the encoders; 0: no steps."""
    joint_noise_deg: Annotated[Values, _within(0, 5)] = (0.01, 0.03, 0.1)
    """Noise of a joint reading, in addition to its steps."""
    pixel_noise_px: Annotated[Values, _within(0.001, 20)] = (0.1, 0.25, 0.5)
    """Noise of one coordinate of a point in an image."""
    delay_ms: Annotated[Values, _within(0, 1000)] = (0.0, 1.0, 5.0)
    """Error of the time between an image and its joint reading."""


AXES = tuple(Designs.model_fields)
"""Names of the properties, in the order of arrays of designs."""
CHUNK_AXES = ("baseline_mm", "focal_px", "square_mm")
"""Properties whose combinations are chunks of a sweep; others are computed at once."""


_Off = Annotated[float, Field(ge=-90, le=90)]


class Workspace(_Section):
    """Points that are located, and how the eyes look at them."""

    distances_m: Annotated[Values, _within(0.05, 100)] = (0.3, 0.4, 0.5, 0.7, 1.0, 1.5, 2.0)
    """Distances of points from the middle between the eyes."""
    pan_deg: Annotated[Values, _within(-60, 60)] = (-20.0, -10.0, 0.0, 10.0, 20.0)
    """Directions of points to the side."""
    tilt_deg: Annotated[Values, _within(-60, 60)] = (-15.0, 0.0, 15.0)
    """Directions of points downwards."""
    off_deg: Annotated[tuple[tuple[_Off, _Off], ...], Field(min_length=1, max_length=1000)] = (
        (0.0, 0.0),
        (8.0, 0.0),
        (-8.0, 0.0),
        (0.0, 6.0),
        (0.0, -6.0),
    )
    """Postures: pan and tilt by which both eyes look past a point."""
    eye_speed_deg_s: Annotated[float, Field(ge=0, le=5000)] = 30.0
    """Root mean square speed of each joint, for the delay."""
    eye_correlation: Annotated[float, Field(ge=-1, le=1)] = 0.0
    """Correlation of the two eyes' speeds: 1 when they turn together, -1 when opposite."""
    camera_ahead_mm: Annotated[float, Field(ge=-200, le=200)] = 20.0
    """Distance of a camera ahead of its eye's rotation centre."""
    image_px: tuple[ImageSide, ImageSide] = (640, 480)
    """Width and height of the images."""
    board: tuple[Annotated[int, Field(ge=3, le=100)], Annotated[int, Field(ge=3, le=100)]] = (9, 6)
    """Inner corners of the board in a row and in a column."""
    corner_noise_px: Annotated[float, Field(gt=0, le=10)] = 0.1
    """Noise of one coordinate of a corner of the board, smaller than that of an object."""


Price = Annotated[tuple[tuple[float, float], ...], Field(min_length=1)]
"""Pairs of a value and its price, interpolated in between and constant beyond the ends."""


class Prices(_Section):
    """Prices of a value of each property, in any unit; a head costs the sum.

    The defaults are rough estimates, in hundredths of a plain machine-vision camera.
    """

    baseline_mm: Price = ((60, 0), (120, 60))
    focal_px: Price = ((250, 0), (650, 60))
    square_mm: Price = ((20, 5), (30, 10))
    views: Price = ((0, 0), (100, 100))
    counts_per_turn: Price = ((4096, 40), (16384, 120), (65536, 300))
    joint_noise_deg: Price = ((0.01, 200), (0.03, 80), (0.1, 0))
    pixel_noise_px: Price = ((0.1, 80), (0.25, 20), (0.5, 0))
    delay_ms: Price = ((0, 120), (1, 60), (5, 0))


class DesignSettings(_Section):
    """Settings of a sweep."""

    designs: Designs = Designs()
    workspace: Workspace = Workspace()
    prices: Prices = Prices()

    @model_validator(mode="after")
    def _not_too_many(self) -> DesignSettings:
        count = math.prod(len(getattr(self.designs, name)) for name in AXES)
        if count > MAX_DESIGNS:
            raise ValueError(f"these are {count:,} designs; at most {MAX_DESIGNS:,} are tried")
        return self


def costs(settings: DesignSettings) -> Array:
    """Compute the cost of each design, with one dimension for each of AXES."""
    of_axes = []
    for name in AXES:
        values, prices = np.array(sorted(getattr(settings.prices, name)), float).T
        of_axes.append(np.interp(getattr(settings.designs, name), values, prices))
    return sum(np.meshgrid(*of_axes, indexing="ij", sparse=True), np.zeros(()))


def chunks(settings: DesignSettings) -> Iterator[DesignSettings]:
    """Yield the settings of each chunk of a sweep, in the order of CHUNK_AXES, without prices."""
    designs = settings.designs
    for values in itertools.product(*(getattr(designs, name) for name in CHUNK_AXES)):
        own = {name: (value,) for name, value in zip(CHUNK_AXES, values, strict=True)}
        yield DesignSettings(designs=designs.model_copy(update=own), workspace=settings.workspace)


def load_settings(path: Path) -> DesignSettings:
    """Read settings from a .json file, or else a TOML file.

    Raises VergenceError if it is invalid.
    """
    parse = parse_json if path.suffix.lower() == ".json" else tomllib.loads
    what = "a description of designs (see docs/design_and_plan.md)"
    return read_parsed(
        path,
        what,
        lambda content: validated(content, DesignSettings),
        parse,
        most_bytes=2**16,  # a file that is written by hand
    )


def merged_settings(
    path: Path | None, axes: dict[str, tuple[float, ...]], *, at_m: float
) -> DesignSettings:
    """Replace axes of the settings in a file, or of the default ones; add a distance `at_m`.

    VergenceError for a file or a value that is not possible.
    """
    chosen = (DesignSettings() if path is None else load_settings(path)).model_dump()
    chosen["designs"] |= axes
    distances = chosen["workspace"]["distances_m"]
    if at_m not in distances:
        chosen["workspace"]["distances_m"] = (*distances, at_m)
    try:
        return DesignSettings.model_validate(chosen)
    except ValidationError as error:
        raise VergenceError(f"These designs cannot be compared: {explain(error)}.") from None
