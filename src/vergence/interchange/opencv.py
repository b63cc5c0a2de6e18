"""OpenCV's FileStorage (.yml, .yaml or .json): a whole head, matrices as cv::Mat.

cameras:  by name  eye, image_width, image_height, camera_matrix (3x3), lens_model
                   (radial-tangential: cv2.projectPoints with 5 numbers; rational: with 8;
                   fisheye: cv2.fisheye.projectPoints), distortion_coefficients (1xn),
                   T_eye_cam (4x4)
T_rbase_lbase (4x4)
kinematics: readings, and for left and right by joint the fields of joints.Joint
neck:     axes (nx3), points_m (nx3), head_m (1x3), joints: their names, where they have any
time_offset_s
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from vergence.errors import VergenceError
from vergence.files import write_whole
from vergence.geometry.head import HeadCalibration
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import Kinematics
from vergence.interchange.serialization import check_cameras, intrinsics_fields

SUFFIXES = (".yml", ".yaml", ".json")


def save(head: HeadCalibration, path: Path) -> None:
    """Write a head without its accuracy with cv2.FileStorage.

    VergenceError if a camera has skew, which OpenCV's functions ignore, the suffix is not one of
    SUFFIXES, or the file cannot be written.
    """
    check_cameras(head, "OpenCV's camera model")
    if path.suffix not in SUFFIXES:
        raise VergenceError(
            "OpenCV tells the format of a file by its suffix, and heads are in one of "
            f"{', '.join(SUFFIXES)}; found {path.name!r}."
        )
    kinematics, neck = head.kinematics, head.neck
    content = {
        "format": "vergence-head-opencv-2",
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
            "readings": ",".join(kinematics.readings),
            **{
                eye: {joint.name: _joint_fields(joint, kinematics) for joint in joints}
                for eye, joints in kinematics.eyes.items()
            },
        },
        "neck": {
            "axes": neck.axes,
            "points_m": neck.points_m,
            "head_m": neck.head_m[None],
            "joints": ",".join(neck.joints),
        },
        "time_offset_s": head.time_offset_s,
    }
    flags = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY
    storage = cv2.FileStorage(f"head{path.suffix}", flags)  # the suffix chooses the format
    _write(storage, content)
    write_whole(path, storage.releaseAndGetString())


def _joint_fields(joint: Joint, kinematics: Kinematics) -> dict[str, Any]:
    factors = np.array([[joint.readings.get(name, 0.0) for name in kinematics.readings]])
    errors = {name: value for name, value in vars(joint).items() if isinstance(value, float)}
    return {"axis": joint.axis[None], "point_m": joint.point_m[None], "factors": factors, **errors}


def _write(storage: cv2.FileStorage, content: Mapping[str, Any]) -> None:
    for key, value in content.items():
        if isinstance(value, Mapping):
            storage.startWriteStruct(key, cv2.FileNode_MAP)
            _write(storage, value)
            storage.endWriteStruct()
        else:
            storage.write(key, value)
