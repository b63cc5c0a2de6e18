"""What a head with every imperfection sees, and starts for its refinement."""

from dataclasses import replace

import numpy as np
from numpy.polynomial.chebyshev import chebval
from scipy.stats import chi2

from heads import R_EYE_CAM
from vergence.arrays import Array
from vergence.calibration.bundle.problem import moved
from vergence.calibration.sequential.sequential import Views
from vergence.data.timing import Timing
from vergence.geometry.board import Chessboard, corner_points
from vergence.geometry.camera import Camera, project
from vergence.geometry.head import HeadCalibration, MountedCamera, T_base_cam
from vergence.geometry.se3 import inverse, pose, rotation, transform

BOARD = Chessboard(columns=9, rows=6, square_m=0.03)
POINTS = corner_points(BOARD)


def views_of(
    head: HeadCalibration,
    rng: np.random.Generator,
    *,
    joint_std: float = 0.0,
    pixel_std_px: float = 0.0,
) -> Views:
    """Return 12 boards before eyes at rest, then two boards before eyes at 28 random angles."""
    angles = np.concatenate([np.zeros((12, 4)), rng.uniform(-0.25, 0.25, (28, 4))])
    return seen_at(head, rng, angles, angles, joint_std=joint_std, pixel_std_px=pixel_std_px)


def timed_views_of(
    head: HeadCalibration,
    rng: np.random.Generator,
    *,
    time_offset_s: float,
    joint_std: float = 0.0,
    pixel_std_px: float = 0.0,
) -> tuple[Views, Timing]:
    """Return the same, but for the eyes: they move, along cubics, while they are read at 30 Hz."""
    time_s = np.arange(40) / 30
    run = (np.arange(40) >= 12).astype(int)
    course = rng.permuted(np.tile([0.05, 0.1, -0.2, 0.15], (4, 1)), axis=1).T

    def angles(t: Array) -> Array:
        return run[:, None] * chebval((t - time_s[26]) / 0.45, course).T

    read, seen = angles(time_s), angles(time_s + time_offset_s)
    views = seen_at(head, rng, read, seen, joint_std=joint_std, pixel_std_px=pixel_std_px)
    return views, Timing(time_s, run)


def seen_at(
    head: HeadCalibration,
    rng: np.random.Generator,
    readings: Array,
    angles: Array,
    *,
    joint_std: float,
    pixel_std_px: float,
) -> Views:
    """Return views of 14 boards with noise, of eyes that read (40, 4) and stand at (40, 4)."""
    placement = np.concatenate([np.arange(12), 12 + np.arange(28) % 2])
    turned = R_EYE_CAM @ rotation(rng.uniform(-0.5, 0.5, (14, 3)))
    distance = np.concatenate([rng.uniform(0.35, 0.9, 12), [0.5, 0.8]])[:, None]
    centre = distance * np.concatenate([np.ones((14, 1)), rng.uniform(-0.2, 0.2, (14, 2))], axis=1)
    T_lbase_target = pose(turned, centre - turned @ POINTS.mean(axis=0))[placement]
    corners = {}
    for name, mounted in head.cameras.items():
        mine = angles[:, :2] if mounted.eye == "left" else angles[:, 2:]
        T_base_lbase = np.eye(4) if mounted.eye == "left" else head.T_rbase_lbase
        T_cam_target = inverse(T_base_cam(head, name, mine)) @ T_base_lbase @ T_lbase_target
        pixels = project(mounted.intrinsics, transform(T_cam_target[:, None], POINTS))
        pixels = pixels + rng.normal(0, pixel_std_px, pixels.shape)
        inside = ((pixels > 0) & (pixels < [639, 479])).all(axis=-1, keepdims=True)
        corners[name] = np.where(inside, pixels, np.nan)
    readings = readings + rng.normal(0, joint_std, readings.shape)
    sizes = {name: (640, 480) for name in corners}
    return Views(BOARD, placement, readings, corners, sizes)


def spoilt(head: HeadCalibration, rng: np.random.Generator) -> HeadCalibration:
    """Return a start: the head about as wrong as the paper's method leaves it, perfect gains."""
    cameras = {}
    for name, mounted in head.cameras.items():
        lens = mounted.intrinsics
        matrix = lens.matrix + np.diag([3.0, 3.0, 0.0]) + [[0, 0, 2], [0, 0, -2], [0, 0, 0]]
        cameras[name] = MountedCamera(
            eye=mounted.eye,
            intrinsics=Camera(
                width=640, height=480, matrix=matrix, distortion=0.9 * lens.distortion
            ),
            T_eye_cam=moved(mounted.T_eye_cam, rng.normal(0, 0.003, 6)),
        )
    return replace(
        head,
        cameras=cameras,
        T_rbase_lbase=moved(head.T_rbase_lbase, rng.normal(0, 0.003, 6)),
        axes={
            eye: replace(axes, pan_gain=1.0, tilt_gain=1.0, nonorthogonality_rad=0.0)
            for eye, axes in head.axes.items()
        },
    )


def probability(off: Array, covariance: Array) -> float:
    """Return the stated probability of a smaller error."""
    return float(chi2.cdf(off @ np.linalg.solve(covariance, off), len(off)))
