"""Reading and writing other programs' files, and what can be checked for all of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import yaml

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.files import read_parsed, write_whole
from vergence.geometry.camera import Camera, check_image_fits
from vergence.geometry.head import HeadCalibration
from vergence.geometry.lens import COEFFICIENTS, CameraModel

T = TypeVar("T")

MAX_BYTES = 2**18
"""Largest file; a head in one of these formats has 10 kB."""
NEGLIGIBLE = 1e-9
"""Largest skew [px] or k3 that counts as zero; it moves a pixel by about as much."""


def camera_of(
    size: tuple[int, int], matrix: Array, model: CameraModel, coefficients: Sequence[float]
) -> Camera:
    """Make a camera from OpenCV's distortion coefficients; zeros at their end may be left out.

    ValueError for one to three of them, or for more than the lens model has.
    """
    k = np.trim_zeros(np.array(coefficients, dtype=float), "b")
    if model == "radial-tangential" and len(k) > len(COEFFICIENTS[model]):
        model = "rational"
    count = len(COEFFICIENTS[model])
    if len(k) > count or 0 < len(coefficients) < 4:
        raise ValueError(
            f"a {model} lens has {count} distortion coefficients, and 4 at least are stated; found "
            f"{len(coefficients)}"
        )
    distortion = np.pad(k, (0, count - len(k)))
    return Camera(width=size[0], height=size[1], matrix=matrix, distortion=distortion, model=model)


class _TextLoader(yaml.BaseLoader):
    """Reads every scalar as text: pydantic makes numbers of it, and tags have no effect."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):  # a few of them can stand for any amount of data
            raise ValueError("it has an alias, which these formats do not need")
        return super().compose_node(parent, index)


def read(path: Path, what: str, build: Callable[[Any], T]) -> T:
    """Read another program's YAML, all scalars as text; see `files.read_parsed`."""

    def parse(text: str) -> Any:
        try:
            return yaml.load(text, Loader=_TextLoader)
        except yaml.YAMLError as error:
            raise ValueError(str(error)) from None

    return read_parsed(path, what, build, parse, most_bytes=MAX_BYTES)


def with_intrinsics(head: HeadCalibration, cameras: Mapping[str, Camera]) -> HeadCalibration:
    """Replace intrinsics of some cameras of a head, and drop its accuracy.

    VergenceError if the head lacks a camera, or has one of another size.
    """
    for name, camera in cameras.items():
        check_image_fits(
            name, head.camera(name).intrinsics, camera.size[::-1], whose="those of the file"
        )
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
        k3 = lens.distortion[4] if lens.model == "radial-tangential" else 0.0
        if abs(skew) > NEGLIGIBLE:
            what = f"a skew of {skew:.3g} px"
        elif lens.model not in models:
            what = f"a {lens.model} lens"
        elif abs(k3) > NEGLIGIBLE and not has_k3:
            what = f"k3 = {k3:.3g}"
        else:
            continue
        raise VergenceError(
            f"{name} has {what}, for which {format} has no field; export to opencv or ros, "
            f"calibrate with --lens {' or '.join(models)}, or set it to 0 in the calibration."
        )
