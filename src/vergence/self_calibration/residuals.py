"""Residuals of matched pixels, and their derivatives by the head and its readings.

Between the eyes: a match is four numbers (left u, v, right u, v) that depend on a point (3) and on
the geometry. The one combination of them that no displacement of the point changes is the residual:
to first order the distance in the space of the four pixel coordinates to the nearest match that
fits (Sampson's distance). It is taken at the point that the match shows, not at the pixels as
measured: then its derivatives do not share the noise of the residual, which would pull at the
focal lengths.

Over time, in one eye: a camera that turns with its eye is displaced by millimetres, so that a point
of about known depth tells both coordinates of its later pixel. They show how far the eye has
turned, and with it focal length, mounting and gains, in any motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.geometry.camera import normalise
from vergence.geometry.eye_motion import eye_poses, eye_poses_with_jacobians
from vergence.geometry.head import HeadCalibration, MountedCamera
from vergence.geometry.kinematics import EYES
from vergence.geometry.parameters import camera_columns, parameter_names
from vergence.geometry.projection import (
    T_lbase_cam,
    by_parameters,
    project_with_jacobians,
    rows_times,
)
from vergence.geometry.se3 import cross
from vergence.stereo.extrinsics import camera_poses, stereo_cameras

_FARTHEST_M = 50.0
"""Noise makes far points infinitely far, or puts them behind the head; they are taken as here."""
_NEAREST_M = 0.02


@dataclass(frozen=True, eq=False)
class EpipolarResiduals:
    """Residuals of N matches, linearised."""

    residuals: Array
    """(N,) [px], measured minus predicted; NaN where a pixel has no direction."""
    normals: Array
    """(N, 4) unit vectors: residuals change so with left u, v, right u, v."""
    by_parameters: Array
    """(N, P) of the predicted ones by the parameters of the head, as in `parameter_names`."""
    by_readings: Array
    """(N, r) of the predicted ones by the readings."""


@dataclass(frozen=True, eq=False)
class MotionResiduals:
    """Residuals of N points that one camera saw twice, linearised; the earlier pixels are exact."""

    residuals: Array
    """(N, 2) [px], measured minus predicted; NaN where a pixel has no direction."""
    by_parameters: Array
    """(N, 2, P) of the predicted ones by the parameters of the head, as in `parameter_names`."""
    by_before: Array
    """(N, 2, r) of the predicted ones by the earlier readings."""
    by_now: Array
    """(N, 2, r) of the predicted ones by the later readings."""
    by_depth: Array
    """(N, 2) of the predicted ones by the relative change of the depth."""


def epipolar_residuals(
    head: HeadCalibration, joints: Array, left: Array, right: Array, cameras: tuple[str, str]
) -> EpipolarResiduals:
    """Return the residuals of matches: (N, 2) pixels in two cameras, at readings (r,) [rad]."""
    T, by_axes, by_reading = eye_poses_with_jacobians(head, joints, 1)
    points = _points(head, T[0], left, right, cameras)
    parts = []
    for k, (mounted, seen) in enumerate(
        zip(stereo_cameras(head, cameras), (left, right), strict=True)
    ):
        J = project_with_jacobians(mounted, head.T_rbase_lbase, T[:, k], points[None])
        of_head = by_parameters(J, by_axes[k])[0]
        of_readings = rows_times(J.by_T_base_eye, by_reading[:, k])[0]
        parts.append((J.by_point[0], seen - J.pixels[0], of_head, of_readings))
    normals = _normals(parts[0][0], parts[1][0])
    n = len(left)
    residuals, by_readings = np.zeros(n), np.zeros((n, by_reading.shape[-1]))
    by_head = np.zeros((n, len(parameter_names(head))))
    for k, (_, apart, of_head, of_readings) in enumerate(parts):
        row = normals[:, None, 2 * k : 2 * k + 2]
        residuals += (row @ apart[..., None])[:, 0, 0]
        by_head[:, camera_columns(head, cameras[k])] += (row @ of_head)[:, 0]
        by_readings += (row @ of_readings)[:, 0]
    return EpipolarResiduals(residuals, normals, by_head, by_readings)


def motion_residuals(
    head: HeadCalibration,
    camera: str,
    *,
    before: Array,
    now: Array,
    earlier: Array,
    later: Array,
    depths_m: Array,
) -> MotionResiduals:
    """Return the residuals of points that a camera saw before and sees now.

    Args:
        head: with this camera.
        camera: its name.
        before: (r,) readings then [rad].
        now: (r,) readings now [rad].
        earlier: (N, 2) pixels then.
        later: (N, 2) pixels now.
        depths_m: (N,) of the points along the optical axis, then.
    """
    mounted = head.camera(camera)
    eye = EYES.index(mounted.eye)
    moments = [eye_poses_with_jacobians(head, joints, 1) for joints in (before, now)]
    T = T_lbase_cam(mounted, head.T_rbase_lbase, moments[0][0][0, eye])
    rays = _rays(mounted, T, earlier)
    points = T[:3, 3] + rays * depths_m[:, None]
    J = [
        project_with_jacobians(mounted, head.T_rbase_lbase, poses[:, eye], points[None])
        for poses, _, _ in moments
    ]
    # The point follows what the earlier pixel demands, at its depth along the ray.
    held = np.concatenate([J[0].by_point[0], rays[:, None]], axis=1)
    by_earlier = J[1].by_point[0] @ np.linalg.inv(held)[:, :, :2]
    of_head = [
        by_parameters(each, by_axes[eye])[0]
        for each, (_, by_axes, _) in zip(J, moments, strict=True)
    ]
    of_readings = [
        rows_times(each.by_T_base_eye, by_reading[:, eye])[0]
        for each, (_, _, by_reading) in zip(J, moments, strict=True)
    ]
    by_head = np.zeros((len(earlier), 2, len(parameter_names(head))))
    by_head[:, :, camera_columns(head, camera)] = of_head[1] - by_earlier @ of_head[0]
    return MotionResiduals(
        residuals=later - J[1].pixels[0],
        by_parameters=by_head,
        by_before=-by_earlier @ of_readings[0],
        by_now=of_readings[1],
        by_depth=(J[1].by_point[0] @ (rays * depths_m[:, None])[..., None])[..., 0],
    )


def depths_of_matches(
    head: HeadCalibration, joints: Array, left: Array, right: Array, cameras: tuple[str, str]
) -> tuple[Array, Array]:
    """Return how far the points of matches are along the optical axes of both cameras, (N,) [m]."""
    points = _points(head, eye_poses(head, joints), left, right, cameras)
    first, second = (
        np.maximum((points - T[:3, 3]) @ T[:3, 2], _NEAREST_M)
        for T in camera_poses(head, joints, cameras=cameras)
    )
    return first, second


def _rays(mounted: MountedCamera, T_lbase_cam: Array, pixels: Array) -> Array:
    """Return the rays (N, 3) of pixels in the left eye's base, with depth 1 along the axis."""
    xy = normalise(mounted.intrinsics, pixels)
    return np.concatenate([xy, np.ones((len(xy), 1))], axis=1) @ T_lbase_cam[:3, :3].T


def _points(
    head: HeadCalibration, T_base_eye: Array, left: Array, right: Array, cameras: tuple[str, str]
) -> Array:
    """Return (N, 3) midway between the two rays where they are nearest, in the left eye's base."""
    centres, rays = [], []
    for k, (mounted, seen) in enumerate(
        zip(stereo_cameras(head, cameras), (left, right), strict=True)
    ):
        T = T_lbase_cam(mounted, head.T_rbase_lbase, T_base_eye[k])
        rays.append(_rays(mounted, T, seen))
        centres.append(T[:3, 3])
    between = centres[1] - centres[0]
    ll, lr, rr = (np.einsum("ni,ni->n", rays[i], rays[j]) for i, j in ((0, 0), (0, 1), (1, 1)))
    lb, rb = (ray @ between for ray in rays)
    sine2 = np.maximum(ll * rr - lr**2, 1e-12)
    depths = (rr * lb - lr * rb) / sine2, (lr * lb - ll * rb) / sine2
    near = [np.where(z > 0, np.clip(z, _NEAREST_M, _FARTHEST_M), _FARTHEST_M) for z in depths]
    ends = [c + z[:, None] * ray for c, z, ray in zip(centres, near, rays, strict=True)]
    return (ends[0] + ends[1]) / 2


def _normals(left: Array, right: Array) -> Array:
    """Return unit vectors (N, 4) normal to the three columns of (N, 2, 3) over (N, 2, 3).

    The cofactors of the four rows.
    """
    ray_l, ray_r = cross(left[:, 0], left[:, 1]), cross(right[:, 0], right[:, 1])
    of_left = np.einsum("nij,nj->ni", left, ray_r)
    of_right = np.einsum("nij,nj->ni", right, ray_l)
    normals = np.stack([of_left[:, 1], -of_left[:, 0], of_right[:, 1], -of_right[:, 0]], axis=1)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)
