"""How two cameras stand to each other at any posture of the eyes (Eqs. 10 and 11)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array, floats
from vergence.geometry.eye_motion import check_joints, eye_poses
from vergence.geometry.head import HeadCalibration, MountedCamera, pair_names
from vergence.geometry.kinematics import eye_pose
from vergence.geometry.projection import camera_pose
from vergence.geometry.se3 import inverse


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


def stereo_cameras(
    head: HeadCalibration, cameras: tuple[str, str] | None
) -> tuple[MountedCamera, MountedCamera]:
    """Look up the left and the right camera of a pair; arguments and errors: see `pair_names`."""
    left, right = pair_names(head, cameras)
    return head.camera(left), head.camera(right)


def relative_camera_pose(
    head: HeadCalibration, joints: ArrayLike, *, cameras: tuple[str, str] | None = None
) -> Array:
    """Compute Eq. 11 (..., 4, 4) at joint readings (..., r) [rad], or eye poses (..., 2, 4, 4).

    `cameras` names one of the left eye and one of the right; None: the main ones. VergenceError if
    the head has no such pair, or the joints are not those of the head, not in radians or not rigid.
    """
    joints = floats("joints", joints)
    left, right = np.moveaxis(camera_poses(head, joints, cameras=cameras), -3, 0)
    check_joints(head.kinematics, joints)
    return inverse(right) @ left


def camera_poses(
    head: HeadCalibration, joints: Array, *, cameras: tuple[str, str] | None = None
) -> Array:
    """Compute T_lbase_cam (..., 2, 4, 4) of a camera of the left eye and one of the right.

    Arguments and errors are those of `relative_camera_pose`.
    """
    pair, eyes = stereo_cameras(head, cameras), eye_poses(head, joints)
    both = [
        camera_pose(mounted, head.T_rbase_lbase, eyes[..., k, :, :])
        for k, mounted in enumerate(pair)
    ]
    return np.stack(both, axis=-3)


def rebase(
    head: HeadCalibration,
    T_rcam_lcam: Array,
    *,
    joints: Array,
    cameras: tuple[str, str] | None = None,
) -> HeadCalibration:
    """Set T_rbase_lbase of a head by a stereo pose (Eq. 10).

    The cameras stood at T_rcam_lcam (4, 4) at joint readings (r,) [rad]. Errors are those of
    `stereo_cameras`.
    """
    left, right = stereo_cameras(head, cameras)
    T = base_extrinsics(
        T_rbase_reye=eye_pose(head.kinematics, "right", joints),
        T_reye_rcam=right.T_eye_cam,
        T_rcam_lcam=T_rcam_lcam,
        T_leye_lcam=left.T_eye_cam,
        T_lbase_leye=eye_pose(head.kinematics, "left", joints),
    )
    return replace(head, T_rbase_lbase=T)
