"""mrcal's camera models: a folder with one .cameramodel file, a Python dict, for each camera.

The reference of their extrinsics is the left eye's base frame, in which points are located. Pixel
(0, 0) is the centre of the top-left one, as here.
See https://mrcal.secretsauce.net/cameramodels.html.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from vergence.arrays import Array
from vergence.files import results_folder, write_whole
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import eye_pose, straight_gaze
from vergence.geometry.lens import CameraModel
from vergence.geometry.projection import camera_pose
from vergence.geometry.se3 import inverse, rotvec
from vergence.interchange.serialization import check_cameras

_NAMES: dict[CameraModel, str] = {
    "radial-tangential": "LENSMODEL_OPENCV5",
    "rational": "LENSMODEL_OPENCV8",
}
"""mrcal's names of the lens models; it has none for OpenCV's fisheye."""


def save(head: HeadCalibration, folder: Path, at: Array | None = None) -> None:
    """Write <camera>.cameramodel for every camera into a folder.

    They stand as at readings (r,) [rad]; None: straight gaze. VergenceError if a camera has skew
    or a fisheye lens, or the folder cannot be written.
    """
    check_cameras(head, "mrcal's cameramodel", models=tuple(_NAMES))
    at = straight_gaze(head.kinematics) if at is None else at
    with results_folder(folder):
        for name, mounted in head.cameras.items():
            lens, T_base_eye = mounted.intrinsics, eye_pose(head.kinematics, mounted.eye, at)
            T_cam_ref = inverse(camera_pose(mounted, head.T_rbase_lbase, T_base_eye))
            pinhole = lens.matrix[[0, 1, 0, 1], [0, 1, 2, 2]]
            content = {  # mrcal needs the lens model before the intrinsics
                "lensmodel": _NAMES[lens.model],
                "intrinsics": [*pinhole.tolist(), *lens.distortion.tolist()],
                # Versions from 3.0 also call it rt_cam_ref, and read this name too.
                "extrinsics": np.append(rotvec(T_cam_ref[:3, :3]), T_cam_ref[:3, 3]).tolist(),
                "imagersize": list(lens.size),
            }
            write_whole(folder / file_name(name), json.dumps(content, indent=1))


def file_name(camera: str) -> str:
    """Name the file of a camera."""
    return f"{camera}.cameramodel"
