"""Reading and writing other programs' files, and what can be checked for all of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import yaml
from pydantic import BaseModel, PlainValidator, PositiveInt

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.files import read_parsed, unique_keys, write_whole
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration
from vergence.geometry.lens import COEFFICIENTS, CameraModel

T = TypeVar("T")

MAX_BYTES = 2**18
"""Largest file; a head in one of these formats has 10 kB."""
NEGLIGIBLE = 1e-9
"""Largest skew [px] or k3 that counts as zero; it moves a pixel by about as much."""


def _matrix(value: Any) -> Array:
    try:
        rows, cols, data = int(value["rows"]), int(value["cols"]), value["data"]
        numbers = np.array(data.split() if isinstance(data, str) else data, dtype=float)
    except (LookupError, TypeError, ValueError, OverflowError):
        raise ValueError("expected a matrix of rows, cols and data") from None
    if not np.isfinite(numbers).all():
        raise ValueError("expected finite numbers, found NaN or infinity")
    if min(rows, cols) < 0 or numbers.shape != (rows * cols,):
        raise ValueError(f"a matrix of {rows} x {cols} has {numbers.size} numbers")
    return numbers.reshape(rows, cols)


Matrix = Annotated[Array, PlainValidator(_matrix)]
"""(rows, cols), written as a mapping with the keys rows, cols and data."""


class Intrinsics(BaseModel):
    """A camera with the field names that OpenCV's and ROS's files share."""

    image_width: PositiveInt
    image_height: PositiveInt
    camera_matrix: Matrix
    distortion_coefficients: Matrix

    def camera(self, model: CameraModel = "radial-tangential") -> Camera:
        """Make the camera; ValueError if it has skew, or coefficients of another lens model."""
        camera = Camera(
            width=self.image_width,
            height=self.image_height,
            matrix=self.camera_matrix,
            distortion=self.distortion_coefficients.ravel(),
            model=model,
        )
        if camera.matrix[0, 1] != 0:
            raise ValueError("camera_matrix is not [fx 0 cx; 0 fy cy; 0 0 1]")
        return camera


def intrinsics_fields(camera: Camera) -> dict[str, Any]:
    """Make the fields of Intrinsics, with matrices as arrays."""
    return {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_matrix": camera.matrix,
        "distortion_coefficients": camera.distortion[None],
    }


class _TextLoader(yaml.BaseLoader):
    """Reads every scalar as text: pydantic makes numbers of it, and tags have no effect."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):  # a few of them can stand for any amount of data
            raise ValueError("it has an alias, which these formats do not need")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        pairs = [
            (self.construct_object(key, deep=True), self.construct_object(value, deep=True))
            for key, value in node.value
        ]
        return unique_keys(pairs)


def parse_yaml(text: str) -> Any:
    """Parse YAML, all scalars as text; ValueError for aliases and repeated keys."""
    try:
        return yaml.load(text, Loader=_TextLoader)
    except yaml.YAMLError as error:
        raise ValueError(str(error)) from None


def read(
    path: Path, what: str, build: Callable[[Any], T], parse: Callable[[str], Any] = parse_yaml
) -> T:
    """Read another program's file; see `files.read_parsed`."""
    return read_parsed(path, what, build, parse, most_bytes=MAX_BYTES)


def with_intrinsics(head: HeadCalibration, cameras: Mapping[str, Camera]) -> HeadCalibration:
    """Replace intrinsics of some cameras of a head, and drop its accuracy.

    VergenceError if the head lacks a camera.
    """
    mounted = {name: replace(head.camera(name), intrinsics=c) for name, c in cameras.items()}
    return replace(head, cameras={**head.cameras, **mounted}, accuracy=None)


def write_yaml(path: Path, content: dict[str, Any]) -> None:
    """Write YAML with each list of numbers on one line; floats read back exactly."""
    text = yaml.safe_dump(content, default_flow_style=None, sort_keys=False, width=1000)
    write_whole(path, text)


def check_names(head: HeadCalibration) -> None:
    """Raise VergenceError if a camera's name has a dash, which other formats do not take."""
    for name in head.cameras:
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
            raise VergenceError(
                f"A camera is called {name!r}; other formats need names of letters, digits and _: "
                f"write {name.replace('-', '_')!r} wherever the calibration's file names it."
            )


def check_cameras(
    head: HeadCalibration,
    format: str,
    *,
    models: Collection[CameraModel] = tuple(COEFFICIENTS),
    has_k3: bool = True,
) -> None:
    """Raise VergenceError if a camera has a name, skew, lens model or k3 that a format cannot hold.

    A message calls it by `format`; `has_k3` is whether its radial-tangential model has a third
    radial coefficient.
    """
    check_names(head)
    for name, mounted in head.cameras.items():
        lens = mounted.intrinsics
        skew = lens.matrix[0, 1]
        if abs(skew) > NEGLIGIBLE:
            raise VergenceError(
                f"{name} has a skew of {skew:.3g} px, for which {format} has no field; set "
                f"cameras.{name}.intrinsics.matrix[0][1] to 0 in the calibration's file. "
                "`vergence calibrate` never estimates skew."
            )
        if lens.model not in models:
            raise VergenceError(
                f"{name} has a {lens.model} lens, which {format} cannot hold; export to opencv or "
                f"ros, or calibrate with --lens {' or '.join(models)}."
            )
        k3 = lens.distortion[4] if lens.model == "radial-tangential" else 0.0
        if abs(k3) > NEGLIGIBLE and not has_k3:
            raise VergenceError(
                f"{name} has k3 = {k3:.3g}, for which {format} has no field; export to opencv "
                "or ros, or calibrate with --lens radial-tangential, which has none."
            )
