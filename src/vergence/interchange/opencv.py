"""OpenCV's FileStorage (.yml, .yaml, .xml or .json): all of a head, matrices as cv::Mat.

cameras:  by name  eye, image_width, image_height, camera_matrix (3x3),
                   distortion_coefficients (1x5: k1 k2 p1 p2 k3), T_eye_cam (4x4)
T_rbase_lbase (4x4)
axes:     left, right: the numbers of kinematics.EyeAxes
neck:     axes (nx3), points_m (nx3), head_m (1x3)
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from pydantic import TypeAdapter, ValidationError

from vergence.errors import VergenceError
from vergence.head import HeadCalibration
from vergence.interchange.limits import check_names, refuse_skew
from vergence.interchange.yaml_files import first_message
from vergence.kinematics import EYES, EyeAxes

SUFFIXES = (".yml", ".yaml", ".xml", ".json")
FORMAT = "vergence-head-opencv-1"
_ADAPTER = TypeAdapter(HeadCalibration)


def save(head: HeadCalibration, path: Path) -> None:
    """Write a head with cv2.FileStorage.

    Raises:
        VergenceError: a camera has skew, which OpenCV's functions ignore; the file's ending is
            none of SUFFIXES; or it cannot be written.
    """
    check_names(head)
    refuse_skew(head, "OpenCV's camera model")
    _check_suffix(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(
            dir=path.parent, prefix=f".{path.name}.", suffix=path.suffix
        )
        os.close(handle)
        try:
            _write(head, name)
            os.chmod(name, 0o644)  # mkstemp's files are private
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise
    except OSError as error:
        raise VergenceError(f"Cannot write {path}: {error.strerror}.") from error


def _check_suffix(path: Path) -> None:
    if path.suffix not in SUFFIXES:
        raise VergenceError(
            f"OpenCV chooses the format by the file's ending, one of {', '.join(SUFFIXES)}; found "
            f"{path.name!r}."
        )


def _write(head: HeadCalibration, name: str) -> None:
    storage = cv2.FileStorage(name, cv2.FILE_STORAGE_WRITE)

    @contextmanager
    def struct(key: str) -> Iterator[None]:
        storage.startWriteStruct(key, cv2.FileNode_MAP)
        yield
        storage.endWriteStruct()

    storage.write("format", FORMAT)
    with struct("cameras"):
        for camera_name, mounted in head.cameras.items():
            camera = mounted.intrinsics
            with struct(camera_name):
                storage.write("eye", mounted.eye)
                storage.write("image_width", camera.width)
                storage.write("image_height", camera.height)
                storage.write("camera_matrix", camera.matrix)
                storage.write("distortion_coefficients", camera.distortion[None])
                storage.write("T_eye_cam", mounted.T_eye_cam)
    storage.write("T_rbase_lbase", head.T_rbase_lbase)
    with struct("axes"):
        for eye, axes in head.axes.items():
            with struct(eye):
                for key, value in asdict(axes).items():
                    storage.write(key, float(value))
    with struct("neck"):
        storage.write("axes", head.neck.axes)
        storage.write("points_m", head.neck.points_m)
        storage.write("head_m", head.neck.head_m[None])
    storage.release()


def load(path: Path) -> HeadCalibration:
    """Read a head that `save` wrote, or somebody else in the same form.

    Raises:
        VergenceError: the file is missing, OpenCV cannot read it, or a field is not valid.
    """
    _check_suffix(path)
    if not path.is_file():
        raise VergenceError(f"There is no file {path}.")
    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        content = _content(storage)
        storage.release()
        if not content["cameras"]:
            raise VergenceError(f"{path} has no cameras.")
        return _ADAPTER.validate_python(content)
    except ValidationError as error:
        where = ".".join(map(str, error.errors()[0]["loc"])) or "the file"
        raise VergenceError(f"{path}: {where}: {first_message(error)}.") from None
    except (cv2.error, SystemError, ValueError, OverflowError):  # OpenCV, at broken files
        raise VergenceError(f"{path} is not a file that OpenCV's FileStorage can read.") from None


def _content(storage: cv2.FileStorage) -> dict[str, Any]:
    cameras = {}
    listed = storage.getNode("cameras")
    for name in listed.keys() if listed.isMap() else ():
        node = listed.getNode(name)
        cameras[name] = {
            "eye": node.getNode("eye").string(),
            "intrinsics": {
                "width": int(node.getNode("image_width").real()),
                "height": int(node.getNode("image_height").real()),
                "matrix": _mat(node, "camera_matrix"),
                "distortion": np.ravel(_mat(node, "distortion_coefficients")),
            },
            "T_eye_cam": _mat(node, "T_eye_cam"),
        }
    content: dict[str, Any] = {"cameras": cameras, "T_rbase_lbase": _mat(storage, "T_rbase_lbase")}
    axes = storage.getNode("axes")
    if not axes.isNone():
        keys = [field.name for field in fields(EyeAxes)]
        content["axes"] = {
            eye: {key: _number(axes.getNode(eye), key) for key in keys} for eye in EYES
        }
    neck = storage.getNode("neck")
    if not neck.isNone():
        content["neck"] = {
            "axes": _mat(neck, "axes"),
            "points_m": _mat(neck, "points_m"),
            "head_m": np.ravel(_mat(neck, "head_m")),
        }
    return content


def _number(parent: Any, key: str) -> float | None:
    node = parent.getNode(key)
    return None if node.isNone() else node.real()


def _mat(parent: Any, key: str) -> Any:
    """Return a matrix; [] where there is none, or an empty one."""
    node = parent.getNode(key)
    matrix = None if node.isNone() else node.mat()
    return [] if matrix is None else matrix
