"""Stereo that follows moving eyes (Sec. II-C): pixels and joint readings in, points out.

Equation numbers are the paper's; docs/equations.md says where its printed forms were mended.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera, undistort
from vergence.geometry.head import HeadCalibration, T_body_base, T_head_base
from vergence.geometry.kinematics import T_base_eye
from vergence.geometry.se3 import inverse, transform


class Status(IntEnum):
    """What became of one sample."""

    OK = 0
    NOT_SEEN = 1
    """A pixel or a joint reading is NaN, or a pixel lies beyond the lens model's reach."""
    PARALLEL = 2
    """The two rays are parallel to within what the arithmetic can tell apart."""
    BEHIND = 3
    """The rays meet behind a camera."""


@dataclass(frozen=True, eq=False)
class Located:
    """Estimates of N samples."""

    points: Array
    """(N, 3) [m], NaN where the status is not OK."""
    status: np.ndarray
    """(N,) of Status."""


def fixed_transform(
    T_base_eye_r: Array,
    T_eye_cam_r: Array,
    T_rcam_lcam: Array,
    T_eye_cam_l: Array,
    T_base_eye_l: Array,
) -> Array:
    """Eq. 10: T_rbase_lbase from the static stereo pose and the eye poses at which it was taken."""
    return T_base_eye_r @ T_eye_cam_r @ T_rcam_lcam @ inverse(T_eye_cam_l) @ inverse(T_base_eye_l)


def camera_transform(
    T_base_eye_r: Array,
    T_eye_cam_r: Array,
    T_rbase_lbase: Array,
    T_eye_cam_l: Array,
    T_base_eye_l: Array,
) -> Array:
    """Eq. 11: T_rcam_lcam (..., 4, 4) at the current eye poses; the inverse of Eq. 10."""
    T_rcam_rbase = inverse(T_base_eye_r @ T_eye_cam_r)
    return T_rcam_rbase @ T_rbase_lbase @ T_base_eye_l @ T_eye_cam_l


def triangulate(
    pixels_l: Array, pixels_r: Array, left: Camera, right: Camera, T_rcam_lcam: Array
) -> Located:
    """Solve Eqs. 3-4 for the points in the left camera's frame, by linear least squares.

    Each camera gives two equations that are linear in the point: with m1, m2, m3 the rows of
    its 3 x 4 matrix A [R t], (u m3 - m1) y = 0 and (v m3 - m2) y = 0.

    Args:
        pixels_l: (N, 2) as seen, distortion included.
        pixels_r: (N, 2) likewise.
        left: intrinsics of the left camera.
        right: intrinsics of the right camera.
        T_rcam_lcam: (N, 4, 4) or (4, 4) pose of the left camera in the right one.
    """
    u_l, u_r = undistort(left, pixels_l), undistort(right, pixels_r)
    n = max(len(u_l), len(T_rcam_lcam) if T_rcam_lcam.ndim == 3 else 1)
    P_l = np.broadcast_to(np.hstack([left.matrix, np.zeros((3, 1))]), (n, 3, 4))
    P_r = np.broadcast_to(right.matrix @ T_rcam_lcam[..., :3, :], (n, 3, 4))
    rows = np.concatenate(
        [u[:, :, None] * P[:, 2:, :] - P[:, :2, :] for u, P in ((u_l, P_l), (u_r, P_r))], axis=1
    )  # (N, 4, 4): four equations, (x, y, z, 1)
    seen = np.asarray(np.isfinite(rows).all(axis=(1, 2)))
    rows = np.where(seen[:, None, None], rows, np.eye(4))
    M, b = rows[:, :, :3], -rows[:, :, 3:]
    # The scaled system's smallest singular value vanishes when the rays are parallel.
    Q, R = np.linalg.qr(M)
    singular = np.linalg.svd(M, compute_uv=False)
    parallel = singular[:, 2] < 1e-12 * singular[:, 0]
    R = np.where(parallel[:, None, None], np.eye(3), R)
    points = np.linalg.solve(R, np.swapaxes(Q, 1, 2) @ b)[:, :, 0]
    behind = (points[:, 2] <= 0) | (transform(T_rcam_lcam, points)[:, 2] <= 0)
    status = np.select([~seen, parallel, behind], [Status.NOT_SEEN, Status.PARALLEL, Status.BEHIND])
    return Located(np.where((status == Status.OK)[:, None], points, np.nan), status)


def locate(
    calibration: HeadCalibration,
    pixels_l: Array,
    pixels_r: Array,
    eye_angles: Array,
    *,
    cameras: tuple[str, str] = ("left_wide", "right_wide"),
) -> Located:
    """Return where points seen by both eyes are, from the left eye's rotation centre.

    Args:
        calibration: of the head.
        pixels_l: (N, 2) pixels in the left camera, distortion included; NaN: not seen.
        pixels_r: (N, 2) pixels in the right camera.
        eye_angles: (N, 4) joint readings [rad] in the order of kinematics.EYE_JOINTS.
        cameras: names of the left and the right camera.

    Returns:
        Points in the left eye's base frame (Eqs. 3, 4, 11, and 12 without the neck).

    Raises:
        VergenceError: shapes do not fit, or the head has no such camera.
    """
    check_shapes(pixels_l, pixels_r, eye_angles)
    mounted_l, mounted_r = (calibration.camera(name) for name in cameras)
    readable = np.isfinite(eye_angles).all(axis=1, keepdims=True)
    angles = np.where(readable, eye_angles, 0.0)
    T_lbase_eye = T_base_eye(angles[:, :2], calibration.axes[mounted_l.eye])
    T_rbase_eye = T_base_eye(angles[:, 2:], calibration.axes[mounted_r.eye])
    T_rcam_lcam = camera_transform(
        T_rbase_eye,
        mounted_r.T_eye_cam,
        calibration.T_rbase_lbase,
        mounted_l.T_eye_cam,
        T_lbase_eye,
    )
    located = triangulate(
        np.where(readable, pixels_l, np.nan),
        pixels_r,
        mounted_l.intrinsics,
        mounted_r.intrinsics,
        T_rcam_lcam,
    )
    T_lbase_lcam = T_lbase_eye @ mounted_l.T_eye_cam
    return Located(transform(T_lbase_lcam, located.points), located.status)


def check_shapes(pixels_l: Array, pixels_r: Array, eye_angles: Array) -> None:
    """Raise VergenceError unless these are what `locate` takes."""
    for name, array, width in (
        ("pixels_l", pixels_l, 2),
        ("pixels_r", pixels_r, 2),
        ("eye_angles", eye_angles, 4),
    ):
        if array.ndim != 2 or array.shape != (len(pixels_l), width):
            raise VergenceError(
                f"locate needs {name} of shape ({len(pixels_l)}, {width}), found {array.shape}."
            )


def in_head(calibration: HeadCalibration, points_lbase: Array) -> Array:
    """Map points (..., 3) from the left eye's base frame into frame head."""
    return transform(T_head_base(calibration, "left"), points_lbase)


def in_body(calibration: HeadCalibration, points_lbase: Array, neck_angles: Array) -> Array:
    """Eq. 12: map points (..., 3) from the left eye's base frame into frame body.

    Args:
        calibration: of the head.
        points_lbase: (..., 3) [m].
        neck_angles: (..., n) [rad], in the order of the neck's chain.
    """
    return transform(T_body_base(calibration, "left", neck_angles), points_lbase)
