"""The one place where a point in front of the head becomes a pixel of one of its cameras.

`pixel = lens(T_cam_eye T_eye_base(joints) T_base_lbase p_lbase)`, for one point, for many or for a
board, with the derivatives by all that a calibration estimates; and the pose of the camera. Points
are in the left eye's base frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vergence.arrays import Array
from vergence.geometry import se3
from vergence.geometry.camera import in_reach, pixel_rows, projection_rows
from vergence.geometry.components import (
    Component,
    Rows,
    Vector,
    components,
    cross,
    minus,
    plus,
    pose_components,
    product,
    stacked,
    times,
    transposed,
    where,
)
from vergence.geometry.eye_motion import EyeMotion
from vergence.geometry.head import HeadCalibration, MountedCamera
from vergence.geometry.kinematics import Side, T_base_eye, check_turns
from vergence.geometry.se3 import checked_points, inverse


def project_point(head: HeadCalibration, camera: str, joints: Array, points: Array) -> Array:
    """Return the pixels (..., 2) of points in a camera, distortion included.

    Args:
        head: that has a camera of this name.
        camera: its name.
        joints: (..., r) joint readings [rad] in the order of head.kinematics.readings.
        points: (..., 3) [m] in the left eye's base frame; leading dimensions broadcast with those
            of the joints.

    Returns:
        NaN for points that are not in front of the camera, or beyond the reach of its lens model,
        where this folds over.

    Raises:
        VergenceError: the head has no such camera, the readings are not as many as the head has, or
            not in radians, or the shapes do not fit.
    """
    mounted = head.camera(camera)
    T = T_base_eye(head.kinematics, mounted.eye, joints)
    check_turns(head.kinematics, np.asarray(joints, dtype=float))
    points = checked_points(points, T.shape[:-2])
    in_camera, shape = _in_camera(mounted, head.T_rbase_lbase, T, points)
    shown = in_reach(mounted.intrinsics, *in_camera)
    pixel = [where(shown, each) for each in pixel_rows(mounted.intrinsics, in_camera)]
    return np.moveaxis(stacked(pixel, shape), 0, -1)


def project_at(
    mounted: MountedCamera, T_rbase_lbase: Array, T_base_eye: Array, points: Array
) -> Array:
    """Return pixels (..., K, 2) of points (..., K, 3) [m] in the left eye's base, by eye poses."""
    T = T_base_eye[..., None, :, :]
    in_camera, shape = _in_camera(mounted, T_rbase_lbase, T, points)
    return np.moveaxis(stacked(pixel_rows(mounted.intrinsics, in_camera), shape), 0, -1)


def _in_camera(
    mounted: MountedCamera, T_rbase_lbase: Array, T_base_eye: Array, points: Array
) -> tuple[Vector, tuple[int, ...]]:
    """Return points (..., 3) [m] of the left eye's base in frame cam, by components, and (...)."""
    R, t = pose_components(T_base_eye)
    point = components(np.moveaxis(points, -1, 0))
    shape = np.broadcast_shapes(T_base_eye.shape[:-2], points.shape[:-1])
    return _through(mounted, T_rbase_lbase, R, t, point)[-1], shape


def _through(
    mounted: MountedCamera, T_rbase_lbase: Array, R: Rows, t: Vector, point: Vector
) -> tuple[Vector, Vector, Vector, Vector]:
    """Return a point at four stages on its way from the left eye's base to frame cam.

    From the left base's origin and from the eye's origin, both along the axes of the base of the
    camera's eye; from the camera, along the axes of the eye; and in frame cam. The pose of the eye
    in its base is R, t.
    """
    turned = point
    if mounted.eye == "right":
        turned = times(T_rbase_lbase[:3, :3].tolist(), point)
        t = minus(t, T_rbase_lbase[:3, 3].tolist())
    arm = minus(turned, t)
    R_eye_cam, t_eye_cam = pose_components(mounted.T_eye_cam)
    from_camera = minus(times(transposed(R), arm), t_eye_cam)
    return turned, arm, from_camera, times(transposed(R_eye_cam), from_camera)


@dataclass(frozen=True, eq=False)
class ProjectionJacobians:
    """Pixels of K points in M postures, and derivatives; poses change as in `se3.boxplus`."""

    pixels: Array
    """(M, K, 2); NaN for points that are not in front of the camera."""
    by_lens: Array
    """(M, K, 2, n) by the intrinsics, in the order of `parameter_names.intrinsics_names`."""
    by_T_eye_cam: Array
    """(M, K, 2, 6)."""
    by_T_base_eye: Array
    """(M, K, 2, 6)."""
    by_T_rbase_lbase: Array
    """(M, K, 2, 6); zero for a camera of the left eye."""
    by_point: Array
    """(M, K, 2, 3) by the point in the left eye's base frame."""


class ProjectionRows(NamedTuple):
    """A pixel and its derivatives by components: what ProjectionJacobians has, for u and for v."""

    pixel: Vector
    by_lens: Rows
    by_T_eye_cam: Rows
    by_T_base_eye: Rows
    by_T_rbase_lbase: Rows
    by_point: Rows


def project_with_jacobians(
    mounted: MountedCamera, T_rbase_lbase: Array, T_base_eye: Array, points: Array
) -> ProjectionJacobians:
    """Return pixels and their derivatives by everything that lies between point and pixel.

    The arguments are those of project_at: M poses (M, 4, 4), points (M, K, 3). All are views of
    arrays whose components come first.
    """
    shape = points.shape[:-1]
    pose, p = pose_components(T_base_eye[:, None]), components(np.moveaxis(points, -1, 0))
    found = projected(mounted, T_rbase_lbase, *pose, p)
    return ProjectionJacobians(
        *(
            stacked(each, shape, ndim).transpose(*range(ndim, ndim + 2), *range(ndim))
            for each, ndim in zip(found, (1, 2, 2, 2, 2, 2), strict=True)
        )
    )


def projected(
    mounted: MountedCamera,
    T_rbase_lbase: Array,
    R: Rows,
    t: Vector,
    point: Vector,
    *,
    parameters: bool = True,
) -> ProjectionRows:
    """Return the pixel of a point in the left eye's base, and its derivatives, by components.

    The pose of the camera's eye in its base is R, t. Where the derivatives by lens, T_eye_cam and
    T_rbase_lbase are not wanted, these have no columns.
    """
    turned, arm, from_camera, in_camera = _through(mounted, T_rbase_lbase, R, t, point)
    pixel, by_cam, by_lens = projection_rows(mounted.intrinsics, in_camera, intrinsics=parameters)
    R_eye_cam = mounted.T_eye_cam[:3, :3].tolist()
    by_eye = [times(R_eye_cam, row) for row in by_cam]
    by_base = [times(R, row) for row in by_eye]
    by_point, between, mounting = by_base, ((), ()), ((), ())
    if mounted.eye == "right":
        back = transposed(T_rbase_lbase[:3, :3].tolist())
        by_point = [times(back, row) for row in by_base]
    if parameters:
        mounting = _by_increment(by_eye, from_camera)
        between = ([0.0] * 6, [0.0] * 6)
        if mounted.eye == "right":
            between = [[*cross(turned, row), *row] for row in by_base]
    by_eye_pose = _by_increment(by_base, arm)
    return ProjectionRows(pixel, by_lens, mounting, by_eye_pose, between, by_point)


def _by_increment(by_point: Rows, arm: Vector) -> Rows:
    """Return derivatives (2, 6) by the pose of a frame, of a pixel that shows a fixed point in it.

    Args:
        by_point: (2, 3) derivatives by the point, along the axes of the increment.
        arm: (3) the point from the frame's origin, along the same axes.
    """
    return [[*cross(row, arm), -row[0], -row[1], -row[2]] for row in by_point]


def by_pose_of_points(by_point: Array, turned: Array) -> Array:
    """Return derivatives (M, K, 2, 6) by the pose of a body to which the points are fixed.

    Args:
        by_point: (M, K, 2, 3) derivatives by the points.
        turned: (M, K, 3) the points from the body's origin, along the axes of the frame that its
            pose maps into.
    """
    return np.concatenate([se3.cross(turned[:, :, None], by_point), by_point], axis=-1)


def by_parameters(J: ProjectionJacobians, by_axes: Array) -> Array:
    """Return derivatives (M, K, 2, n + 12 + a) by what a camera's pixels depend on in a head.

    In the order of `parameters.camera_columns`; by_axes (M, 6, a) are those of T_base_eye by the
    errors of the eye's joints.
    """
    by_eye = rows_times(J.by_T_base_eye, by_axes)
    parts = (J.by_lens, J.by_T_eye_cam, J.by_T_rbase_lbase, by_eye)
    whole = np.concatenate([part.transpose(2, 3, 0, 1) for part in parts], axis=1)
    return whole.transpose(2, 3, 0, 1)


def by_increments(rows: Rows, increments: Sequence[Vector]) -> list[tuple[Component, Component]]:
    """Return derivatives of u and v by increments of a pose, given those by the pose (2, 6)."""
    u, v = rows
    return [(_inner(u, xi), _inner(v, xi)) for xi in increments]


def by_camera_columns(
    own: ProjectionRows, eye: EyeMotion, by_angles: Sequence[tuple[Component, Component]]
) -> list[tuple[Component, Component]]:
    """Return derivatives of u and v in the order of `parameters.camera_columns`.

    Args:
        own: the camera's pixel and its derivatives.
        eye: the motion of its eye.
        by_angles: derivatives of u and v by the angles of the eye's joints, of `by_increments`.
    """
    columns = [
        pair
        for rows in (own.by_lens, own.by_T_eye_cam, own.by_T_rbase_lbase)
        for pair in zip(*rows, strict=True)
    ]
    for joint, change in eye.by_errors:
        if joint is None:
            columns += by_increments(own.by_T_base_eye, [change])
        else:
            u, v = by_angles[joint]
            columns.append((u * change, v * change))
    return columns


def _inner(row: Vector, xi: Vector) -> Component:
    a, b, c, d, e, f = row
    wx, wy, wz, x, y, z = xi
    return a * wx + b * wy + c * wz + d * x + e * y + f * z


def rows_times(rows: Array, matrix: Array) -> Array:
    """Return each row of (M, K, 2, n) times the matrix (M, n, m) of its posture."""
    first, factors = rows.transpose(2, 3, 0, 1), matrix.transpose(1, 2, 0)[..., None]
    return np.add.reduce(first[:, :, None] * factors, axis=1).transpose(2, 3, 0, 1)


def T_lbase_cam(mounted: MountedCamera, T_rbase_lbase: Array, T_base_eye: Array) -> Array:
    """Return poses (..., 4, 4) of a camera in the left eye's base, at those of its eye."""
    return T_lbase_eye(mounted.eye, T_rbase_lbase, T_base_eye) @ mounted.T_eye_cam


def T_lbase_eye(eye: Side, T_rbase_lbase: Array, T_base_eye: Array) -> Array:
    """Return poses (..., 4, 4) of an eye in the left eye's base, at those in its own base."""
    return T_base_eye if eye == "left" else inverse(T_rbase_lbase) @ T_base_eye


def camera_pose(
    mounted: MountedCamera, T_rbase_lbase: Array, R: Rows, t: Vector
) -> tuple[Rows, Vector]:
    """Return T_lbase_cam by components: rotation and centre of a camera.

    The pose of its eye in its base is R, t.
    """
    R_eye_cam, t_eye_cam = pose_components(mounted.T_eye_cam)
    centre, R = plus(t, times(R, t_eye_cam)), product(R, R_eye_cam)
    if mounted.eye == "left":
        return R, centre
    R_rbase_lbase, shift = pose_components(T_rbase_lbase)
    back = transposed(R_rbase_lbase)
    return product(back, R), times(back, minus(centre, shift))
