"""A point before the head becomes a pixel of one of its cameras: the one place for it.

`pixel = lens(T_cam_eye T_eye_base(joints) T_base_lbase p_lbase)`, for one point, for many, for a
board, with the derivatives by all that a calibration estimates; and how two cameras stand to each
other at any posture of the eyes (Eqs. 10 and 11). Points are in the left eye's base frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.camera import project, project_jacobians
from vergence.geometry.head import HeadCalibration, MountedCamera, main_pair
from vergence.geometry.kinematics import EYES, T_base_eye, eye_linearised
from vergence.geometry.parameters import axes_names
from vergence.geometry.se3 import cross, inverse


def project_point(head: HeadCalibration, camera: str, joints: Array, points: Array) -> Array:
    """Return the pixels (..., 2) of points in a camera, distortion included.

    Args:
        head: that has a camera of this name.
        camera: its name.
        joints: (..., r) joint readings [rad] in the order of head.kinematics.readings.
        points: (..., 3) [m] in the left eye's base frame; leading dimensions broadcast with those
            of the joints.

    Returns:
        NaN for points that are not in front of the camera.

    Raises:
        VergenceError: the head has no such camera.
    """
    mounted = head.camera(camera)
    T = T_base_eye(head.kinematics, mounted.eye, joints)
    return project_at(mounted, head.T_rbase_lbase, T, points[..., None, :])[..., 0, :]


def project_at(
    mounted: MountedCamera, T_rbase_lbase: Array, T_base_eye: Array, points: Array
) -> Array:
    """Return pixels (..., K, 2) of points (..., K, 3) [m] in the left eye's base, by eye poses."""
    return project(mounted.intrinsics, _through(mounted, T_rbase_lbase, T_base_eye, points)[-1])


def _through(
    mounted: MountedCamera, T_rbase_lbase: Array, T_base_eye: Array, points: Array
) -> tuple[Array, Array, Array, Array]:
    """Return points (..., K, 3) in four steps from the left eye's base to the camera.

    In the axes of the camera's eye base; from the eye's origin, in that base; from the camera,
    along the axes of the eye; and in frame cam.
    """
    right = mounted.eye == "right"
    turned = points @ T_rbase_lbase[:3, :3].T if right else points
    shift = T_rbase_lbase[:3, 3] if right else 0.0
    arm = turned + shift - T_base_eye[..., None, :3, 3]
    from_camera = arm @ T_base_eye[..., :3, :3] - mounted.T_eye_cam[:3, 3]
    return turned, arm, from_camera, from_camera @ mounted.T_eye_cam[:3, :3]


@dataclass(frozen=True, eq=False)
class ProjectionJacobians:
    """Pixels of K points in M postures, and derivatives; poses change as in `se3.boxplus`."""

    pixels: Array
    """(M, K, 2); NaN for points that are not in front of the camera."""
    by_lens: Array
    """(M, K, 2, n) by the intrinsics, in the order of `parameters.intrinsics_names`."""
    by_T_eye_cam: Array
    """(M, K, 2, 6)."""
    by_T_base_eye: Array
    """(M, K, 2, 6)."""
    by_T_rbase_lbase: Array
    """(M, K, 2, 6); zero for a camera of the left eye."""
    by_point: Array
    """(M, K, 2, 3) by the point in the left eye's base frame."""
    in_camera: Array
    """(M, K, 3) the points in frame cam."""
    by_in_camera: Array
    """(M, K, 2, 3) by the point in frame cam."""


def project_with_jacobians(
    mounted: MountedCamera, T_rbase_lbase: Array, T_base_eye: Array, points: Array
) -> ProjectionJacobians:
    """Return pixels and their derivatives by everything that lies between point and pixel.

    The arguments are those of project_at: M poses (M, 4, 4), points (M, K, 3).
    """
    turned, arm, from_camera, in_camera = _through(mounted, T_rbase_lbase, T_base_eye, points)
    pixels, by_cam, by_lens = project_jacobians(mounted.intrinsics, in_camera)
    by_eye = by_cam @ mounted.T_eye_cam[:3, :3].T
    by_base = rows_times(by_eye, np.swapaxes(T_base_eye[:, :3, :3], -1, -2))
    right = mounted.eye == "right"
    between = by_pose_of_points(by_base, turned)
    return ProjectionJacobians(
        pixels,
        by_lens,
        np.concatenate([cross(by_eye, from_camera[:, :, None]), -by_eye], axis=-1),
        np.concatenate([cross(by_base, arm[:, :, None]), -by_base], axis=-1),
        between if right else np.zeros_like(between),
        by_base @ T_rbase_lbase[:3, :3] if right else by_base,
        in_camera,
        by_cam,
    )


def by_pose_of_points(by_point: Array, turned: Array) -> Array:
    """Return derivatives (M, K, 2, 6) by the pose of a body to which the points are fixed.

    Given are those by the points (M, K, 2, 3), and the points from the body's origin (M, K, 3),
    along the axes of the frame that its pose maps into.
    """
    return np.concatenate([cross(turned[:, :, None], by_point), by_point], axis=-1)


def by_parameters(J: ProjectionJacobians, by_axes: Array) -> Array:
    """Return derivatives (M, K, 2, n + 12 + a) by what a camera's pixels depend on in a head.

    In the order of `parameters.camera_columns`; by_axes (M, 6, a) are those of T_base_eye by the
    errors of the eye's joints.
    """
    by_eye = rows_times(J.by_T_base_eye, by_axes)
    return np.concatenate([J.by_lens, J.by_T_eye_cam, J.by_T_rbase_lbase, by_eye], axis=-1)


def rows_times(rows: Array, matrix: Array) -> Array:
    """Return each row of (M, K, 2, n) times the matrix (M, n, m) of its posture."""
    M, K, _, n = rows.shape  # M is 0 for a camera that sees no board
    return (rows.reshape(M, 2 * K, n) @ matrix).reshape(M, K, 2, matrix.shape[-1])


def base_extrinsics(
    *,
    T_rbase_reye: Array,
    T_reye_rcam: Array,
    T_rcam_lcam: Array,
    T_leye_lcam: Array,
    T_lbase_leye: Array,
) -> Array:
    """Eq. 10: T_rbase_lbase (..., 4, 4) from a static stereo pose and the eye poses of its moment.

    In the paper's symbols T_rbase_reye is T_er^r, T_reye_rcam is T_ec^r and T_rcam_lcam is T_c^rl,
    the static stereo; all are (..., 4, 4).
    """
    return T_rbase_reye @ T_reye_rcam @ T_rcam_lcam @ inverse(T_lbase_leye @ T_leye_lcam)


def stereo_extrinsics(
    *,
    T_rbase_reye: Array,
    T_reye_rcam: Array,
    T_rbase_lbase: Array,
    T_leye_lcam: Array,
    T_lbase_leye: Array,
) -> Array:
    """Eq. 11: T_rcam_lcam (..., 4, 4) at the present eye poses; the inverse of Eq. 10."""
    return inverse(T_rbase_reye @ T_reye_rcam) @ T_rbase_lbase @ T_lbase_leye @ T_leye_lcam


def stereo_cameras(
    head: HeadCalibration, cameras: tuple[str, str] | None
) -> tuple[MountedCamera, MountedCamera]:
    """Return the left and the right camera of a pair of names; None: the main ones.

    VergenceError if one of them is missing, or left and right are exchanged.
    """
    pair = main_pair(head) if cameras is None else cameras
    if pair is None:
        raise VergenceError(
            f"Stereo needs a camera in each eye; this head has {', '.join(head.cameras)}."
        )
    left, right = (head.camera(name) for name in pair)
    if (left.eye, right.eye) != ("left", "right"):
        raise VergenceError(
            f"A stereo pair is a camera of the left eye and one of the right, in this order; "
            f"{pair[0]} sits in the {left.eye} eye and {pair[1]} in the {right.eye} one."
        )
    return left, right


def measured(joints: Array) -> bool:
    """Return whether readings are measured eye poses (..., 2, 4, 4) instead of angles (..., r)."""
    return np.ndim(joints) > 2


def eye_poses(head: HeadCalibration, joints: Array) -> Array:
    """Return T_base_eye (..., 2, 4, 4) of the left and the right eye at readings (..., r) [rad].

    Measured poses (..., 2, 4, 4) are returned as they are.
    """
    if measured(joints):
        return joints
    poses = [T_base_eye(head.kinematics, eye, joints) for eye in EYES]
    return np.stack(poses, axis=-3)


def eye_poses_with_jacobians(
    head: HeadCalibration, joints: Array, n: int
) -> tuple[Array, tuple[Array, Array], Array]:
    """Return T_base_eye (n, 2, 4, 4), and its derivatives by axes and by readings.

    The derivatives by the a errors of the joints (n, 6, a) are a pair, for the left and the right
    eye, in the order of `parameters.axes_names`. Those by the r readings of the head, or by the
    increments of both eyes' measured poses (r = 12), are (n, 2, 6, r). All are in the increment of
    `se3.boxplus`. Readings are (n, r) or (r,) angles [rad], or (n, 2, 4, 4) or (2, 4, 4) poses.
    """
    if measured(joints):
        by_pose = np.broadcast_to(np.eye(12).reshape(2, 6, 12), (n, 2, 6, 12))
        left, right = (np.zeros((n, 6, len(axes_names(head, eye)))) for eye in EYES)
        return np.broadcast_to(joints, (n, 2, 4, 4)), (left, right), by_pose
    angles = np.broadcast_to(joints, (n, joints.shape[-1]))
    left, right = (eye_linearised(head.kinematics, eye, angles) for eye in EYES)
    T, by_readings = (np.stack([left[k], right[k]], axis=1) for k in (0, 2))
    return T, (left[1], right[1]), by_readings


def T_rcam_lcam(
    head: HeadCalibration, joints: Array, *, cameras: tuple[str, str] | None = None
) -> Array:
    """Return Eq. 11 (..., 4, 4) at joint readings (..., r) [rad], or eye poses (..., 2, 4, 4).

    Args:
        head: with a camera in each eye.
        joints: in the order of head.kinematics.readings.
        cameras: names of a camera of the left eye and one of the right; None: the main ones.

    Raises:
        VergenceError: the head has one eye only, has no such camera, or left and right are
            exchanged.
    """
    return stereo_poses(head, joints, cameras=cameras)[1]


def stereo_poses(
    head: HeadCalibration, joints: Array, *, cameras: tuple[str, str] | None = None
) -> tuple[Array, Array]:
    """Return T_lbase_lcam (..., 4, 4) and T_rcam_lcam (..., 4, 4).

    Arguments and errors are those of `T_rcam_lcam`.
    """
    left, right = stereo_cameras(head, cameras)
    T_lbase_leye, T_rbase_reye = np.moveaxis(eye_poses(head, joints), -3, 0)
    T = stereo_extrinsics(
        T_rbase_reye=T_rbase_reye,
        T_reye_rcam=right.T_eye_cam,
        T_rbase_lbase=head.T_rbase_lbase,
        T_leye_lcam=left.T_eye_cam,
        T_lbase_leye=T_lbase_leye,
    )
    return T_lbase_leye @ left.T_eye_cam, T


def rebase(
    head: HeadCalibration,
    T_rcam_lcam: Array,
    *,
    joints: Array,
    cameras: tuple[str, str] | None = None,
) -> HeadCalibration:
    """Return the head with the T_rbase_lbase that a stereo pose demands (Eq. 10).

    The cameras stood at T_rcam_lcam (4, 4) at joint readings (r,) [rad]. Errors are those of
    `stereo_cameras`.
    """
    left, right = stereo_cameras(head, cameras)
    T = base_extrinsics(
        T_rbase_reye=T_base_eye(head.kinematics, "right", joints),
        T_reye_rcam=right.T_eye_cam,
        T_rcam_lcam=T_rcam_lcam,
        T_leye_lcam=left.T_eye_cam,
        T_lbase_leye=T_base_eye(head.kinematics, "left", joints),
    )
    return replace(head, T_rbase_lbase=T)
