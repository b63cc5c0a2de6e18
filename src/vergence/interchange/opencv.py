"""OpenCV's FileStorage (.yml, .yaml, .xml or .json): a whole head, matrices as cv::Mat.

cameras:  by name  eye, image_width, image_height, camera_matrix (3x3),
                   lens_model (radial-tangential where there is none: cv2.projectPoints with 5
                   numbers; rational: with 8; fisheye: cv2.fisheye.projectPoints),
                   distortion_coefficients (1xn), T_eye_cam (4x4)
T_rbase_lbase (4x4)
axes:     left, right: the numbers of kinematics.EyeAxes
neck:     axes (nx3), points_m (nx3), head_m (1x3)
time_offset_s
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Annotated, Any, Literal
from xml.etree import ElementTree

import cv2
from pydantic import BaseModel, Field, FiniteFloat

from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration, MountedCamera
from vergence.geometry.kinematics import EYES, EyeAxes, Neck, Side
from vergence.geometry.lens import CameraModel
from vergence.interchange.serialization import (
    Intrinsics,
    Matrix,
    check_cameras,
    intrinsics_fields,
    parse_yaml,
    read,
)
from vergence.reading import parse_json, unique_keys
from vergence.writing import write_whole

SUFFIXES = (".yml", ".yaml", ".xml", ".json")
FORMAT: Literal["vergence-head-opencv-1"] = "vergence-head-opencv-1"


def save(head: HeadCalibration, path: Path) -> None:
    """Write a head with cv2.FileStorage; its accuracy is left out.

    VergenceError if a camera has skew, which OpenCV's functions ignore, the file's suffix is none
    of SUFFIXES, or it cannot be written.
    """
    check_cameras(head, "OpenCV's camera model")
    _check_suffix(path)
    content = {
        "format": FORMAT,
        "cameras": {
            name: {
                "eye": mounted.eye,
                "lens_model": mounted.intrinsics.model,
                **intrinsics_fields(mounted.intrinsics),
                "T_eye_cam": mounted.T_eye_cam,
            }
            for name, mounted in head.cameras.items()
        },
        "T_rbase_lbase": head.T_rbase_lbase,
        "axes": {eye: asdict(axes) for eye, axes in head.axes.items()},
        "neck": asdict(head.neck) | {"head_m": head.neck.head_m[None]},
        "time_offset_s": head.time_offset_s,
    }
    flags = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY
    storage = cv2.FileStorage(f"head{path.suffix}", flags)  # the suffix chooses the format
    _write(storage, content)
    write_whole(path, storage.releaseAndGetString())


def _check_suffix(path: Path) -> None:
    if path.suffix not in SUFFIXES:
        raise VergenceError(
            f"OpenCV chooses the format by the file's suffix, one of {', '.join(SUFFIXES)}; found "
            f"{path.name!r}."
        )


def _write(storage: cv2.FileStorage, content: Mapping[str, Any]) -> None:
    for key, value in content.items():
        if isinstance(value, Mapping):
            storage.startWriteStruct(key, cv2.FileNode_MAP)
            _write(storage, value)
            storage.endWriteStruct()
        else:
            storage.write(key, value)


class _Camera(Intrinsics):
    eye: Side
    lens_model: CameraModel = "radial-tangential"
    T_eye_cam: Matrix


class _Neck(BaseModel):
    axes: Matrix
    points_m: Matrix
    head_m: Matrix


class _Head(BaseModel):
    format: Literal["vergence-head-opencv-1"] = FORMAT
    cameras: Annotated[dict[str, _Camera], Field(min_length=1)]
    T_rbase_lbase: Matrix
    axes: dict[Side, dict[str, FiniteFloat]]
    neck: _Neck
    time_offset_s: FiniteFloat = 0.0


def load(path: Path) -> HeadCalibration:
    """Read a head that `save` wrote, or a file of another program with the same fields.

    It does not use cv2.FileStorage, whose parser can end the process on a damaged file.
    VergenceError if the file is missing, cannot be read, or a field is not valid.
    """
    _check_suffix(path)
    parsers = {".xml": _parse_xml, ".json": parse_json}
    what = "a head in a file of OpenCV's FileStorage"
    return read(path, what, _head, parsers.get(path.suffix, _parse_yaml))


def _head(content: Any) -> HeadCalibration:
    found = _Head.model_validate(content)
    for eye in EYES:
        for field in fields(EyeAxes):
            if field.name not in found.axes.get(eye, {}):
                raise ValueError(f"axes.{eye}.{field.name} is missing")
    return HeadCalibration(
        cameras={
            name: MountedCamera(eye=c.eye, intrinsics=c.camera(c.lens_model), T_eye_cam=c.T_eye_cam)
            for name, c in found.cameras.items()
        },
        T_rbase_lbase=found.T_rbase_lbase,
        axes={eye: EyeAxes(**found.axes[eye]) for eye in EYES},
        neck=Neck(**vars(found.neck) | {"head_m": found.neck.head_m.ravel()}),
        time_offset_s=found.time_offset_s,
    )


def _parse_yaml(text: str) -> Any:
    # OpenCV 4 begins with %YAML:1.0, which is not valid YAML; its matrices are plain mappings.
    return parse_yaml(re.sub(r"\A%YAML[^\n]*", "", text))


def _parse_xml(text: str) -> Any:
    def value(element: ElementTree.Element) -> Any:
        if len(element):
            return unique_keys([(child.tag, value(child)) for child in element])
        return (element.text or "").strip().strip('"')

    if "<!DOCTYPE" in text:  # entities can stand for any amount of text
        raise ValueError("it declares a document type, which FileStorage does not")
    try:
        return value(ElementTree.fromstring(text))
    except ElementTree.ParseError as error:
        raise ValueError(str(error)) from None
