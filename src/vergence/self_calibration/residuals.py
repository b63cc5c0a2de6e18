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
from vergence.geometry.camera import normalised_rows
from vergence.geometry.components import (
    Component,
    Rows,
    Vector,
    components,
    cross,
    dot,
    minus,
    quotient,
    stacked,
    times,
    transposed,
)
from vergence.geometry.eye_motion import EyeMotion, eye_motion, eye_motions
from vergence.geometry.head import HeadCalibration, MountedCamera
from vergence.geometry.parameters import camera_columns, parameter_names
from vergence.geometry.projection import (
    by_camera_columns,
    by_increments,
    camera_pose,
    projected,
)
from vergence.stereo.extrinsics import stereo_cameras

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
    pair, eyes = stereo_cameras(head, cameras), eye_motions(head, joints[None])
    seen = components(left.T), components(right.T)
    point = _points(pair, head.T_rbase_lbase, eyes, seen)
    both = [
        projected(mounted, head.T_rbase_lbase, eye.R, eye.t, point)
        for mounted, eye in zip(pair, eyes, strict=True)
    ]
    normals, n = _normals(both[0].by_point, both[1].by_point), len(left)
    residuals, by_readings = np.zeros(n), np.zeros((len(joints), n))
    by_parameters = np.zeros((len(parameter_names(head)), n))
    for k, (own, eye) in enumerate(zip(both, eyes, strict=True)):
        a, b = normals[2 * k : 2 * k + 2]
        (u, v), (own_u, own_v) = seen[k], own.pixel
        residuals += a * (u - own_u) + b * (v - own_v)
        by_angles = by_increments(own.by_T_base_eye, eye.by_angles)
        pairs = by_camera_columns(own, eye, by_angles)
        for column, (u, v) in zip(camera_columns(head, cameras[k]), pairs, strict=True):
            by_parameters[column] += a * u + b * v
        for joint, reading, factor in eye.angle_by_readings:
            u, v = by_angles[joint]
            by_readings[reading] += factor * (a * u + b * v)
    return EpipolarResiduals(residuals, stacked(normals, (n,)).T, by_parameters.T, by_readings.T)


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
    mounted, T_rbase_lbase, n = head.camera(camera), head.T_rbase_lbase, len(earlier)
    moments = [
        eye_motion(head.kinematics, mounted.eye, joints.tolist()) for joints in (before, now)
    ]
    centre, ray = _ray(mounted, T_rbase_lbase, moments[0], components(earlier.T))
    (depth,) = components(depths_m[None])
    point = [c + depth * each for c, each in zip(centre, ray, strict=True)]
    both = [projected(mounted, T_rbase_lbase, eye.R, eye.t, point) for eye in moments]
    by_angles = [
        by_increments(own.by_T_base_eye, eye.by_angles)
        for own, eye in zip(both, moments, strict=True)
    ]
    # The point follows what the earlier pixel demands, at its depth along the ray.
    a, b = both[0].by_point
    by_u, by_v = cross(b, ray), cross(ray, a)
    det = dot(a, by_u)
    (uu, uv), (vu, vv) = (
        (quotient(dot(row, by_u), det), quotient(dot(row, by_v), det)) for row in both[1].by_point
    )

    def by_earlier(u: Component, v: Component) -> tuple[Component, Component]:
        return uu * u + uv * v, vu * u + vv * v

    by_parameters = np.zeros((len(parameter_names(head)), 2, n))
    then, later_on = (
        by_camera_columns(own, eye, each)
        for own, eye, each in zip(both, moments, by_angles, strict=True)
    )
    for column, of_then, (u, v) in zip(camera_columns(head, camera), then, later_on, strict=True):
        lost_u, lost_v = by_earlier(*of_then)
        by_parameters[column, 0], by_parameters[column, 1] = u - lost_u, v - lost_v
    by_before, by_now = np.zeros((2, len(now), 2, n))
    for joint, reading, factor in moments[0].angle_by_readings:
        for k in (0, 1):
            by_before[reading, k] -= factor * by_earlier(*by_angles[0][joint])[k]
            by_now[reading, k] += factor * by_angles[1][joint][k]
    by_depth = [depth * dot(row, ray) for row in both[1].by_point]
    return MotionResiduals(
        residuals=later - stacked(both[1].pixel, (n,)).T,
        by_parameters=by_parameters.transpose(2, 1, 0),
        by_before=by_before.transpose(2, 1, 0),
        by_now=by_now.transpose(2, 1, 0),
        by_depth=stacked(by_depth, (n,)).T,
    )


def depths_of_matches(
    head: HeadCalibration, joints: Array, left: Array, right: Array, cameras: tuple[str, str]
) -> tuple[Array, Array]:
    """Return how far the points of matches are along the optical axes of both cameras, (N,) [m]."""
    pair, eyes = stereo_cameras(head, cameras), eye_motions(head, joints[None])
    seen = components(left.T), components(right.T)
    point = _points(pair, head.T_rbase_lbase, eyes, seen)
    depths = []
    for mounted, eye in zip(pair, eyes, strict=True):
        R, centre = camera_pose(mounted, head.T_rbase_lbase, eye.R, eye.t)
        depths.append(np.maximum(dot(minus(point, centre), transposed(R)[2]), _NEAREST_M))
    first, second = stacked(depths, (len(left),))
    return first, second


def _ray(
    mounted: MountedCamera, T_rbase_lbase: Array, eye: EyeMotion, pixel: Vector
) -> tuple[Vector, Vector]:
    """Return the centre of a camera, and the ray of a pixel with depth 1 along the optical axis.

    In the left eye's base, by components.
    """
    R, centre = camera_pose(mounted, T_rbase_lbase, eye.R, eye.t)
    (x, y), _ = normalised_rows(mounted.intrinsics, *pixel)
    return centre, times(R, (x, y, 1.0))


def _points(
    pair: tuple[MountedCamera, MountedCamera],
    T_rbase_lbase: Array,
    eyes: tuple[EyeMotion, EyeMotion],
    seen: tuple[Vector, Vector],
) -> Vector:
    """Return the point midway between the rays of both pixels where they are nearest.

    In the left eye's base, by components.
    """
    (centre, left), (other, right) = (
        _ray(mounted, T_rbase_lbase, eye, pixel)
        for mounted, eye, pixel in zip(pair, eyes, seen, strict=True)
    )
    between = minus(other, centre)
    ll, lr, rr = dot(left, left), dot(left, right), dot(right, right)
    lb, rb = dot(left, between), dot(right, between)
    sine2 = np.maximum(ll * rr - lr * lr, 1e-12)
    depths = (rr * lb - lr * rb) / sine2, (lr * lb - ll * rb) / sine2
    near, far = (np.where(z > 0, np.clip(z, _NEAREST_M, _FARTHEST_M), _FARTHEST_M) for z in depths)
    return [
        (c + near * a + d + far * b) / 2
        for c, d, a, b in zip(centre, other, left, right, strict=True)
    ]


def _normals(left: Rows, right: Rows) -> Vector:
    """Return the unit vector (4) normal to the three columns of (2, 3) over (2, 3): the cofactors.

    By components.
    """
    ray_l, ray_r = cross(*left), cross(*right)
    normal = (
        dot(left[1], ray_r),
        -dot(left[0], ray_r),
        dot(right[1], ray_l),
        -dot(right[0], ray_l),
    )
    length = np.sqrt(sum(each * each for each in normal))
    return [each / length for each in normal]
