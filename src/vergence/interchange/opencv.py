"""OpenCV's FileStorage (.yml, .yaml or .json): a whole head, matrices as cv::Mat.

cameras:  by name  eye, image_width, image_height, camera_matrix (3x3),
                   lens_model (radial-tangential if it is missing: cv2.projectPoints with 5
                   numbers; rational: with 8; fisheye: cv2.fisheye.projectPoints),
                   distortion_coefficients (1xn), T_eye_cam (4x4)
T_rbase_lbase (4x4)
kinematics: readings, and for left and right by joint the fields of joints.Joint
neck:     axes (nx3), points_m (nx3), head_m (1x3), joints: their names, where they have any
time_offset_s
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from pydantic import BaseModel, BeforeValidator, Field, FiniteFloat

from vergence.errors import VergenceError
from vergence.files import parse_json, write_whole
from vergence.geometry.head import HeadCalibration, MountedCamera
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import EYES, Kinematics, Side
from vergence.geometry.lens import CameraModel
from vergence.geometry.neck import Neck
from vergence.interchange.serialization import (
    Intrinsics,
    Matrix,
    check_cameras,
    intrinsics_fields,
    parse_yaml,
    read,
)

SUFFIXES = (".yml", ".yaml", ".json")
FORMAT = "vergence-head-opencv-2"
_ERRORS = tuple(field.name for field in fields(Joint) if isinstance(field.default, float))
"""Fields of a joint with its deviations from the design."""


def save(head: HeadCalibration, path: Path) -> None:
    """Write a head without its accuracy with cv2.FileStorage.

    VergenceError if a camera has skew, which OpenCV's functions ignore, the suffix is not one of
    SUFFIXES, or the file cannot be written.
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
        "kinematics": {
            "readings": ",".join(head.kinematics.readings),
            **{
                eye: {joint.name: _joint_fields(joint, head.kinematics) for joint in joints}
                for eye, joints in head.kinematics.eyes.items()
            },
        },
        "neck": _neck_fields(head.neck),
        "time_offset_s": head.time_offset_s,
    }
    flags = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY
    storage = cv2.FileStorage(f"head{path.suffix}", flags)  # the suffix chooses the format
    _write(storage, content)
    write_whole(path, storage.releaseAndGetString())


def _check_suffix(path: Path) -> None:
    if path.suffix not in SUFFIXES:
        raise VergenceError(
            "OpenCV tells the format of a file by its suffix, and heads are in one of "
            f"{', '.join(SUFFIXES)}; found {path.name!r}."
        )


def _neck_fields(neck: Neck) -> dict[str, Any]:
    named = {"joints": ",".join(neck.joints)} if neck.joints else {}
    return {"axes": neck.axes, "points_m": neck.points_m, "head_m": neck.head_m[None], **named}


def _joint_fields(joint: Joint, kinematics: Kinematics) -> dict[str, Any]:
    factors = np.array([[joint.readings.get(name, 0.0) for name in kinematics.readings]])
    rest = {name: value for name, value in vars(joint).items() if name in _ERRORS}
    return {"axis": joint.axis[None], "point_m": joint.point_m[None], "factors": factors, **rest}


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


class _Joint(BaseModel):
    axis: Matrix
    point_m: Matrix
    factors: Matrix
    gain: FiniteFloat
    offset_rad: FiniteFloat
    nonorthogonality_rad: FiniteFloat
    axis_distance_m: FiniteFloat
    slide_m: FiniteFloat
    inclination_rad: FiniteFloat = 0.0


# An eye without joints is written as an element without content.
_Joints = Annotated[dict[str, _Joint], BeforeValidator(lambda found: found or {})]


class _Kinematics(BaseModel):
    readings: str
    left: _Joints
    right: _Joints


class _Neck(BaseModel):
    axes: Matrix
    points_m: Matrix
    head_m: Matrix
    joints: str = ""
    """Separated by commas."""


class _Head(BaseModel):
    format: Literal["vergence-head-opencv-2"] = FORMAT
    cameras: Annotated[dict[str, _Camera], Field(min_length=1)]
    T_rbase_lbase: Matrix
    kinematics: _Kinematics
    neck: _Neck
    time_offset_s: FiniteFloat = 0.0


def load(path: Path) -> HeadCalibration:
    """Read a head that `save` or another program wrote.

    cv2.FileStorage is not used: its parser can end the process on a damaged file.
    """
    _check_suffix(path)
    parse = parse_json if path.suffix == ".json" else parse_yaml
    return read(path, "a head in a file of OpenCV's FileStorage", _head, parse)


def _head(content: Any) -> HeadCalibration:
    found = _Head.model_validate(content)
    return HeadCalibration(
        cameras={
            name: MountedCamera(eye=c.eye, intrinsics=c.camera(c.lens_model), T_eye_cam=c.T_eye_cam)
            for name, c in found.cameras.items()
        },
        T_rbase_lbase=found.T_rbase_lbase,
        kinematics=_kinematics(found.kinematics),
        neck=_neck(found.neck),
        time_offset_s=found.time_offset_s,
    )


def _neck(found: _Neck) -> Neck:
    joints = tuple(found.joints.split(",")) if found.joints else ()
    return Neck(**vars(found) | {"head_m": found.head_m.ravel(), "joints": joints})


def _kinematics(found: _Kinematics) -> Kinematics:
    names = tuple(filter(None, found.readings.split(",")))
    eyes: dict[Side, tuple[Joint, ...]] = {}
    for eye in EYES:
        eyes[eye] = tuple(
            Joint(
                name=name,
                axis=joint.axis.ravel(),
                point_m=joint.point_m.ravel(),
                readings={
                    reading: factor
                    for reading, factor in zip(names, joint.factors.ravel().tolist(), strict=True)
                    if factor
                },
                **{error: getattr(joint, error) for error in _ERRORS},
            )
            for name, joint in getattr(found, eye).items()
        )
    return Kinematics(eyes, names)
