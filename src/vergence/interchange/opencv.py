"""OpenCV's FileStorage (.yml, .yaml, .xml or .json): all of a head, matrices as cv::Mat.

cameras:  by name  eye, image_width, image_height, camera_matrix (3x3),
                   distortion_coefficients (1x5: k1 k2 p1 p2 k3), T_eye_cam (4x4)
T_rbase_lbase (4x4)
axes:     left, right: the numbers of kinematics.EyeAxes
neck:     axes (nx3), points_m (nx3), head_m (1x3)
"""

from __future__ import annotations

import json
import os
import re
import tempfile
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import yaml
from pydantic import TypeAdapter, ValidationError

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES, EyeAxes
from vergence.interchange.limits import check_names, refuse_skew
from vergence.interchange.yaml_files import first_message

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

    Not with cv2.FileStorage, whose parser now and then ends the whole process at a damaged file.

    Raises:
        VergenceError: the file is missing, cannot be read, or a field is not valid.
    """
    _check_suffix(path)
    readers = {".xml": _from_xml, ".json": json.loads}
    try:
        text = path.read_text(encoding="utf-8-sig")
        content = readers.get(path.suffix, _from_yaml)(text)
        return _ADAPTER.validate_python(_arranged(content))
    except OSError as error:
        raise VergenceError(f"Cannot read {path}: {error.strerror}.") from error
    except ValidationError as error:
        where = ".".join(map(str, error.errors()[0]["loc"])) or "the file"
        raise VergenceError(f"{path}: {where}: {first_message(error)}.") from None
    except KeyError as error:
        raise VergenceError(f"{path}: {error.args[0]} is missing.") from None
    except (yaml.YAMLError, ElementTree.ParseError, ValueError, TypeError, RecursionError) as error:
        reason = " ".join(str(error).split()).rstrip(".")
        raise VergenceError(f"{path} is not a file of OpenCV's FileStorage: {reason}.") from None


class _Loader(yaml.SafeLoader):
    """Knows OpenCV's matrices, as plain mappings."""


def _matrix(loader: yaml.SafeLoader, node: yaml.Node) -> dict[Hashable, Any]:
    if not isinstance(node, yaml.MappingNode):
        raise ValueError("an opencv-matrix is not a mapping")
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _matrix)


def _from_yaml(text: str) -> Any:
    # OpenCV 4 begins with %YAML:1.0, which is not quite YAML.
    return yaml.load(re.sub(r"\A%YAML[^\n]*", "", text), Loader=_Loader)


def _from_xml(text: str) -> Any:
    def value(element: ElementTree.Element) -> Any:
        if len(element):
            return {child.tag: value(child) for child in element}
        return (element.text or "").strip().strip('"')

    return value(ElementTree.fromstring(text))


def _arranged(content: Any) -> dict[str, Any]:
    """Return what HeadCalibration is validated from."""
    cameras = {}
    for name, camera in _mapping(content, "cameras").items():
        cameras[name] = {
            "eye": camera["eye"],
            "intrinsics": {
                "width": camera["image_width"],
                "height": camera["image_height"],
                "matrix": _mat(camera, "camera_matrix"),
                "distortion": _mat(camera, "distortion_coefficients").ravel(),
            },
            "T_eye_cam": _mat(camera, "T_eye_cam"),
        }
    if not cameras:
        raise ValueError("it has no cameras")
    neck = _mapping(content, "neck")
    return {
        "cameras": cameras,
        "T_rbase_lbase": _mat(content, "T_rbase_lbase"),
        "axes": {
            eye: {field.name: _mapping(axes, eye)[field.name] for field in fields(EyeAxes)}
            for axes in [_mapping(content, "axes")]
            for eye in EYES
        },
        "neck": {
            "axes": _mat(neck, "axes"),
            "points_m": _mat(neck, "points_m"),
            "head_m": _mat(neck, "head_m").ravel(),
        },
    }


def _mapping(parent: Any, key: str) -> dict[str, Any]:
    found = parent[key]
    if not isinstance(found, dict):
        raise ValueError(f"{key} is not a mapping")
    return found


def _mat(parent: Any, key: str) -> Array:
    """Return a matrix (rows, cols)."""
    matrix = _mapping(parent, key)
    rows, cols, data = int(matrix["rows"]), int(matrix["cols"]), matrix["data"]
    numbers = np.array(data.split() if isinstance(data, str) else data, dtype=float)
    if numbers.shape != (rows * cols,):
        raise ValueError(f"{key} is {rows} x {cols}, but has {numbers.size} numbers")
    return numbers.reshape(rows, cols)
