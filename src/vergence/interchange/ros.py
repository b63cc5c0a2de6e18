"""ROS's camera_info YAML, one file per camera, as camera_calibration_parsers reads and writes them.

What is read are intrinsics; where a camera sits in the head is not part of the format.
"""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from pydantic import BaseModel, Field, FiniteFloat, PositiveInt

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.files import results_folder
from vergence.geometry.camera import Camera
from vergence.geometry.head import MAX_CAMERAS, HeadCalibration, main_pair
from vergence.geometry.lens import CameraModel
from vergence.interchange.serialization import camera_of, check_cameras, read, write_yaml
from vergence.stereo.extrinsics import relative_camera_pose

DISTORTION_MODELS: dict[CameraModel, str] = {
    "radial-tangential": "plumb_bob",
    "rational": "rational_polynomial",
    "fisheye": "equidistant",
}
"""ROS's names of the lens models, from sensor_msgs/distortion_models.h."""
LENS_MODELS: dict[str, CameraModel] = {name: model for model, name in DISTORTION_MODELS.items()}


class _Matrix(BaseModel):
    data: list[FiniteFloat]


class _CameraInfo(BaseModel):
    """Fields that are read; rectification and projection follow from them."""

    camera_name: Annotated[str, Field(min_length=1)]
    distortion_model: Literal["plumb_bob", "rational_polynomial", "equidistant"]
    image_width: PositiveInt
    image_height: PositiveInt
    camera_matrix: _Matrix
    distortion_coefficients: _Matrix


def save(head: HeadCalibration, folder: Path, at: Array | None = None) -> None:
    """Write <camera>.yaml for every camera into a folder.

    The main cameras are rectified at readings (r,) [rad]; None: only cameras that stand still are.
    VergenceError if a camera has skew, or the folder cannot be written.
    """
    check_cameras(head, "ROS's camera_info")
    if not head.kinematics.readings:
        at = np.zeros(0)
    rectified = {} if at is None else _rectified(head, at)
    with results_folder(folder):
        for name, mounted in head.cameras.items():
            lens = mounted.intrinsics
            content = {
                "image_width": lens.width,
                "image_height": lens.height,
                "camera_name": name,
                "camera_matrix": lens.matrix,
                "distortion_model": DISTORTION_MODELS[lens.model],
                "distortion_coefficients": lens.distortion[None],
                "rectification_matrix": np.eye(3),
                "projection_matrix": np.pad(lens.matrix, ((0, 0), (0, 1))),
                **rectified.get(name, {}),
            }
            plain = {key: _plain(value) for key, value in content.items()}
            write_yaml(folder / file_name(name), plain)


def _rectified(head: HeadCalibration, at: Array) -> dict[str, dict[str, Any]]:
    """Compute R and P of the main cameras as ROS's calibrator does; empty for a head of one eye."""
    pair = main_pair(head)
    if pair is None:
        return {}
    lenses = [head.cameras[name].intrinsics for name in pair]
    if (fisheye := lenses[0].model == "fisheye") != (lenses[1].model == "fisheye"):
        raise VergenceError(f"OpenCV rectifies no fisheye lens with another: {' and '.join(pair)}.")
    T = relative_camera_pose(head, at, cameras=pair)
    K, D = ([getattr(lens, name) for lens in lenses] for name in ("matrix", "distortion"))
    shown = K[0], D[0], K[1], D[1], lenses[0].size, T[:3, :3], T[:3, 3:].copy()
    rectify = cv2.fisheye.stereoRectify if fisheye else partial(cv2.stereoRectify, alpha=0)
    found = rectify(*shown, flags=cv2.CALIB_ZERO_DISPARITY)
    fields = "rectification_matrix", "projection_matrix"
    return {name: dict(zip(fields, found[k:4:2], strict=True)) for k, name in enumerate(pair)}


def file_name(camera: str) -> str:
    """Name the file of a camera."""
    return f"{camera}.yaml"


def _plain(value: Any) -> Any:
    """Convert a matrix to a mapping with the keys rows, cols and data."""
    if not isinstance(value, np.ndarray):
        return value
    return {"rows": value.shape[0], "cols": value.shape[1], "data": value.ravel().tolist()}


def load(path: Path) -> dict[str, Camera]:
    """Read a camera_info file, or all *.yaml files of a folder; cameras by their camera_name.

    VergenceError if a file is missing or not a camera_info, or two have one name.
    """
    found = files(path)
    if not 1 <= len(found) <= MAX_CAMERAS:
        raise VergenceError(
            f"{path} has {len(found)} *.yaml files; expected one for each of 1 to {MAX_CAMERAS} "
            "cameras."
        )
    cameras: dict[str, Camera] = {}
    for file in found:
        name, camera = read(file, "a camera_info", _named_camera)
        if name in cameras:
            raise VergenceError(f"{file}: another file also describes {name}.")
        cameras[name] = camera
    return cameras


def files(path: Path) -> list[Path]:
    """List the files to read: all *.yaml files of a folder, or the file."""
    return sorted(path.glob("*.yaml")) if os.path.isdir(path) else [path]


def _named_camera(content: Any) -> tuple[str, Camera]:
    info = _CameraInfo.model_validate(content)
    size, model = (info.image_width, info.image_height), LENS_MODELS[info.distortion_model]
    matrix = np.reshape(info.camera_matrix.data, (3, 3))
    if matrix[0, 1] != 0:
        raise ValueError("camera_matrix is not [fx 0 cx; 0 fy cy; 0 0 1]")
    camera = camera_of(size, matrix, model, info.distortion_coefficients.data)
    return info.camera_name.replace("/", "_"), camera
