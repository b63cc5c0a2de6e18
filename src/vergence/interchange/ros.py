"""ROS's camera_info YAML, one file a camera, as camera_calibration_parsers reads and writes them.

A file says nothing of where its camera sits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PositiveInt, TypeAdapter

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration
from vergence.interchange.limits import check_names, pinhole_matrix, refuse_skew
from vergence.interchange.yaml_files import Number, dump, first_message, read


class _Matrix(BaseModel):
    rows: PositiveInt
    cols: PositiveInt
    data: list[Number]


class _CameraInfo(BaseModel):
    model_config = ConfigDict(extra="ignore")  # rectification and projection follow from the rest

    image_width: PositiveInt
    image_height: PositiveInt
    camera_name: Annotated[str, Field(min_length=1)]
    camera_matrix: _Matrix
    distortion_model: Literal["plumb_bob"]
    distortion_coefficients: _Matrix


_ADAPTER = TypeAdapter(_CameraInfo)


def save(head: HeadCalibration, folder: Path) -> None:
    """Write <camera>.yaml for every camera into a folder.

    Each camera stands for itself: it is not rectified, and its projection is its own matrix.

    Raises:
        VergenceError: a camera has skew, or the folder cannot be written.
    """
    check_names(head)
    refuse_skew(head, "ROS's plumb_bob model")
    if folder.is_file():
        raise VergenceError(f"{folder} is a file; camera_info is one file a camera, in a folder.")
    for name, mounted in head.cameras.items():
        camera = mounted.intrinsics
        projection = np.concatenate([camera.matrix, np.zeros((3, 1))], axis=1)
        content = {
            "image_width": camera.width,
            "image_height": camera.height,
            "camera_name": name,
            "camera_matrix": _matrix(camera.matrix),
            "distortion_model": "plumb_bob",
            "distortion_coefficients": _matrix(camera.distortion[None]),
            "rectification_matrix": _matrix(np.eye(3)),
            "projection_matrix": _matrix(projection),
        }
        dump(folder / f"{name}.yaml", content)


def _matrix(values: Array) -> dict[str, object]:
    return {"rows": values.shape[0], "cols": values.shape[1], "data": values.ravel().tolist()}


def load(path: Path) -> dict[str, Camera]:
    """Read a camera_info file, or all *.yaml files of a folder; cameras by their camera_name.

    Raises:
        VergenceError: there is no such file, it is not a camera_info, or two have one name.
    """
    files = sorted(path.glob("*.yaml")) if path.is_dir() else [path]
    if not files:
        raise VergenceError(f"There is no *.yaml file in {path}.")
    cameras: dict[str, Camera] = {}
    for file in files:
        info = read(file, _ADAPTER, "a camera_info")
        if info.camera_name in cameras:
            raise VergenceError(f"{file}: another file is of {info.camera_name} too.")
        cameras[info.camera_name] = _camera(file, info)
    return cameras


def _camera(file: Path, info: _CameraInfo) -> Camera:
    for name, shape in (("camera_matrix", (3, 3)), ("distortion_coefficients", (1, 5))):
        found: _Matrix = getattr(info, name)
        if (found.rows, found.cols) != shape or len(found.data) != shape[0] * shape[1]:
            raise VergenceError(
                f"{file}: {name} is {found.rows} x {found.cols} with {len(found.data)} numbers; "
                f"expected {shape[0]} x {shape[1]}."
            )
    matrix = np.reshape(info.camera_matrix.data, (3, 3))
    if (matrix != pinhole_matrix(*matrix[[0, 1, 0, 1], [0, 1, 2, 2]])).any():
        raise VergenceError(f"{file}: camera_matrix is not [fx 0 cx; 0 fy cy; 0 0 1].")
    try:
        return Camera(
            width=info.image_width,
            height=info.image_height,
            matrix=matrix,
            distortion=np.array(info.distortion_coefficients.data),
        )
    except ValueError as error:
        raise VergenceError(f"{file}: {first_message(error)}.") from None


def into_head(cameras: Mapping[str, Camera], start: HeadCalibration) -> HeadCalibration:
    """Return a head with these intrinsics, and all else from the start.

    Raises:
        VergenceError: one is named that the head has not.
    """
    mounted = {name: replace(start.camera(name), intrinsics=c) for name, c in cameras.items()}
    return replace(start, cameras={**start.cameras, **mounted})
