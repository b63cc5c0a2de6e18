"""Kalibr's camchain YAML: pinhole cameras with radtan distortion, and the poses between them.

A chain holds for one posture of the eyes, straight gaze unless another is given. It does not say
where the cameras sit in the eyes, so a head cannot be read from it alone.
See https://github.com/ethz-asl/kalibr/wiki/yaml-formats.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, PositiveInt, TypeAdapter

from vergence.arrays import Array, Transform
from vergence.errors import explain
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration, T_base_cam
from vergence.geometry.projection import rebase
from vergence.geometry.se3 import inverse
from vergence.interchange.serialization import (
    Number,
    check_intrinsics,
    check_names,
    read,
    write_yaml,
)

TOPIC = "/{camera}/image_raw"


class _Cam(BaseModel):
    """A camera of a camchain; cam_overlaps, timeshift_cam_imu and T_cam_imu are not read."""

    camera_model: Literal["pinhole"]
    distortion_model: Literal["radtan", "none"] = "none"
    distortion_coeffs: list[Number] = []
    intrinsics: tuple[Number, Number, Number, Number]
    resolution: tuple[PositiveInt, PositiveInt]
    rostopic: str = ""
    T_cn_cnm1: Transform | None = None

    def camera(self) -> Camera:
        count = 4 if self.distortion_model == "radtan" else 0
        if len(self.distortion_coeffs) != count:
            raise ValueError(
                f"distortion_coeffs has {len(self.distortion_coeffs)} numbers; "
                f"{self.distortion_model} has {count}"
            )
        fx, fy, cx, cy = self.intrinsics
        return Camera(
            width=self.resolution[0],
            height=self.resolution[1],
            matrix=np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]),
            distortion=np.array(self.distortion_coeffs + [0.0] * (5 - count)),
        )


_CAMS = TypeAdapter(dict[str, _Cam])


@dataclass(frozen=True, eq=False)
class Camchain:
    """Content of a camchain: cameras in its order, and the pose of each in the next."""

    cameras: Mapping[str, Camera]
    """By name."""
    T_cn_cnm1: tuple[Array | None, ...]
    """For each camera the pose (4, 4) of the previous camera in it; None where none is given."""


def save(head: HeadCalibration, path: Path, *, eye_angles: Array | None = None) -> None:
    """Write a head's cameras as a camchain.

    Args:
        head: its cameras become cam0, cam1, ... in their order; rostopic gives their names.
        path: of the file.
        eye_angles: (4,) joint readings [rad] of the posture; None: zero.

    Raises:
        VergenceError: a camera has skew or k3, or the file cannot be written.
    """
    check_names(head)
    check_intrinsics(head, "Kalibr's radtan model", has_k3=False)
    angles = np.zeros(4) if eye_angles is None else eye_angles
    T_lbase_cam = [_T_lbase_cam(head, name, angles) for name in head.cameras]
    content: dict[str, Any] = {}
    for k, (name, mounted) in enumerate(head.cameras.items()):
        camera = mounted.intrinsics
        entry: dict[str, Any] = {}
        if k:
            entry["T_cn_cnm1"] = (inverse(T_lbase_cam[k]) @ T_lbase_cam[k - 1]).tolist()
        entry |= {
            "cam_overlaps": [other for other in range(len(head.cameras)) if other != k],
            "camera_model": "pinhole",
            "distortion_coeffs": camera.distortion[:4].tolist(),
            "distortion_model": "radtan",
            "intrinsics": camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist(),
            "resolution": [camera.width, camera.height],
            "rostopic": TOPIC.format(camera=name),
        }
        content[f"cam{k}"] = entry
    write_yaml(path, content)


def _T_lbase_cam(head: HeadCalibration, name: str, eye_angles: Array) -> Array:
    if head.camera(name).eye == "left":
        return T_base_cam(head, name, eye_angles[:2])
    return inverse(head.T_rbase_lbase) @ T_base_cam(head, name, eye_angles[2:])


def load(path: Path) -> Camchain:
    """Read a camchain. Cameras are named after the first part of their rostopic, else cam0, ...

    Raises:
        VergenceError: the file is missing, not a camchain, or has another camera model.
    """
    return read(path, "a Kalibr camchain", _camchain)


def _camchain(content: Any) -> Camchain:
    found = _CAMS.validate_python(content)
    keys = [f"cam{k}" for k in range(len(found))]
    if not found or set(found) != set(keys):
        names = ", ".join(found) or "nothing"
        raise ValueError(f"it has {names} where cam0, cam1, ... are expected")
    cameras: dict[str, Camera] = {}
    for key in keys:
        name = found[key].rostopic.strip("/").split("/")[0] or key
        if name in cameras:
            raise ValueError(f"{key}.rostopic names {name} a second time")
        try:
            cameras[name] = found[key].camera()
        except ValueError as error:
            raise ValueError(f"{key}: {explain(error)}") from None
    return Camchain(cameras=cameras, T_cn_cnm1=tuple(found[key].T_cn_cnm1 for key in keys))


def update_head(chain: Camchain, template: HeadCalibration) -> HeadCalibration:
    """Return the template with a chain's intrinsics and, if it has all of them, its poses.

    The wide cameras keep their poses in the eyes, which a chain does not hold. Those of the narrow
    ones and T_rbase_lbase follow from the chain, which is assumed to hold at readings of zero.

    Args:
        chain: its cameras have the names of the template's.
        template: supplies the poses of the wide cameras, the axes and the neck.

    Raises:
        VergenceError: the chain names a camera that the template does not have.
    """
    cameras = dict(template.cameras)
    for name, camera in chain.cameras.items():
        cameras[name] = replace(template.camera(name), intrinsics=camera)
    head = replace(template, cameras=cameras)
    if any(T is None for T in chain.T_cn_cnm1[1:]):
        return head
    T_cam_first = {}
    T = np.eye(4)
    for name, step in zip(chain.cameras, chain.T_cn_cnm1, strict=True):
        T = T if step is None else step @ T
        T_cam_first[name] = T
    for name in chain.cameras:
        wide = f"{cameras[name].eye}_wide"
        if name != wide and wide in T_cam_first:
            T_wide_narrow = T_cam_first[wide] @ inverse(T_cam_first[name])
            T_eye_narrow = cameras[wide].T_eye_cam @ T_wide_narrow
            cameras[name] = replace(cameras[name], T_eye_cam=T_eye_narrow)
    head = replace(head, cameras=cameras)
    if not {"left_wide", "right_wide"} <= set(T_cam_first):
        return head
    T_rcam_lcam = T_cam_first["right_wide"] @ inverse(T_cam_first["left_wide"])
    return rebase(head, T_rcam_lcam, joints=np.zeros(4), cameras=("left_wide", "right_wide"))
