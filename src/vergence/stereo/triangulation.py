"""Stereo that follows moving eyes (Sec. II-C): pixels and joint readings in, points out.

Equation numbers are the paper's; docs/equations.md says where its printed forms were mended.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera, undistort
from vergence.geometry.head import HeadCalibration, T_body_base, T_head_base
from vergence.geometry.projection import measured, stereo_cameras, stereo_poses
from vergence.geometry.se3 import transform


class Status(IntEnum):
    """What became of one point."""

    OK = 0
    NOT_SEEN = 1
    """A pixel or a joint reading is NaN, or a pixel lies beyond the lens model's reach."""
    PARALLEL = 2
    """The two rays are parallel to within rounding errors."""
    BEHIND = 3
    """The rays meet behind a camera."""


def triangulate(
    *, left: Array, right: Array, left_camera: Camera, right_camera: Camera, T_rcam_lcam: Array
) -> tuple[Array, np.ndarray]:
    """Solve Eqs. 3-4 for the points in the left camera's frame, by linear least squares.

    Each camera gives two equations that are linear in the point: with m1, m2, m3 the rows of
    its 3 x 4 matrix A [R t], (u m3 - m1) y = 0 and (v m3 - m2) y = 0.

    Args:
        left: (N, 2) pixels in the left camera, distortion included; NaN: not seen.
        right: (N, 2) pixels in the right camera.
        T_rcam_lcam: (N, 4, 4) or (4, 4) pose of the left camera in the right one.

    Returns:
        Points (N, 3) [m], NaN where the status is not OK, and the status (N,).
    """
    u_l, u_r = undistort(left_camera, left), undistort(right_camera, right)
    n = len(u_l)
    P_l = np.broadcast_to(np.hstack([left_camera.matrix, np.zeros((3, 1))]), (n, 3, 4))
    P_r = np.broadcast_to(right_camera.matrix @ T_rcam_lcam[..., :3, :], (n, 3, 4))
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
    return np.where((status == Status.OK)[:, None], points, np.nan), status


def triangulate_at(
    head: HeadCalibration,
    *,
    left: Array,
    right: Array,
    joints: Array,
    cameras: tuple[str, str] | None = None,
) -> tuple[Array, np.ndarray]:
    """Return points in the left eye's base frame, and their status (Eqs. 3, 4 and 11).

    Points are (N, 3) [m], NaN where the status (N,) is not OK. Arguments and errors are those of
    `uncertainty.locate`.
    """
    left, right, joints = checked(left, right, joints, len(head.kinematics.readings))
    if measured(joints):
        finite = np.asarray(np.isfinite(joints).all(axis=(-3, -2, -1)))
        usable = np.where(finite[..., None, None, None], joints, np.eye(4))
    else:
        finite = np.asarray(np.isfinite(joints).all(axis=-1))
        usable = np.where(finite[..., None], joints, 0.0)
    readable = finite[..., None]
    T_lbase_lcam, T_rcam_lcam = stereo_poses(head, usable, cameras=cameras)
    left_camera, right_camera = (each.intrinsics for each in stereo_cameras(head, cameras))
    points, status = triangulate(
        left=np.where(readable, left, np.nan),
        right=right,
        left_camera=left_camera,
        right_camera=right_camera,
        T_rcam_lcam=T_rcam_lcam,
    )
    return transform(T_lbase_lcam, points), status


def checked(left: Array, right: Array, joints: Array, r: int) -> tuple[Array, Array, Array]:
    """Return float arrays; VergenceError if they are not (N, 2), (N, 2) and readings.

    These are angles (r,) or (N, r), or measured eye poses (2, 4, 4) or (N, 2, 4, 4).
    """
    left, right, joints = (np.asarray(each, dtype=float) for each in (left, right, joints))
    n = len(left) if left.ndim else 0
    for name, array, shapes in (
        ("left", left, [(n, 2)]),
        ("right", right, [(n, 2)]),
        ("joints", joints, [(n, r), (r,), (n, 2, 4, 4), (2, 4, 4)]),
    ):
        if array.shape not in shapes:
            raise VergenceError(
                f"Locating {n} points needs {name} of shape {' or '.join(map(str, shapes))}, found "
                f"{array.shape}."
            )
    return left, right, joints


def in_head(head: HeadCalibration, points_lbase: Array) -> Array:
    """Map points (..., 3) [m] from the left eye's base frame into frame head."""
    return transform(T_head_base(head, "left"), points_lbase)


def in_body(head: HeadCalibration, points_lbase: Array, neck_angles: Array) -> Array:
    """Eq. 12: map points (..., 3) [m] from the left eye's base frame into frame body.

    The neck's angles (..., n) [rad] are in the order of its chain.
    """
    return transform(T_body_base(head, "left", neck_angles), points_lbase)
