"""The one place where a point in front of the head becomes a pixel of one of its cameras.

`pixel = lens(T_cam_eye T_eye_base(joints) T_base_lbase p_lbase)`, for one point, for many or for a
board, with the derivatives by all that a calibration estimates; and the pose of the camera. Points
are in the left eye's base frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.geometry.batches import batch_first, batch_last, product, times, times_transposed
from vergence.geometry.camera import in_valid_field, project, project_jacobians
from vergence.geometry.head import HeadCalibration, MountedCamera
from vergence.geometry.kinematics import Side, check_turns, eye_pose
from vergence.geometry.se3 import checked_points, cross, inverse


def project_point(head: HeadCalibration, camera: str, joints: Array, points: Array) -> Array:
    """Compute the pixels (..., 2) of points in a camera, distortion included.

    Args:
        head: that has a camera of this name.
        camera: its name.
        joints: (..., r) joint readings [rad] in the order of head.kinematics.readings.
        points: (..., 3) [m] in the left eye's base frame; leading dimensions broadcast with those
            of the joints.

    Returns NaN for points that are not in front of the camera, or beyond the reach of its lens
    model. Raises VergenceError for an unknown camera, invalid readings or shapes that do not fit.
    """
    mounted = head.camera(camera)
    T = eye_pose(head.kinematics, mounted.eye, joints)
    check_turns(head.kinematics, np.asarray(joints, dtype=float))
    points = checked_points(points, T.shape[:-2])
    *_, in_camera = _way(mounted, head.T_rbase_lbase, T, points)
    shown = in_valid_field(mounted.intrinsics, *batch_last(in_camera))
    return np.where(shown[..., None], project(mounted.intrinsics, in_camera), np.nan)


def project_at(
    mounted: MountedCamera, T_rbase_lbase: Array, T_base_eye: Array, points: Array
) -> Array:
    """Compute pixels (..., K, 2) of points (..., K, 3) [m] in the left eye's base, by eye poses."""
    *_, in_camera = _way(mounted, T_rbase_lbase, T_base_eye[..., None, :, :], points)
    return project(mounted.intrinsics, in_camera)


def _way(
    mounted: MountedCamera, T_rbase_lbase: Array, T_base_eye: Array, points: Array
) -> tuple[Array, Array, Array, Array]:
    """Follow points (..., 3) from the left eye's base to frame cam, at four stages.

    From the origin of the base of the camera's eye and from the eye's origin, both along the axes
    of that base; from the camera, along the axes of the eye; and in frame cam.
    """
    if mounted.eye == "right":
        turned = times(T_rbase_lbase[:3, :3], points)
        arm = turned - (T_base_eye[..., :3, 3] - T_rbase_lbase[:3, 3])
    else:
        turned, arm = points, points - T_base_eye[..., :3, 3]
    from_camera = times_transposed(T_base_eye[..., :3, :3], arm) - mounted.T_eye_cam[:3, 3]
    return turned, arm, from_camera, times_transposed(mounted.T_eye_cam[:3, :3], from_camera)


@dataclass(frozen=True, eq=False)
class ProjectionJacobians:
    """Pixels of points, and derivatives; poses change as in `se3.boxplus`."""

    pixels: Array
    """(..., 2); NaN for points that are not in front of the camera."""
    by_lens: Array
    """(..., 2, n) by the intrinsics, in the order of `camera.intrinsics_names`."""
    by_T_eye_cam: Array
    """(..., 2, 6)."""
    by_T_base_eye: Array
    """(..., 2, 6)."""
    by_T_rbase_lbase: Array
    """(..., 2, 6); zero for a camera of the left eye."""
    by_point: Array
    """(..., 2, 3) by the point in the left eye's base frame."""


def project_with_jacobians(
    mounted: MountedCamera,
    T_rbase_lbase: Array,
    T_base_eye: Array,
    points: Array,
    *,
    parameters: bool = True,
) -> ProjectionJacobians:
    """Project points (..., 3) of the left eye's base, with derivatives by all that moves pixels.

    The points broadcast with poses (..., 4, 4) of the camera's eye in its base. Without
    `parameters`, derivatives by lens, T_eye_cam and T_rbase_lbase have no columns.
    """
    turned, arm, from_camera, in_camera = _way(mounted, T_rbase_lbase, T_base_eye, points)
    pixels, by_cam, by_lens = project_jacobians(
        mounted.intrinsics, in_camera, intrinsics=parameters
    )
    by_eye = product(by_cam, mounted.T_eye_cam[:3, :3].T)
    by_base = product(by_eye, T_base_eye[..., :3, :3].swapaxes(-1, -2))
    right = mounted.eye == "right"
    no_columns = np.empty((2, 0))
    between = by_mounting = no_columns
    if parameters:
        by_mounting = _by_pose(by_eye, from_camera)
        nothing = np.broadcast_to(0.0, (*by_base.shape[:-1], 6))
        between = by_pose_of_points(by_base, turned) if right else nothing
    return ProjectionJacobians(
        pixels=pixels,
        by_lens=by_lens,
        by_T_eye_cam=by_mounting,
        by_T_base_eye=_by_pose(by_base, arm),
        by_T_rbase_lbase=between,
        by_point=product(by_base, T_rbase_lbase[:3, :3]) if right else by_base,
    )


def _by_pose(by_point: Array, arm: Array) -> Array:
    """Compute derivatives (..., 2, 6) by the pose of a frame, of pixels of a point that stays.

    Derivatives by the point (..., 2, 3) and its arm (..., 3) from the frame's origin are along the
    axes of the increment.
    """
    found = batch_first(np.empty((2, 6, *by_point.shape[:-2])), 2)
    for k in (0, 1):
        found[..., k, :3] = cross(by_point[..., k, :], arm)
    np.negative(by_point, out=found[..., 3:])
    return found


def by_pose_of_points(by_point: Array, turned: Array) -> Array:
    """Compute derivatives (..., 2, 6) by the pose of a body to which the points are fixed.

    The points (..., 3) from the body's origin are turned into the frame that its pose maps into.
    """
    found = batch_first(np.empty((2, 6, *by_point.shape[:-2])), 2)
    for k in (0, 1):
        found[..., k, :3] = cross(turned, by_point[..., k, :])
    found[..., 3:] = by_point
    return found


def camera_pose(mounted: MountedCamera, T_rbase_lbase: Array, T_base_eye: Array) -> Array:
    """Compute poses (..., 4, 4) of a camera in the left eye's base, at those of its eye."""
    return product(eye_pose_in_left_base(mounted.eye, T_rbase_lbase, T_base_eye), mounted.T_eye_cam)


def eye_pose_in_left_base(eye: Side, T_rbase_lbase: Array, T_base_eye: Array) -> Array:
    """Compute poses (..., 4, 4) of an eye in the left eye's base, at those in its own base."""
    return T_base_eye if eye == "left" else product(inverse(T_rbase_lbase), T_base_eye)
