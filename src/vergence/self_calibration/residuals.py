"""Residuals of matched pixels, and their derivatives by lenses and by how two cameras stand.

Between the eyes: a match is four numbers (left u, v, right u, v) that depend on a point (3) and on
the geometry. The one combination of them that no displacement of the point changes is the residual:
to first order the distance in the space of the four pixel coordinates to the nearest match that
fits (Sampson's distance). It is taken at the point that the match shows, not at the pixels as
measured: then its derivatives do not share the noise of the residual, which would pull at the
focal lengths.

Over time, in one eye: a camera that turns with its eye is displaced by millimetres, so that a point
of about known depth tells both coordinates of its later pixel. They show how far the eye has
turned, and with it focal length, mounting and gains, in any motion.

Either depends on the geometry through a few coordinates only, those of one or two lenses and the
increments of one pose; how these change with the head and its joints is the same for all matches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.geometry.camera import Camera, normalised_rows, projection_rows
from vergence.geometry.camera_motion import RelativeMotion, camera_motion, relative_motion
from vergence.geometry.components import (
    Rows,
    Vector,
    components,
    cross,
    dot,
    minus,
    plus,
    pose_components,
    quotient,
    stacked,
    times,
    transposed,
)
from vergence.geometry.head import HeadCalibration
from vergence.geometry.parameter_names import intrinsics_names
from vergence.geometry.parameters import camera_columns, named_columns

_FARTHEST_M = 50.0
"""Noise makes far points infinitely far, or puts them behind the head; they are taken as here."""
_NEAREST_M = 0.02


@dataclass(frozen=True, eq=False)
class Coordinates:
    """What the pixels of a scene depend on at one moment or two: lenses, and one pose."""

    lenses: tuple[Camera, ...]
    """Of the left and the right camera, or of the only one."""
    T_second_first: Array
    """(4, 4) how one camera stands to the other, or now to where it stood."""
    by_unknowns: Array
    """(k, K) of the intrinsics of each lens, and of the six increments of this pose, by the named
    parameters of a head and the readings."""


@dataclass(frozen=True, eq=False)
class EpipolarResiduals:
    """Residuals of N matches, linearised."""

    residuals: Array
    """(N,) [px], measured minus predicted; NaN where a pixel has no direction."""
    normals: Array
    """(N, 4) unit vectors: residuals change so with left u, v, right u, v."""
    by_coordinates: Array
    """(N, k) of the predicted ones, by the `pair_coordinates`."""


@dataclass(frozen=True, eq=False)
class MotionResiduals:
    """Residuals of N points that one camera saw twice, linearised; the earlier pixels are exact."""

    residuals: Array
    """(N, 2) [px], measured minus predicted; NaN where a pixel has no direction."""
    by_coordinates: Array
    """(N, 2, k) of the predicted ones, by the `motion_coordinates`."""
    by_depth: Array
    """(N, 2) of the predicted ones by the relative change of the depth."""


def pair_coordinates(
    head: HeadCalibration, names: tuple[str, ...], joints: Array, cameras: tuple[str, str]
) -> Coordinates:
    """Return what a pair of images depends on: both lenses, and T_rcam_lcam.

    By named parameters (P) of the head and the readings (r,) [rad], which are K = P + r.
    """
    left, right = (camera_motion(head, name, joints) for name in cameras)
    motion = relative_motion(left, right)
    return _coordinates(head, names, cameras, motion, [motion.by_first + motion.by_second])


def motion_coordinates(
    head: HeadCalibration, names: tuple[str, ...], before: Array, now: Array, camera: str
) -> Coordinates:
    """Return what two images of one camera depend on: its lens, and T_now_before.

    By named parameters (P) of the head, the readings (r,) now and those before [rad], which are
    K = P + 2 r.
    """
    motion = relative_motion(*(camera_motion(head, camera, joints) for joints in (before, now)))
    return _coordinates(head, names, (camera,), motion, [motion.by_second, motion.by_first])


def _coordinates(
    head: HeadCalibration,
    names: tuple[str, ...],
    cameras: Sequence[str],
    motion: RelativeMotion,
    by_readings: Sequence[Array],
) -> Coordinates:
    columns = named_columns(head, names)
    of_pose = np.concatenate([motion.by_parameters[:, columns], *by_readings], axis=1)
    rows = [
        camera_columns(head, name)[: len(intrinsics_names(head.camera(name).intrinsics))]
        for name in cameras
    ]
    of_lenses = np.zeros((sum(map(len, rows)), of_pose.shape[1]))
    of_lenses[:, : len(columns)] = np.concatenate(rows)[:, None] == columns
    lenses = tuple(head.camera(name).intrinsics for name in cameras)
    return Coordinates(lenses, motion.T_second_first, np.concatenate([of_lenses, of_pose]))


def epipolar_residuals(
    lenses: Sequence[Camera], T_rcam_lcam: Array, left: Array, right: Array
) -> EpipolarResiduals:
    """Return the residuals of matches: pixels (N, 2) in two cameras at T_rcam_lcam (4, 4)."""
    (R, t), n = pose_components(T_rcam_lcam), len(left)
    seen = components(left.T), components(right.T)
    point = _points(lenses, (R, t), seen)
    turned = times(R, point)
    first, second = (
        projection_rows(lens, each)
        for lens, each in zip(lenses, (point, plus(turned, t)), strict=True)
    )
    back = transposed(R)
    normals = _normals(first[1], [times(back, row) for row in second[1]])
    residuals, columns = np.zeros(n), []
    for k, (pixel, _, by_lens) in enumerate((first, second)):
        a, b = normals[2 * k : 2 * k + 2]
        residuals += a * (seen[k][0] - pixel[0]) + b * (seen[k][1] - pixel[1])
        columns += [a * u + b * v for u, v in zip(*by_lens, strict=True)]
    a, b = normals[2:]
    by_point = [a * u + b * v for u, v in zip(*second[1], strict=True)]
    columns += [*cross(turned, by_point), *by_point]
    return EpipolarResiduals(residuals, stacked(normals, (n,)).T, stacked(columns, (n,)).T)


def motion_residuals(
    lens: Camera, T_now_before: Array, *, earlier: Array, later: Array, depths_m: Array
) -> MotionResiduals:
    """Return the residuals of points that a camera saw before and sees now.

    Args:
        lens: of the camera.
        T_now_before: (4, 4) of it.
        earlier: (N, 2) pixels then.
        later: (N, 2) pixels now.
        depths_m: (N,) of the points along the optical axis, then.
    """
    (R, t), shape = pose_components(T_now_before), (len(earlier),)
    (x, y), ((a, b), (c, d)) = normalised_rows(lens, *components(earlier.T))
    (depth,) = components(depths_m[None])
    point = depth * x, depth * y, depth
    turned = times(R, point)
    _, _, by_lens_then = projection_rows(lens, point)
    pixel, by_point, by_lens = projection_rows(lens, plus(turned, t))
    # The point follows what the earlier pixel demands, at its depth.
    det = a * d - b * c
    along_x, along_y, _ = transposed(R)
    columns = []
    for row, own in zip(by_point, by_lens, strict=True):
        by_x, by_y = (quotient(depth * dot(row, axis), det) for axis in (along_x, along_y))
        by_u, by_v = by_x * d - by_y * c, by_y * a - by_x * b
        of_lens = [now - by_u * u - by_v * v for now, u, v in zip(own, *by_lens_then, strict=True)]
        columns.append([*of_lens, *cross(turned, row), *row])
    return MotionResiduals(
        residuals=later - stacked(pixel, shape).T,
        by_coordinates=stacked(columns, shape, 2).transpose(2, 0, 1),
        by_depth=stacked([dot(row, turned) for row in by_point], shape).T,
    )


def depths_of_matches(
    lenses: Sequence[Camera], T_rcam_lcam: Array, left: Array, right: Array
) -> tuple[Array, Array]:
    """Return how far the points of matches are along the optical axes of both cameras, (N,) [m]."""
    R, t = pose_components(T_rcam_lcam)
    point = _points(lenses, (R, t), (components(left.T), components(right.T)))
    depths = [np.maximum(p[2], _NEAREST_M) for p in (point, plus(times(R, point), t))]
    first, second = stacked(depths, (len(left),))
    return first, second


def _points(
    lenses: Sequence[Camera], T_rcam_lcam: tuple[Rows, Vector], seen: tuple[Vector, Vector]
) -> Vector:
    """Return the point midway between the rays of both pixels where they are nearest.

    In the left camera, by components.
    """
    back = transposed(T_rcam_lcam[0])
    (x, y), (x_right, y_right) = (
        normalised_rows(lens, *pixel)[0] for lens, pixel in zip(lenses, seen, strict=True)
    )
    left, right = (x, y, 1.0), times(back, (x_right, y_right, 1.0))
    other = minus((0.0, 0.0, 0.0), times(back, T_rcam_lcam[1]))
    ll, lr, rr = dot(left, left), dot(left, right), dot(right, right)
    lb, rb = dot(left, other), dot(right, other)
    sine2 = np.maximum(ll * rr - lr * lr, 1e-12)
    depths = (rr * lb - lr * rb) / sine2, (lr * lb - ll * rb) / sine2
    near, far = (np.where(z > 0, np.clip(z, _NEAREST_M, _FARTHEST_M), _FARTHEST_M) for z in depths)
    return [(near * a + d + far * b) / 2 for d, a, b in zip(other, left, right, strict=True)]


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
