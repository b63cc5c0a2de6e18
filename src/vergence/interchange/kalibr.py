"""Kalibr's camchain YAML: pinhole cameras with radtan distortion, and the poses between them.

A chain holds for one posture of the eyes, straight gaze unless another is given. It says nothing
of where the cameras sit in the eyes, so that a head cannot be read from it alone.
See https://github.com/ethz-asl/kalibr/wiki/yaml-formats.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PositiveInt, TypeAdapter

from vergence.arrays import Array, Transform
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration, T_base_cam
from vergence.geometry.kinematics import T_base_eye
from vergence.geometry.se3 import inverse
from vergence.interchange.limits import check_names, pinhole_matrix, refuse_k3, refuse_skew
from vergence.interchange.yaml_files import Number, dump, first_message, read
from vergence.stereo.triangulation import fixed_transform

TOPIC = "/{camera}/image_raw"


class _Cam(BaseModel):
    model_config = ConfigDict(extra="ignore")  # cam_overlaps, timeshift_cam_imu, T_cam_imu

    camera_model: Literal["pinhole"]
    distortion_model: Literal["radtan", "none"] = "none"
    distortion_coeffs: list[Number] = []
    intrinsics: Annotated[list[Number], Field(min_length=4, max_length=4)]
    resolution: Annotated[list[PositiveInt], Field(min_length=2, max_length=2)]
    rostopic: str = ""
    T_cn_cnm1: list[list[Number]] | None = None


_ADAPTER = TypeAdapter(dict[str, _Cam])
_TRANSFORM = TypeAdapter(Transform)


@dataclass(frozen=True, eq=False)
class Camchain:
    """What a camchain says: cameras in its order, and the pose of each to the next."""

    cameras: Mapping[str, Camera]
    """By name."""
    T_cn_cnm1: tuple[Array | None, ...]
    """For each camera the pose (4, 4) of the one before in it; None where there is none."""


def save(head: HeadCalibration, path: Path, *, eye_angles: Array | None = None) -> None:
    """Write a head's cameras as a camchain.

    Args:
        head: its cameras become cam0, cam1, ... in their order; rostopic says which is which.
        path: of the file.
        eye_angles: (4,) readings [rad] at which the eyes stand; None: zero.

    Raises:
        VergenceError: a camera has skew or k3, or the file cannot be written.
    """
    check_names(head)
    refuse_skew(head, "Kalibr")
    refuse_k3(head, "Kalibr's radtan model")
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
    dump(path, content)


def _T_lbase_cam(head: HeadCalibration, name: str, eye_angles: Array) -> Array:
    if head.camera(name).eye == "left":
        return T_base_cam(head, name, eye_angles[:2])
    return inverse(head.T_rbase_lbase) @ T_base_cam(head, name, eye_angles[2:])


def load(path: Path) -> Camchain:
    """Read a camchain. Cameras are named after the first part of their rostopic, else cam0, ...

    Raises:
        VergenceError: the file is missing, not a camchain, or has another camera model.
    """
    found = read(path, _ADAPTER, "a Kalibr camchain")
    if not found or set(found) != {f"cam{k}" for k in range(len(found))}:
        raise VergenceError(
            f"{path} is not a Kalibr camchain: it has {', '.join(found) or 'nothing'} where cam0, "
            "cam1, ... are expected."
        )
    cameras: dict[str, Camera] = {}
    poses: list[Array | None] = []
    for k in range(len(found)):
        key, cam = f"cam{k}", found[f"cam{k}"]
        coefficients = list(cam.distortion_coeffs)
        if len(coefficients) != 4 * (cam.distortion_model == "radtan"):
            raise VergenceError(
                f"{path}: {key}.distortion_coeffs has {len(coefficients)} numbers; radtan has 4, "
                "and none has none."
            )
        name = cam.rostopic.strip("/").split("/")[0] or key
        if name in cameras:
            raise VergenceError(f"{path}: {key}.rostopic names {name} a second time.")
        try:
            cameras[name] = Camera(
                width=cam.resolution[0],
                height=cam.resolution[1],
                matrix=pinhole_matrix(*cam.intrinsics),
                distortion=np.array([*coefficients, 0.0] if coefficients else np.zeros(5)),
            )
            T = cam.T_cn_cnm1
            poses.append(None if T is None else _TRANSFORM.validate_python(T))
        except ValueError as error:
            raise VergenceError(f"{path}: {key}: {first_message(error)}.") from None
    return Camchain(cameras=cameras, T_cn_cnm1=tuple(poses))


def into_head(chain: Camchain, start: HeadCalibration) -> HeadCalibration:
    """Return a head with a chain's intrinsics and, where it has all of them, its poses.

    The wide cameras keep their places in the eyes, which a chain does not know. The narrow ones
    and T_rbase_lbase follow from the chain, which is taken to hold at readings of zero.

    Args:
        chain: its cameras have the names of the head's.
        start: where the wide cameras sit, axes, neck.

    Raises:
        VergenceError: the chain names a camera that the head has not.
    """
    cameras = dict(start.cameras)
    for name, camera in chain.cameras.items():
        cameras[name] = replace(start.camera(name), intrinsics=camera)
    head = replace(start, cameras=cameras)
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
    T_rbase_lbase = start.T_rbase_lbase
    if {"left_wide", "right_wide"} <= set(T_cam_first):
        left, right = cameras["left_wide"], cameras["right_wide"]
        T_rbase_lbase = fixed_transform(
            T_base_eye(np.zeros(2), start.axes["right"]),
            right.T_eye_cam,
            T_cam_first["right_wide"] @ inverse(T_cam_first["left_wide"]),
            left.T_eye_cam,
            T_base_eye(np.zeros(2), start.axes["left"]),
        )
    return replace(head, cameras=cameras, T_rbase_lbase=T_rbase_lbase)
