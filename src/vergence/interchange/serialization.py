"""Reading and writing other programs' files, and what can be checked for all of them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import yaml
from pydantic import BaseModel, PlainValidator, PositiveInt

from vergence.arrays import Array
from vergence.errors import VergenceError, explain
from vergence.files import write_whole
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration

T = TypeVar("T")

NEGLIGIBLE = 1e-9
"""A skew [px] or a k3 below this counts as zero: it moves no pixel by more than about as much."""


def _matrix(value: Any) -> Array:
    try:
        rows, cols, data = int(value["rows"]), int(value["cols"]), value["data"]
        numbers = np.array(data.split() if isinstance(data, str) else data, dtype=float)
    except (LookupError, TypeError, ValueError, OverflowError):
        raise ValueError("expected a matrix of rows, cols and data") from None
    if numbers.shape != (rows * cols,):
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

    def camera(self) -> Camera:
        """Return the camera; ValueError if it has skew or is not a pinhole camera."""
        camera = Camera(
            width=self.image_width,
            height=self.image_height,
            matrix=self.camera_matrix,
            distortion=self.distortion_coefficients.ravel(),
        )
        if camera.matrix[0, 1] != 0:
            raise ValueError("camera_matrix is not [fx 0 cx; 0 fy cy; 0 0 1]")
        return camera


def intrinsics_fields(camera: Camera) -> dict[str, Any]:
    """Return the fields of Intrinsics, with matrices as arrays."""
    return {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_matrix": camera.matrix,
        "distortion_coefficients": camera.distortion[None],
    }


def read(
    path: Path, what: str, build: Callable[[Any], T], parse: Callable[[str], Any] = yaml.safe_load
) -> T:
    """Read a text file.

    Args:
        path: text in UTF-8.
        what: how a message calls such a file, with its article.
        build: makes the result from the parsed content; raises ValueError where that is not valid.
        parse: makes nested dictionaries and lists from the text.

    Raises:
        VergenceError: the file is missing, or is not what was expected.
    """
    try:
        return build(parse(path.read_text(encoding="utf-8-sig")))
    except OSError as error:
        raise VergenceError(f"Cannot read {path}: {error.strerror}.") from error
    # Parsers raise YAMLError, SyntaxError (XML), ValueError (JSON), the others on odd damage.
    except (
        yaml.YAMLError, SyntaxError, ValueError, TypeError, LookupError, RecursionError
    ) as error:  # fmt: skip
        raise VergenceError(f"{path} is not {what}: {explain(error)}.") from None


def with_intrinsics(head: HeadCalibration, cameras: Mapping[str, Camera]) -> HeadCalibration:
    """Return a head with intrinsics of some cameras replaced; VergenceError: it lacks one."""
    mounted = {name: replace(head.camera(name), intrinsics=c) for name, c in cameras.items()}
    return replace(head, cameras={**head.cameras, **mounted})


def write_yaml(path: Path, content: dict[str, Any]) -> None:
    """Write YAML with each list of numbers on one line; floats read back exactly."""
    text = yaml.safe_dump(content, default_flow_style=None, sort_keys=False, width=1000)
    write_whole(path, text)


def check_names(head: HeadCalibration) -> None:
    """Raise VergenceError if a head has no camera, or one whose name cannot be a file's."""
    if not head.cameras:
        raise VergenceError("The calibration has no camera to export.")
    for name in head.cameras:
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
            raise VergenceError(
                f"A camera is called {name!r}; other formats need names of letters, digits and _."
            )


def check_cameras(head: HeadCalibration, model: str, *, has_k3: bool = True) -> None:
    """Raise VergenceError if a camera has a name, skew or k3 that a camera model cannot hold.

    A message calls it by `model`; `has_k3` is whether it has a third radial coefficient.
    """
    check_names(head)
    for name, mounted in head.cameras.items():
        skew, k3 = mounted.intrinsics.matrix[0, 1], mounted.intrinsics.distortion[4]
        if abs(skew) > NEGLIGIBLE:
            raise VergenceError(
                f"{name} has a skew of {skew:.3g} px, for which {model} has no field; "
                "calibrate without skew to export it."
            )
        if abs(k3) > NEGLIGIBLE and not has_k3:
            raise VergenceError(
                f"{name} has k3 = {k3:.3g}, for which {model} has no field; export to opencv "
                "or ros, or calibrate without k3."
            )
