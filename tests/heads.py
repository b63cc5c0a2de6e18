"""Heads to test on, without MuJoCo."""

import numpy as np

from vergence.arrays import Array
from vergence.geometry.camera import Camera, pinhole
from vergence.geometry.head import HeadCalibration, MountedCamera, T_base_cam
from vergence.geometry.kinematics import EyeAxes, Neck
from vergence.geometry.se3 import inverse, pose, rotation, transform

R_EYE_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""A camera that looks straight ahead: its z is the eye's x, its x the eye's -y."""


def random_pose(rng: np.random.Generator, angle: float = 3.0, distance: float = 1.0) -> Array:
    """Return a pose turned by up to an angle and shifted by about a distance."""
    axis = rng.normal(size=3)
    turn = axis / np.linalg.norm(axis) * rng.uniform(0, angle)
    return pose(rotation(turn), rng.normal(size=3) * distance)


def random_camera(rng: np.random.Generator, *, distorted: bool = True) -> Camera:
    """Return a camera with skew, a shifted principal point and, perhaps, distortion."""
    focal = rng.uniform(250, 450)
    matrix = np.array(
        [
            [focal, rng.normal(0, 1), 319.5 + rng.normal(0, 5)],
            [0, focal * rng.uniform(0.98, 1.02), 239.5 + rng.normal(0, 5)],
            [0, 0, 1],
        ]
    )
    k = np.array([rng.uniform(-0.15, 0.05), rng.uniform(0, 0.02), *rng.normal(0, 5e-4, 2), 0])
    return Camera(width=640, height=480, matrix=matrix, distortion=k * distorted)


def random_head(rng: np.random.Generator, *, distorted: bool = True) -> HeadCalibration:
    """Return a head with every imperfection that a calibration can state."""
    return HeadCalibration(
        cameras={
            f"{eye}_{lens}": MountedCamera(
                eye=eye,
                intrinsics=random_camera(rng, distorted=distorted),
                T_eye_cam=random_pose(rng, 0.05, 0.01) @ pose(R_EYE_CAM, [0.02, 0, 0.01]),
            )
            for eye in ("left", "right")
            for lens in ("wide", "narrow")
        },
        T_rbase_lbase=random_pose(rng, 0.03, 0.002) @ pose(t=[0, rng.uniform(0.06, 0.1), 0]),
        axes={
            eye: EyeAxes(
                *rng.normal(1, 0.01, 2),
                *rng.normal(0, 0.01, 3),
                axis_distance_m=rng.normal(0, 1e-3),
            )
            for eye in ("left", "right")
        },
        neck=Neck(
            axes=np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]),
            points_m=rng.normal(size=(3, 3)) * 0.1,
            head_m=rng.normal(size=3) * 0.2,
        ),
    )


def plain_head(
    baseline_m: float,
    focal_px: float,
    *,
    camera_m: tuple[tuple[float, float, float], tuple[float, float, float]] = ((0, 0, 0),) * 2,
    mounting_deg: tuple[tuple[float, float, float], tuple[float, float, float]] = ((0, 0, 0),) * 2,
) -> HeadCalibration:
    """Return a head with two wide pinhole cameras, left and right, mounted as stated."""
    return HeadCalibration(
        cameras={
            f"{eye}_wide": MountedCamera(
                eye=eye,
                intrinsics=pinhole(640, 480, focal_px),
                T_eye_cam=pose(rotation(np.radians(turn)) @ R_EYE_CAM, where),
            )
            for eye, where, turn in zip(("left", "right"), camera_m, mounting_deg, strict=True)
        },
        T_rbase_lbase=pose(t=[0, baseline_m, 0]),
    )


def point_in_camera(head: HeadCalibration, name: str, eyes: Array, points: Array) -> Array:
    """Return points (N, 3) of the left base frame in frame cam, at eye angles (N, 4)."""
    if head.cameras[name].eye == "left":
        return transform(inverse(T_base_cam(head, name, eyes[:, :2])), points)
    in_base = transform(head.T_rbase_lbase, points)
    return transform(inverse(T_base_cam(head, name, eyes[:, 2:])), in_base)
