"""Located points and their covariances: noise of pixels and joints, and the calibration's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array
from vergence.data.dataset import MAX_GAP_S
from vergence.data.timing import Timing, moved_readings
from vergence.errors import VergenceError
from vergence.geometry.head import Accuracy, HeadCalibration, main_pair
from vergence.geometry.parameters import camera_columns, parameter_names
from vergence.geometry.projection import (
    by_parameters,
    eye_poses_with_jacobians,
    measured,
    project_with_jacobians,
    stereo_cameras,
)
from vergence.stereo.triangulation import Status, triangulate_at


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
    joint_time_s: Array | None = None,
) -> LocatedPoints:
    """Return where points are that both eyes see, and how well that is known.

    Args:
        head: with or without its accuracy.
        left: (N, 2) pixels in the left camera, distortion included; NaN: not seen.
        right: (N, 2) pixels of the same points in the right camera.
        joints: (4,) joint readings [rad] of one posture that serves all points, or (N, 4), in the
            order of kinematics.EYE_JOINTS: left pan, left tilt, right pan, right tilt. Or, where
            the eyes' poses are measured, T_base_eye of the left and the right eye: (2, 4, 4), or
            (N, 2, 4, 4).
        cameras: names of a camera of the left eye and one of the right; None: the main ones (the
            wide ones, where a head has such).
        pixel_std_px: noise of (left u, left v, right u, right v); a number stands for all, and (4,)
            or (N, 4) are taken as they are. None: that of the corners of the calibration.
        joint_std_rad: noise of each reading, likewise; of measured poses the two numbers of
            rotation [rad] and translation [m]. None: as the calibration found it.
        joint_time_s: (N,) time stamps of the readings of one motion, at most 0.2 s apart; each is
            then moved to the moment that its image shows, by the head's time offset, along a
            polynomial through its neighbours. None: the eyes stood still.

    Raises:
        VergenceError: shapes do not fit, the head has no such camera, or left and right are
            exchanged.
    """
    if joint_time_s is not None:
        joints = _at_the_images(head, joints, joint_time_s)
    accuracy = head.accuracy or Accuracy(method="paper")
    stated = bool(accuracy.parameters)
    seen = _linearised(head, left, right, joints, cameras, parameters=stated)
    covariance = np.full((len(seen.points), 3, 3), np.nan)
    if stated or pixel_std_px is not None or joint_std_rad is not None:
        if pixel_std_px is None:
            pixel_std_px = accuracy.pixel_std_px or 0.0
        if joint_std_rad is None:
            count = 2 if measured(joints) else 4
            joint_std_rad = np.tile(accuracy.joint_std or (0.0,), 4)[:count]
        covariance = _of_noise(seen, pixel_std_px, joint_std_rad)
    if stated:
        covariance = covariance + _of_calibration(seen, head, accuracy)
    return LocatedPoints(seen.points, covariance, seen.status)


def _at_the_images(head: HeadCalibration, joints: Array, joint_time_s: Array) -> Array:
    """Return joint readings (N, 4) at the moments of the images; VergenceError: see `locate`."""
    if joints.shape != (len(joint_time_s), 4):
        raise VergenceError(
            f"Readings that have time stamps are one for each: found {joints.shape} readings and "
            f"{len(joint_time_s)} time stamps."
        )
    steps = np.diff(joint_time_s)
    if not np.isfinite(joint_time_s).all() or (steps < 0).any() or (steps > MAX_GAP_S).any():
        raise VergenceError(
            f"Time stamps of a motion increase by at most {MAX_GAP_S} s from reading to reading, "
            f"found {steps.min():.3g} to {steps.max():.3g} s; locate each motion by itself."
        )
    distinct, which = np.unique(joint_time_s, return_inverse=True)  # points of one image
    first = np.searchsorted(joint_time_s, distinct)
    timing = Timing(distinct, np.ones(len(distinct), dtype=int))
    return moved_readings(joints[first], timing, head.time_offset_s)[which]


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
    seen = _linearised(head, left, right, joints, cameras, parameters=False)
    return seen.points, _of_noise(seen, pixel_std_px, joint_std_rad)


def locate_jointly(
    head: HeadCalibration,
    *,
    left: Array,
    right: Array,
    joints: Array,
    parameters: Sequence[str],
    covariance: Array,
    pixel_std_px: ArrayLike,
    cameras: tuple[str, str] | None = None,
) -> LocatedPoints:
    """Return where points are, if head and readings were estimated together.

    The covariance (P + r, P + r) is of the named parameters of the head, then of the r readings
    (r,) [rad] of the one posture that serves all points. Other arguments and errors are those of
    `locate`.
    """
    seen = _linearised(head, left, right, joints, cameras, parameters=True)
    names = parameter_names(head)
    columns = [names.index(name) for name in parameters]
    own = np.concatenate([seen.by_parameters[..., columns], seen.by_readings], axis=-1)
    pixels = np.broadcast_to(np.asarray(pixel_std_px, dtype=float), (len(seen.points), 4))
    both = _covariance(seen.by_pixels, pixels) + own @ covariance @ np.swapaxes(own, 1, 2)
    return LocatedPoints(seen.points, both, seen.status)


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
    seen = _linearised(head, *pixels, both, cameras, parameters=False)
    pixel_stds = np.broadcast_to(np.asarray(pixel_std_px, dtype=float), (n, 4))
    a, b = np.split(seen.by_readings, 2)
    covariances = _covariance(a - b, _reading_stds(seen, joint_std_rad)[:n])
    for by_pixels in np.split(seen.by_pixels, 2):
        covariances = covariances + _covariance(by_pixels, pixel_stds)
    points_a, points_b = np.split(seen.points, 2)
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
    seen = _linearised(head, left, right, joints, cameras, parameters=True)
    return _of_calibration(seen, head, accuracy)


@dataclass(frozen=True, eq=False)
class _Linearised:
    """N located points, and how they change with all that they depend on; NaN: not located.

    The pixels weigh as in Eqs. 3-4: undistorted, and by the distance from the camera. To first
    order: of rays that pass each other far off, derivatives are those of rays that meet.
    """

    points: Array
    """(N, 3)."""
    status: np.ndarray
    """(N,)."""
    by_pixels: Array
    """(N, 3, 4) with left u, left v, right u, right v."""
    by_readings: Array
    """(N, 3, r) with the readings, or the increments of both measured poses (r = 12)."""
    by_parameters: Array
    """(N, 3, P) with the parameters of the head; P is 0 where they are not wanted."""


def _linearised(
    head: HeadCalibration,
    left: Array,
    right: Array,
    joints: Array,
    cameras: tuple[str, str] | None,
    *,
    parameters: bool,
) -> _Linearised:
    """Locate points; `parameters`: whether the derivatives by the head's are wanted too."""
    points, status = triangulate_at(head, left=left, right=right, joints=joints, cameras=cameras)
    found = status == Status.OK
    joints = np.asarray(joints, dtype=float)
    if joints.ndim not in (1, 3):  # one for each point
        joints = joints[found]
    n = int(found.sum())
    T, by_axes, by_reading = eye_poses_with_jacobians(head, joints, n)
    by_point, by_pixels, by_readings, by_head = [], [], [], []
    pair = cameras or main_pair(head) or ()
    names = parameter_names(head) if parameters else ()
    for k, mounted in enumerate(stereo_cameras(head, cameras)):
        lens = mounted.intrinsics
        J = project_with_jacobians(mounted, head.T_rbase_lbase, T[:, k], points[found][:, None])
        # By how much an undistorted pixel moves with a pixel.
        distortion = J.by_in_camera[:, 0, :, :2] * J.in_camera[:, 0, 2, None, None]
        weights = lens.matrix[:2, :2] @ np.linalg.inv(distortion)
        # A point's derivatives fall with its distance.
        slope = np.linalg.norm(weights @ J.by_point[:, 0], axis=(1, 2)) / lens.matrix[0, 0]
        weights /= slope[:, None, None]
        of_pixels = np.zeros((n, 2, 4))
        of_pixels[:, :, 2 * k : 2 * k + 2] = -weights
        of_head = np.zeros((n, 2, len(names)))
        if parameters:
            columns = camera_columns(head, pair[k])
            of_head[:, :, columns] = weights @ by_parameters(J, by_axes[:, k])[:, 0]
        by_point.append(weights @ J.by_point[:, 0])
        by_pixels.append(of_pixels)
        by_readings.append(weights @ J.by_T_base_eye[:, 0] @ by_reading[:, k])
        by_head.append(of_head)
    # The point makes up for what changes, so that its projection stays where it was seen.
    follows = -np.linalg.pinv(np.concatenate(by_point, axis=1))
    changes = []
    for rows in (by_pixels, by_readings, by_head):
        change = np.full((len(points), 3, rows[0].shape[-1]), np.nan)
        change[found] = follows @ np.concatenate(rows, axis=1)
        changes.append(change)
    return _Linearised(points, status, *changes)


def _covariance(change: Array, stds: Array) -> Array:
    """Return covariances (N, 3, 3) from changes (N, 3, K) and standard deviations (N, K)."""
    scaled = change * stds[:, None]
    return scaled @ np.swapaxes(scaled, 1, 2)


def _of_noise(seen: _Linearised, pixel_std_px: ArrayLike, joint_std: ArrayLike) -> Array:
    """Return the covariances (N, 3, 3) that the noise of pixels and readings makes."""
    n = len(seen.points)
    readings = _reading_stds(seen, joint_std)
    pixels = np.broadcast_to(np.asarray(pixel_std_px, dtype=float), (n, 4))
    return _covariance(seen.by_pixels, pixels) + _covariance(seen.by_readings, readings)


def _reading_stds(seen: _Linearised, joint_std: ArrayLike) -> Array:
    """Return the standard deviations (N, r) of readings; of poses from rotation, translation."""
    n, _, count = seen.by_readings.shape
    std = np.asarray(joint_std, dtype=float)
    if count == 12:
        std = np.tile(np.repeat(np.broadcast_to(std, (2,)), 3), 2)
    return np.broadcast_to(std, (n, count))


def _of_calibration(seen: _Linearised, head: HeadCalibration, accuracy: Accuracy) -> Array:
    """Return covariances (N, 3, 3) that the calibration's covariance makes."""
    names = parameter_names(head)
    own = seen.by_parameters[..., [names.index(name) for name in accuracy.parameters]]
    return own @ accuracy.covariance @ np.swapaxes(own, 1, 2)
