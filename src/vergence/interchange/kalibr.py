"""Kalibr's camchain YAML: pinhole cameras, radtan or equidistant, and the poses between them.

A chain holds for one posture of the eyes: readings of zero, straight gaze. It does not say where
the cameras sit in the eyes, so a head cannot be read from it alone.
See https://github.com/ethz-asl/kalibr/wiki/yaml-formats.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, FiniteFloat, PositiveInt, TypeAdapter

from vergence.arrays import Array, Transform
from vergence.errors import VergenceError, explain
from vergence.geometry.camera import Camera
from vergence.geometry.head import (
    HeadCalibration,
    base_pose,
    camera_pose_in_base,
    lenses_of,
    main_camera,
)
from vergence.geometry.kinematics import EYES, straight_gaze
from vergence.geometry.se3 import inverse
from vergence.interchange.serialization import (
    camera_of,
    check_cameras,
    read,
    with_intrinsics,
    write_yaml,
)
from vergence.stereo.extrinsics import rebase


class _Cam(BaseModel):
    """A camera of a camchain. Text is converted to numbers, since YAML 1.1 reads 1e-5 as text."""

    camera_model: str
    distortion_model: Literal["radtan", "equidistant", "none"] = "none"
    distortion_coeffs: list[FiniteFloat] = []
    intrinsics: list[FiniteFloat]
    resolution: tuple[PositiveInt, PositiveInt]
    rostopic: str = ""
    T_cn_cnm1: Transform | None = None

    def camera(self) -> Camera:
        if self.camera_model != "pinhole" or len(self.intrinsics) != 4:
            raise ValueError(
                "camera_model: expected a pinhole with 4 intrinsics, found "
                f"{self.camera_model[:40]} with {len(self.intrinsics)}; calibrate with Kalibr's "
                "pinhole-equi or pinhole-radtan, or with `vergence calibrate --lens fisheye`"
            )
        fx, fy, cx, cy = self.intrinsics
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        model = "fisheye" if self.distortion_model == "equidistant" else "radial-tangential"
        stated = [] if self.distortion_model == "none" else self.distortion_coeffs
        return camera_of(self.resolution, matrix, model, stated)


_CAMS = TypeAdapter(dict[str, _Cam])
Camchain = dict[str, tuple[Camera, Array | None]]
"""Cameras by name in the order of the chain, with T_cn_cnm1 (4, 4) from the previous camera."""


def save(head: HeadCalibration, path: Path, at: Array | None = None) -> None:
    """Write a head's cameras as cam0, cam1, ... of a camchain, with their names as rostopic.

    They stand as at readings (r,) [rad]; None: straight gaze. VergenceError if a camera has skew,
    k3 or a rational lens, or the file cannot be written.
    """
    check_cameras(head, "Kalibr's camchain", models=("radial-tangential", "fisheye"), has_k3=False)
    content: dict[str, Any] = {}
    T_head_previous = np.eye(4)
    at = straight_gaze(head.kinematics) if at is None else at
    for k, (name, mounted) in enumerate(head.cameras.items()):
        T_head_cam = base_pose(head, mounted.eye) @ camera_pose_in_base(head, name, at)
        camera = mounted.intrinsics
        step = {"T_cn_cnm1": (inverse(T_head_cam) @ T_head_previous).tolist()} if k else {}
        content[f"cam{k}"] = step | {
            "cam_overlaps": [other for other in range(len(head.cameras)) if other != k],
            "camera_model": "pinhole",
            "distortion_coeffs": camera.distortion[:4].tolist(),
            "distortion_model": "equidistant" if camera.model == "fisheye" else "radtan",
            "intrinsics": camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]].tolist(),
            "resolution": [camera.width, camera.height],
            "rostopic": f"/{name}/image_raw",
        }
        T_head_previous = T_head_cam
    write_yaml(path, content)


def load(path: Path) -> Camchain:
    """Read a camchain; the first part of the topics that differs names cameras, else cam0, ..."""
    return read(path, "a Kalibr camchain", _camchain)


def _camchain(content: Any) -> Camchain:
    found = _CAMS.validate_python(content)
    keys = [f"cam{k}" for k in range(len(found))]
    if not found or set(found) != set(keys):
        names = ", ".join(found) or "nothing"
        raise ValueError(f"it has {names} where cam0, cam1, ... are expected")
    chain: Camchain = {}
    topics = [found[key].rostopic.strip("/").split("/") for key in keys]
    depth = range(min(map(len, topics)))
    differ = next((k for k in depth if len({topic[k] for topic in topics}) == len(topics)), None)
    for key, topic in zip(keys, topics, strict=True):
        name = key if differ is None else topic[differ] or key
        try:
            chain[name] = (found[key].camera(), found[key].T_cn_cnm1)
        except ValueError as error:
            raise ValueError(f"{key}: {explain(error)}") from None
    return chain


def update_head(chain: Camchain, template: HeadCalibration) -> HeadCalibration:
    """Give a template the intrinsics of a chain and, if the chain has all of them, its poses.

    The main camera of each eye keeps its pose in the eye, which a chain does not hold. Those of the
    other cameras and T_rbase_lbase follow from the chain, which is assumed to hold at readings of
    zero. VergenceError if the chain names a camera that the template does not have, or has poses
    of cameras of an eye but not of its main one.
    """
    head = with_intrinsics(template, {name: camera for name, (camera, _) in chain.items()})
    T, T_cam_first = np.eye(4), {}
    for k, (name, (_, step)) in enumerate(chain.items()):
        if step is None and k:
            return head
        T = T if step is None else step @ T
        T_cam_first[name] = T
    if len(chain) == 1:
        return head
    cameras, main = dict(head.cameras), {}
    for eye in EYES:
        if any(cameras[name].eye == eye for name in chain):
            main[eye] = main_camera(lenses_of(head, eye))
    if absent := set(main.values()) - set(chain):
        raise VergenceError(
            f"The poses of a camchain are taken from that of each eye's main camera, but it has "
            f"{', '.join(chain)} and not {min(absent)}; without T_cn_cnm1 only the lenses are read."
        )
    for name in chain:
        known = main[cameras[name].eye]
        if name != known:
            T_eye_first = cameras[known].T_eye_cam @ T_cam_first[known]
            T_eye_cam = T_eye_first @ inverse(T_cam_first[name])
            cameras[name] = replace(cameras[name], T_eye_cam=T_eye_cam)
    head = replace(head, cameras=cameras)
    if len(main) == 1:
        return head
    pair = main["left"], main["right"]
    T_rcam_lcam = T_cam_first[pair[1]] @ inverse(T_cam_first[pair[0]])
    straight = straight_gaze(head.kinematics)
    return rebase(head, T_rcam_lcam, joints=straight, cameras=pair)
