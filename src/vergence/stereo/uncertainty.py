"""How far off a located point is: the paper's Eqs. 20-21 and their generalisation.

Eqs. 20-21 hold on the optical axis of two parallel cameras, and are for a first idea and for
designing a head; `locate_with_covariance` holds for any sample of any head.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration
from vergence.stereo.triangulation import check_shapes, locate

_PIXEL_STEP_PX = 1e-2  # of the central differences: rounding and curvature both stay below 1e-7
_JOINT_STEP_RAD = 3e-5


def depth_error(
    depth_m: ArrayLike, baseline_m: ArrayLike, focal_px: ArrayLike, disparity_error_px: ArrayLike
) -> Array:
    """Eq. 20: return the error in depth (...,) [m] that an error in disparity makes.

    Args:
        depth_m: from the centres of the cameras.
        baseline_m: between the centres of the cameras.
        focal_px: of both cameras.
        disparity_error_px: of the difference between the two image positions.
    """
    depth, baseline, focal = (np.asarray(a, float) for a in (depth_m, baseline_m, focal_px))
    return depth**2 / (baseline * focal) * np.asarray(disparity_error_px, float)


def disparity_error(focal_px: ArrayLike, orientation_error_rad: ArrayLike) -> Array:
    """Eq. 21: return the error in disparity (...,) [px] of a wrong angle between the cameras."""
    return np.asarray(focal_px, float) * np.tan(np.asarray(orientation_error_rad, float))


def predicted_depth_std(
    depth_m: ArrayLike,
    baseline_m: ArrayLike,
    focal_px: ArrayLike,
    *,
    joint_std_rad: ArrayLike = 0.0,
    pixel_std_px: ArrayLike = 0.0,
    camera_ahead_m: ArrayLike = 0.0,
) -> Array:
    """Return the standard deviation of depth (...,) [m] by Eqs. 20-21.

    Noise is white and independent in the two eyes, so their parts add as squares. Only pan
    counts: on the axis, tilt moves both images along the direction that has no disparity.
    Within 1.3 % from five baselines on; closer by, the half baseline is no small angle.

    Args:
        depth_m: from the centres of the cameras.
        baseline_m: between the centres of the cameras.
        focal_px: of both cameras.
        joint_std_rad: of each joint's reading.
        pixel_std_px: of each coordinate of the object's position in each image.
        camera_ahead_m: how far the cameras' centres sit ahead of the eyes' rotation centres. A
            wrong pan also shifts a camera that does so, which Eq. 21 leaves out.
    """
    lever = 1 + np.asarray(camera_ahead_m, float) / np.asarray(depth_m, float)
    turned = lever * disparity_error(focal_px, np.sqrt(2) * np.asarray(joint_std_rad, float))
    matched = np.sqrt(2) * np.asarray(pixel_std_px, float)
    return depth_error(depth_m, baseline_m, focal_px, np.hypot(turned, matched))


def locate_with_covariance(
    calibration: HeadCalibration,
    pixels_l: Array,
    pixels_r: Array,
    eye_angles: Array,
    *,
    pixel_std_px: ArrayLike,
    joint_std_rad: ArrayLike,
    cameras: tuple[str, str] = ("left_wide", "right_wide"),
) -> tuple[Array, Array]:
    """Return the points that `locate` returns, and their covariances to first order.

    Args:
        calibration: of the head, taken as exact.
        pixels_l: (N, 2) pixels in the left camera, distortion included.
        pixels_r: (N, 2) pixels in the right camera.
        eye_angles: (N, 4) joint readings [rad] in the order of kinematics.EYE_JOINTS.
        pixel_std_px: standard deviation of (left u, left v, right u, right v); a number stands
            for all, and (4,) or (N, 4) are taken as they are.
        joint_std_rad: standard deviation of each reading, likewise.
        cameras: names of the left and the right camera.

    Returns:
        Points (N, 3) [m] and covariances (N, 3, 3) [m^2] in the left eye's base frame, NaN where a
        sample cannot be located.

    Raises:
        VergenceError: shapes do not fit, or the head has no such camera.
    """
    points, jacobian = _linearised(calibration, pixels_l, pixels_r, eye_angles, cameras)
    return points, _covariance(jacobian, _stds(len(points), pixel_std_px, joint_std_rad))


def locate_both(
    calibration: HeadCalibration,
    pixels_a: tuple[Array, Array],
    pixels_b: tuple[Array, Array],
    eye_angles: Array,
    *,
    pixel_std_px: ArrayLike,
    joint_std_rad: ArrayLike,
    cameras: tuple[str, str] = ("left_wide", "right_wide"),
) -> tuple[Array, Array, Array]:
    """Return two points that are seen together, and the covariance of the way between them.

    Both are seen by the same cameras at the same readings, so that what is wrong with the
    readings is wrong for both, and cancels as far as the two are near each other.

    Args:
        calibration: of the head, taken as exact.
        pixels_a: of the one point, (N, 2) in the left and (N, 2) in the right camera.
        pixels_b: of the other, likewise.
        eye_angles: (N, 4) joint readings [rad] in the order of kinematics.EYE_JOINTS.
        pixel_std_px: as for `locate_with_covariance`, of either point.
        joint_std_rad: likewise.
        cameras: names of the left and the right camera.

    Returns:
        Points a and b (N, 3) [m], and covariances (N, 3, 3) [m^2] of a - b, in the left eye's base
        frame; NaN where a sample cannot be located.

    Raises:
        VergenceError: shapes do not fit, or the head has no such camera.
    """
    left, right = (np.concatenate(sides) for sides in zip(pixels_a, pixels_b, strict=True))
    eyes = np.tile(eye_angles, (2, 1))
    points, jacobian = _linearised(calibration, left, right, eyes, cameras)
    a, b = np.split(jacobian, 2, axis=1)
    apart = np.concatenate([a[:4], -b[:4], a[4:] - b[4:]])  # (12, N, 3)
    stds = _stds(len(eye_angles), pixel_std_px, joint_std_rad)
    covariances = _covariance(apart, np.concatenate([stds[:, :4], stds], axis=1))
    points_a, points_b = np.split(points, 2)
    return points_a, points_b, covariances


def _linearised(
    calibration: HeadCalibration,
    pixels_l: Array,
    pixels_r: Array,
    eye_angles: Array,
    cameras: tuple[str, str],
) -> tuple[Array, Array]:
    """Return points (N, 3) and how they change (8, N, 3) with four pixel coordinates and angles."""
    check_shapes(pixels_l, pixels_r, eye_angles)
    inputs = np.concatenate([pixels_l, pixels_r, eye_angles], axis=1)
    steps = np.repeat([_PIXEL_STEP_PX, _JOINT_STEP_RAD], 4)
    moves = np.concatenate([np.zeros((1, 8)), np.diag(steps), -np.diag(steps)])
    flat = (inputs + moves[:, None]).reshape(-1, 8)  # (17 N, 8)
    located = locate(calibration, flat[:, :2], flat[:, 2:4], flat[:, 4:], cameras=cameras)
    here, *around = located.points.reshape(17, -1, 3)
    forward, backward = np.reshape(around, (2, 8, -1, 3))
    return here, (forward - backward) / (2 * steps[:, None, None])


def _stds(n: int, pixel_std_px: ArrayLike, joint_std_rad: ArrayLike) -> Array:
    """Return standard deviations (N, 8) of pixel coordinates and joint angles."""
    return np.concatenate(
        [np.broadcast_to(std, (n, 4)) for std in (pixel_std_px, joint_std_rad)], axis=1
    )


def _covariance(jacobian: Array, stds: Array) -> Array:
    """Return covariances (N, 3, 3) from (K, N, 3) and (N, K)."""
    spread = jacobian * stds.T[:, :, None]
    return np.einsum("kni,knj->nij", spread, spread)
