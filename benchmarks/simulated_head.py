"""Simulated heads, drawn at random: the truth of the Monte Carlo scripts and of the tests.

What such heads would record stands in simulated_recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from vergence.arrays import Array
from vergence.geometry.camera import Camera, pinhole
from vergence.geometry.head import R_EYE_CAM, HeadCalibration, MountedCamera, camera_pose_in_base
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import EYES, Kinematics, Side, pan_tilt
from vergence.geometry.lens import COEFFICIENTS
from vergence.geometry.neck import Neck
from vergence.geometry.parameters import boxplus, parameter_values
from vergence.geometry.se3 import POSE, inverse, pose, rotation, transform

WIDTH, HEIGHT = 640, 480
"""A camera, and a board, that look along x and against it: z is the head's x, x its -y."""
FOCAL_PX = {"wide": (250.0, 420.0), "middle": (500.0, 600.0), "narrow": (900.0, 1300.0)}
"""2.5 to 4.2, 5 to 6, and 9 to 13 mm on the sensors of this project's head."""


def random_head(
    rng: np.random.Generator,
    *,
    lenses: Sequence[str] = ("wide", "narrow"),
    perfect_axes: bool = False,
) -> HeadCalibration:
    """Return a head that bundle adjustment models: no skew, no distortion but of wide lenses.

    With perfect axes, gains are one, and offsets and errors of the axes zero.
    """
    cameras = {}
    for eye in EYES:
        for lens in lenses:
            focal = rng.uniform(*FOCAL_PX[lens]) * np.array([1.0, rng.uniform(0.99, 1.01)])
            middle = np.array([WIDTH - 1, HEIGHT - 1]) / 2 + rng.normal(0, 5, 2)
            matrix = np.array([[focal[0], 0, middle[0]], [0, focal[1], middle[1]], [0, 0, 1]])
            # Barrel distortion of 4 to 12 % at the image's edge, as such lenses have.
            barrel = -rng.uniform(0.04, 0.12) / (WIDTH / 2 / focal[0]) ** 2
            distortion = [barrel, 0.15 * barrel**2, *rng.normal(0, 5e-4, 2), 0.0]
            cameras[f"{eye}_{lens}"] = MountedCamera(
                eye=eye,
                intrinsics=Camera(WIDTH, HEIGHT, matrix, np.array(distortion) * (lens == "wide")),
                T_eye_cam=pose(
                    rotation(rng.normal(0, np.radians(1.5), 3)) @ R_EYE_CAM,
                    np.array([0.02, 0, 0.01 if lens == "wide" else -0.02])
                    + rng.normal(0, 0.004, 3),
                ),
            )
    T_rbase_lbase = pose(
        rotation(rng.normal(0, np.radians(0.5), 3)),
        np.array([0, rng.uniform(0.055, 0.12), 0]) + rng.normal(0, 0.001, 3),
    )
    head = HeadCalibration(cameras=cameras, T_rbase_lbase=T_rbase_lbase)
    return head if perfect_axes else replace(head, kinematics=random_pan_tilt(rng))


def random_pan_tilt(rng: np.random.Generator) -> Kinematics:
    """Return eyes that pan and tilt with gains, offsets and axes as wrong as they may be."""
    eyes: dict[Side, tuple[Joint, ...]] = {}
    for eye in EYES:
        gains, offsets = rng.uniform(0.96, 1.04, 2), rng.normal(0, np.radians(0.4), 2)
        pan, tilt = (
            replace(joint, gain=gain, offset_rad=offset)
            for joint, gain, offset in zip(pan_tilt(eye), gains, offsets, strict=True)
        )
        eyes[eye] = (
            pan,
            replace(
                tilt,
                nonorthogonality_rad=rng.normal(0, np.radians(0.3)),
                axis_distance_m=rng.normal(0, 0.001),
            ),
        )
    return Kinematics(eyes)


def as_designed(kinematics: Kinematics) -> Kinematics:
    """Return the joints without their errors: what the description of a dataset says.

    Factors are whole numbers or halves by design.
    """
    eyes: dict[Side, tuple[Joint, ...]] = {}
    for eye, joints in kinematics.eyes.items():
        own = []
        for joint in joints:
            factors = {name: round(2 * factor) / 2 for name, factor in joint.readings.items()}
            own.append(
                Joint(name=joint.name, axis=joint.axis, readings=factors, point_m=joint.point_m)
            )
        eyes[eye] = tuple(own)
    return Kinematics(eyes, kinematics.readings)


def pan_tilt_pose(angles: Array) -> Array:
    """Return the pose (..., 4, 4) of an eye at perfect pan and tilt (..., 2) [rad]."""
    pan, tilt = (angles[..., k, None] * axis for k, axis in enumerate(np.eye(3)[[2, 1]]))
    return pose(rotation(pan) @ rotation(tilt))


def skewed_head(rng: np.random.Generator, *, distorted: bool = True) -> HeadCalibration:
    """Return a head with all that a calibration can state: skew, and a neck, too."""
    head = random_head(rng)
    return replace(
        head,
        cameras={
            name: replace(
                mounted,
                intrinsics=random_camera(
                    rng, distorted=distorted, zoom=2.0 if name.endswith("narrow") else 1.0
                ),
            )
            for name, mounted in head.cameras.items()
        },
        neck=Neck(
            axes=np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]),
            points_m=rng.normal(size=(3, 3)) * 0.1,
            head_m=rng.normal(size=3) * 0.2,
            joints=("neck_pitch", "neck_roll", "neck_yaw"),
        ),
    )


def unskewed_head(seed: int) -> HeadCalibration:
    """Return a head with a neck and no skew, which formats of other programs have no field for."""
    head, cameras = skewed_head(np.random.default_rng(seed)), {}
    for name, mounted in head.cameras.items():
        matrix = mounted.intrinsics.matrix.copy()
        matrix[0, 1] = 0.0
        cameras[name] = replace(mounted, intrinsics=replace(mounted.intrinsics, matrix=matrix))
    return replace(head, cameras=cameras)


def plain_head(
    baseline_m: float,
    focal_px: float,
    *,
    camera_m: Sequence[tuple[float, float, float]] = ((0, 0, 0),) * 2,
    mounting_deg: Sequence[tuple[float, float, float]] = ((0, 0, 0),) * 2,
) -> HeadCalibration:
    """Return a head with two wide pinhole cameras, left and right, mounted as stated."""
    return HeadCalibration(
        cameras={
            f"{eye}_wide": MountedCamera(
                eye=eye,
                intrinsics=pinhole(WIDTH, HEIGHT, focal_px),
                T_eye_cam=pose(rotation(np.radians(turn)) @ R_EYE_CAM, where),
            )
            for eye, where, turn in zip(EYES, camera_m, mounting_deg, strict=True)
        },
        T_rbase_lbase=pose(t=[0, baseline_m, 0]),
    )


def random_camera(rng: np.random.Generator, *, distorted: bool = True, zoom: float = 1.0) -> Camera:
    """Return a camera with skew, a shifted principal point and, perhaps, distortion."""
    focal = zoom * rng.uniform(250, 450)
    first = [focal, rng.normal(0, 1), 319.5 + rng.normal(0, 5)]
    second = [0, focal * rng.uniform(0.98, 1.02), 239.5 + rng.normal(0, 5)]
    k = np.array([rng.uniform(-0.15, 0.05), rng.uniform(0, 0.02), *rng.normal(0, 5e-4, 2), 0])
    return Camera(WIDTH, HEIGHT, np.array([first, second, [0, 0, 1]]), k * distorted)


def random_pose(rng: np.random.Generator, angle: float = 3.0, distance: float = 1.0) -> Array:
    """Return a pose (4, 4) turned by up to an angle and shifted by about a distance."""
    axis = rng.normal(size=3)
    turn = axis / np.linalg.norm(axis) * rng.uniform(0, angle)
    return pose(rotation(turn), rng.normal(size=3) * distance)


def point_in_camera(head: HeadCalibration, name: str, joints: Array, points: Array) -> Array:
    """Return points (N, 3) of the left eye's base in frame cam, at joint readings (N, r)."""
    eye = head.cameras[name].eye
    in_base = points if eye == "left" else transform(head.T_rbase_lbase, points)
    return transform(inverse(camera_pose_in_base(head, name, joints)), in_base)


def rough_start(head: HeadCalibration, rng: np.random.Generator) -> HeadCalibration:
    """Return a head about as wrong as the paper's method leaves it, with perfect gains and axes."""
    lens = {"fx": 3.0, "fy": 3.0, "cx": 2.0, "cy": -2.0}

    def change(name: str, value: float | None) -> float:
        last = name.rpartition(".")[2]
        if value is None:
            return rng.normal(0, 0.003)
        if last in COEFFICIENTS["rational"]:
            return -0.1 * value
        if last.endswith("gain"):
            return 1 - value
        return -value if last == "nonorthogonality_rad" else lens.get(last, 0.0)

    values = parameter_values(head)
    assert sum(value is None for value in values.values()) == len(POSE) * (1 + len(head.cameras))
    return boxplus(head, np.array([change(*each) for each in values.items()]))


def poses_and_gains(accuracy: Accuracy) -> dict[str, list[int]]:
    """Return by name which parameters make up each stated pose, and each gain."""
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(accuracy.parameters):
        owner, _, last = name.rpartition(".")
        if owner.endswith("T_eye_cam") or owner == "T_rbase_lbase":
            groups.setdefault(owner, []).append(i)
        elif last.endswith("_gain"):
            groups[name] = [i]
    return groups


def probability(error: Array, covariance: Array) -> float:
    """Return the stated probability of an error (n,) smaller than this one."""
    scale = np.sqrt(np.diag(covariance))
    score = error / scale
    correlation = covariance / np.outer(scale, scale)
    squared = score @ np.linalg.pinv(correlation, hermitian=True) @ score
    return float(chi2.cdf(squared, len(error)))
