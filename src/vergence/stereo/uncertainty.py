"""Located points and their covariances: noise of pixels and joints, and the calibration's own."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera
from vergence.geometry.head import Accuracy, HeadCalibration, main_pair
from vergence.geometry.kinematics import EYE_COLUMNS, T_base_eye, axes_row, eye_jacobians
from vergence.geometry.parameters import camera_columns, parameter_names
from vergence.geometry.projection import by_parameters, project_with_jacobians
from vergence.stereo.triangulation import checked, triangulate_at

_PIXEL_STEP_PX = 1e-2  # of the central differences: rounding and curvature both stay below 1e-7
_JOINT_STEP_RAD = 3e-5


@dataclass(frozen=True, eq=False)
class LocatedPoints:
    """Where N points are."""

    xyz: Array
    """(N, 3) [m] in the left eye's base frame (x forward = depth, y left, z up); NaN where the
    status is not OK."""
    covariance: Array
    """(N, 3, 3) [m^2], to first order; NaN where the status is not OK, or where neither the caller
    nor the calibration states any noise."""
    status: np.ndarray
    """(N,) of triangulation.Status."""


def locate(
    head: HeadCalibration,
    *,
    left: Array,
    right: Array,
    joints: Array,
    cameras: tuple[str, str] | None = None,
    pixel_std_px: ArrayLike | None = None,
    joint_std_rad: ArrayLike | None = None,
) -> LocatedPoints:
    """Return where points are that both eyes see, and how well that is known.

    Args:
        head: with or without its accuracy.
        left: (N, 2) pixels in the left camera, distortion included; NaN: not seen.
        right: (N, 2) pixels of the same points in the right camera.
        joints: (4,) joint readings [rad] of one posture that serves all points, or (N, 4), in the
            order of kinematics.EYE_JOINTS: left pan, left tilt, right pan, right tilt.
        cameras: names of a camera of the left eye and one of the right; None: the main ones (the
            wide ones, where a head has such).
        pixel_std_px: noise of (left u, left v, right u, right v); a number stands for all, and (4,)
            or (N, 4) are taken as they are. None: that of the corners of the calibration.
        joint_std_rad: noise of each reading, likewise. None: as the calibration found it.

    Raises:
        VergenceError: shapes do not fit, the head has no such camera, or left and right are
            exchanged.
    """
    points, status, jacobian = _linearised(head, left, right, joints, cameras)
    covariance = np.full((len(points), 3, 3), np.nan)
    accuracy = head.accuracy or Accuracy(method="paper")
    if accuracy.parameters or pixel_std_px is not None or joint_std_rad is not None:
        if pixel_std_px is None:
            pixel_std_px = accuracy.pixel_std_px or 0.0
        if joint_std_rad is None:
            joint_std_rad = np.tile(accuracy.joint_std or (0.0,), 4)[:4]
        covariance = _covariance(jacobian, _stds(len(points), pixel_std_px, joint_std_rad))
    if accuracy.parameters:
        covariance = covariance + _of_calibration(head, accuracy, points, joints, cameras)
    return LocatedPoints(points, covariance, status)


def locate_with_covariance(
    head: HeadCalibration,
    *,
    left: Array,
    right: Array,
    joints: Array,
    pixel_std_px: ArrayLike,
    joint_std_rad: ArrayLike,
    cameras: tuple[str, str] | None = None,
) -> tuple[Array, Array]:
    """Return points (N, 3) [m] and the covariances (N, 3, 3) [m^2] that measurement noise makes.

    The calibration is taken as exact. NaN where a point cannot be located. Arguments and errors are
    those of `locate`.
    """
    points, _, jacobian = _linearised(head, left, right, joints, cameras)
    return points, _covariance(jacobian, _stds(len(points), pixel_std_px, joint_std_rad))


def locate_both(
    head: HeadCalibration,
    *,
    left: tuple[Array, Array],
    right: tuple[Array, Array],
    joints: Array,
    pixel_std_px: ArrayLike,
    joint_std_rad: ArrayLike,
    cameras: tuple[str, str] | None = None,
) -> tuple[Array, Array, Array]:
    """Return two points that are seen together, and the covariance of their difference.

    Both are seen by the same cameras at the same readings, so that an error of the readings is in
    both, and cancels as far as the two are near each other. The calibration is taken as exact.

    `left` and `right` have the pixels (N, 2) of points a and of points b; other arguments and
    errors are those of `locate`. Returns points a and b (N, 3) [m], and covariances (N, 3, 3) [m^2]
    of a - b, in the left eye's base frame; NaN where a point cannot be located.
    """
    n = len(left[0])
    both = np.tile(np.broadcast_to(joints, (n, 4)), (2, 1))
    pixels = np.concatenate(left), np.concatenate(right)
    points, _, jacobian = _linearised(head, *pixels, both, cameras)
    a, b = np.split(jacobian, 2, axis=1)
    apart = np.concatenate([a[:4], -b[:4], a[4:] - b[4:]])  # (12, N, 3)
    stds = _stds(n, pixel_std_px, joint_std_rad)
    covariances = _covariance(apart, np.concatenate([stds[:, :4], stds], axis=1))
    points_a, points_b = np.split(points, 2)
    return points_a, points_b, covariances


def calibration_covariance(
    head: HeadCalibration,
    *,
    left: Array,
    right: Array,
    joints: Array,
    cameras: tuple[str, str] | None = None,
) -> Array:
    """Return what the calibration's covariance adds (N, 3, 3) [m^2] to points that are located.

    Arguments and errors are those of `locate`; VergenceError also if the head states no covariance.
    """
    accuracy = head.accuracy
    if accuracy is None or not accuracy.parameters:
        raise VergenceError(
            "This calibration states no covariance; `vergence calibrate --method bundle` makes "
            "one that does."
        )
    points, _ = triangulate_at(head, left=left, right=right, joints=joints, cameras=cameras)
    return _of_calibration(head, accuracy, points, joints, cameras)


def _of_calibration(
    head: HeadCalibration,
    accuracy: Accuracy,
    points: Array,
    joints: Array,
    cameras: tuple[str, str] | None,
) -> Array:
    """Return covariances (N, 3, 3) of located points (N, 3); NaN where the point is NaN."""
    total = np.full((len(points), 3, 3), np.nan)
    found = np.isfinite(points).all(axis=1)
    names = parameter_names(head.cameras)
    own = [names.index(name) for name in accuracy.parameters]
    readings = np.broadcast_to(joints, (len(points), 4))[found]
    by_calibration = _moved_by_parameters(head, points[found], readings, cameras)[..., own]
    total[found] = by_calibration @ accuracy.covariance @ np.swapaxes(by_calibration, 1, 2)
    return total


def _moved_by_parameters(
    head: HeadCalibration, points: Array, joints: Array, cameras: tuple[str, str] | None
) -> Array:
    """Return how triangulated points (N, 3) change with the head's parameters (N, 3, P).

    The pixels stay where they are: the point makes up for what the parameters change. They weigh as
    in Eqs. 3-4: undistorted, and by the distance from the camera.
    """
    by_point, by_head = [], []
    for name in cameras or main_pair(head) or ():
        mounted = head.cameras[name]
        angles, axes = joints[:, EYE_COLUMNS[mounted.eye]], axes_row(head.axes[mounted.eye])
        T = T_base_eye(angles, axes)
        by_axes, _ = eye_jacobians(angles, np.broadcast_to(axes, (len(points), 6)))
        lens = mounted.intrinsics
        pinhole = Camera(lens.width, lens.height, lens.matrix)
        J, ideal = (
            project_with_jacobians(
                replace(mounted, intrinsics=lens), head.T_rbase_lbase, T, points[:, None]
            )
            for lens in (mounted.intrinsics, pinhole)
        )
        weights = ideal.by_point[:, 0] @ np.linalg.pinv(J.by_point[:, 0])
        # A point's derivatives fall with its distance.
        slope = np.linalg.norm(ideal.by_point[:, 0], axis=(1, 2)) / pinhole.matrix[0, 0]
        weights /= slope[:, None, None]
        rows = np.zeros((len(points), 2, len(parameter_names(head.cameras))))
        rows[:, :, camera_columns(head, name)] = by_parameters(J, by_axes)[:, 0]
        by_point.append(weights @ J.by_point[:, 0])
        by_head.append(weights @ rows)
    return -np.linalg.pinv(np.concatenate(by_point, axis=1)) @ np.concatenate(by_head, axis=1)


def _linearised(
    head: HeadCalibration, left: Array, right: Array, joints: Array, cameras: tuple[str, str] | None
) -> tuple[Array, np.ndarray, Array]:
    """Return points (N, 3), their status, and how they change (8, N, 3) with pixels and angles."""
    left, right, joints = checked(left, right, joints)
    inputs = np.concatenate([left, right, np.broadcast_to(joints, (len(left), 4))], axis=1)
    steps = np.repeat([_PIXEL_STEP_PX, _JOINT_STEP_RAD], 4)
    moves = np.concatenate([np.zeros((1, 8)), np.diag(steps), -np.diag(steps)])
    flat = (inputs + moves[:, None]).reshape(-1, 8)  # (17 N, 8)
    points, status = triangulate_at(
        head, left=flat[:, :2], right=flat[:, 2:4], joints=flat[:, 4:], cameras=cameras
    )
    here, *around = points.reshape(17, -1, 3)
    forward, backward = np.reshape(around, (2, 8, -1, 3))
    jacobian = (forward - backward) / (2 * steps[:, None, None])
    return here, status[: len(left)], jacobian


def _stds(n: int, pixel_std_px: ArrayLike, joint_std_rad: ArrayLike) -> Array:
    """Return standard deviations (N, 8) of pixel coordinates and joint angles."""
    return np.concatenate(
        [np.broadcast_to(std, (n, 4)) for std in (pixel_std_px, joint_std_rad)], axis=1
    )


def _covariance(jacobian: Array, stds: Array) -> Array:
    """Return covariances (N, 3, 3) from (K, N, 3) and (N, K)."""
    scaled = jacobian * stds.T[:, :, None]
    return np.einsum("kni,knj->nij", scaled, scaled)
