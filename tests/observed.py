"""What a head would see of boards, as points: recordings without images, good and poor."""

from dataclasses import dataclass, replace

import numpy as np

from heads import R_EYE_CAM, random_pose
from vergence.arrays import Array
from vergence.calibration.checks.cross_validation import Observations
from vergence.calibration.sequential.sequential import Views
from vergence.geometry.board import Chessboard, corner_points
from vergence.geometry.camera import Camera, project
from vergence.geometry.head import HeadCalibration, MountedCamera, T_base_cam
from vergence.geometry.kinematics import T_base_eye
from vergence.geometry.se3 import inverse, pose, rotation, transform

BOARD = Chessboard(columns=9, rows=6, square_m=0.03)
POINTS = corner_points(BOARD)
SIZE = (640, 480)


@dataclass(frozen=True)
class Recording:
    """What is recorded of a head; the defaults are a good recording."""

    straight: int = 12
    """Boards at straight gaze."""
    orientations: int = 24
    """Eye angles at which a board at rest is seen."""
    reach_rad: tuple[float, float] = (0.25, 0.22)
    """Of pan and of tilt."""
    together: bool = False
    """Whether tilt does what pan does."""
    alike: bool = True
    """Whether both eyes do the same."""
    gaze_rad: tuple[float, float] = (0.0, 0.0)
    """Pan and tilt of both eyes before the boards of which each stands elsewhere."""
    lean_rad: float = 0.6
    """By which boards are slanted, at most."""
    slant_rad: tuple[float, float] | None = None
    """One slant for all boards."""
    joint_std_rad: float = np.radians(0.1)
    pixel_std_px: float = 0.1


def head(rng: np.random.Generator, *, narrow: bool = False) -> HeadCalibration:
    """Return a head that nobody built: with two wide cameras, and perhaps two narrow ones."""
    cameras = {}
    for eye in ("left", "right"):
        for lens, focal in (("wide", 300.0), ("narrow", 900.0))[: 1 + narrow]:
            matrix = np.array([[focal, 0, 322], [0, 1.01 * focal, 236], [0, 0, 1]])
            bent = np.array([-0.09, 0.01, 4e-4, -3e-4, 0]) * (lens == "wide")
            cameras[f"{eye}_{lens}"] = MountedCamera(
                eye=eye,
                intrinsics=Camera(width=640, height=480, matrix=matrix, distortion=bent),
                T_eye_cam=random_pose(rng, 0.05, 0.003) @ pose(R_EYE_CAM, [0.02, 0, 0.01]),
            )
    return HeadCalibration(
        cameras=cameras,
        T_rbase_lbase=random_pose(rng, 0.02, 0.001) @ pose(t=[0, 0.075, 0]),
    )


def observe(
    truth: HeadCalibration, rng: np.random.Generator, recording: Recording | None = None
) -> Observations:
    """Return what cameras and joints give of a recording."""
    how = Recording() if recording is None else recording
    still, count = how.straight, how.orientations
    placement = np.concatenate([np.arange(still), np.full(count, still)])
    # Spread evenly over an ellipse, all clear of straight gaze.
    k = np.arange(3, count + 3) + 0.5
    radius, turn = np.sqrt(k / (count + 3)), k * np.pi * (3 - np.sqrt(5))
    gaze = radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1) * how.reach_rad
    gaze = gaze[:, [0, 0]] if how.together else gaze
    other = gaze if how.alike else rng.permutation(gaze)
    ahead = np.tile(how.gaze_rad, (still, 2))
    angles = np.concatenate([ahead, np.concatenate([gaze, other], axis=1)])
    slants = rng.uniform(-how.lean_rad, how.lean_rad, (still + 1, 2))
    if how.slant_rad is not None:
        slants[:] = how.slant_rad
    turns = np.concatenate([slants, rng.uniform(-0.3, 0.3, (still + 1, 1))], axis=1)
    distance = np.append(rng.uniform(0.35, 0.7, still), 0.55)[:, None]
    aside = rng.uniform(-0.25, 0.25, (still + 1, 2)) * np.append(np.ones(still), 0.2)[:, None]
    centre = distance * np.concatenate([np.ones((still + 1, 1)), aside], axis=1)
    centre[:, 1] -= 0.04  # between the eyes
    R = R_EYE_CAM @ rotation(turns)
    T_lbase_target = pose(R, centre - R @ POINTS.mean(axis=0))
    corners = {
        name: see(truth, name, angles, T_lbase_target[placement])
        + rng.normal(0, how.pixel_std_px, (still + count, len(POINTS), 2))
        for name in truth.cameras
    }
    readings = angles + rng.normal(0, how.joint_std_rad, angles.shape)
    sizes = dict.fromkeys(corners, SIZE)
    return Observations(Views(BOARD, placement, readings, corners, sizes), None, None)


def see(truth: HeadCalibration, name: str, angles: Array, T_lbase_target: Array) -> Array:
    """Return the corners (V, K, 2) in a camera; NaN where the image does not hold them."""
    left = truth.cameras[name].eye == "left"
    T_base_lbase = np.eye(4) if left else truth.T_rbase_lbase
    T = inverse(T_base_cam(truth, name, angles[:, :2] if left else angles[:, 2:])) @ T_base_lbase
    pixels = project(
        truth.cameras[name].intrinsics, transform((T @ T_lbase_target)[:, None], POINTS)
    )
    inside = ((pixels > 0) & (pixels < np.array(SIZE) - 1)).all(axis=-1, keepdims=True)
    return np.where(inside, pixels, np.nan)


def with_corners(seen: Observations, **corners: Array) -> Observations:
    """Return the same with other corners in some cameras."""
    return replace(seen, views=replace(seen.views, corners={**seen.views.corners, **corners}))


def with_readings(seen: Observations, eye_angles: Array) -> Observations:
    """Return the same with other joint readings (V, 4)."""
    return replace(seen, views=replace(seen.views, eye_angles=eye_angles))


def as_poses(seen: Observations) -> Observations:
    """Return the same with eye poses in place of angles."""
    angles = seen.views.eye_angles
    poses = np.stack([T_base_eye(angles[:, :2]), T_base_eye(angles[:, 2:])], axis=1)
    return replace(with_readings(seen, np.full_like(angles, np.nan)), T_base_eye=poses)
