"""Residuals of matched and of tracked pixels, with their derivatives.

The residual of a match between the eyes is its Sampson distance in the space of its four pixel
coordinates. Derivatives are taken at the matched point: at the measured pixels they would share the
noise of the residual and bias the focal lengths. A tracked point of roughly known depth predicts
both coordinates of its later pixel.

Either depends on the geometry through k coordinates: the intrinsics of one or two lenses, and the
increments of one pose. Their derivatives by the K unknowns are the same for all matches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.geometry.batches import (
    batch_last,
    dot,
    ignoring_invalid,
    joined,
    product,
    times,
    times_transposed,
    vector,
)
from vergence.geometry.camera import Camera, intrinsics_names, normalise_jacobian, project_jacobians
from vergence.geometry.eye_motion import RelativeMotion, camera_motion, relative_motion
from vergence.geometry.head import HeadCalibration
from vergence.geometry.parameters import camera_columns, named_columns
from vergence.geometry.projection import by_pose_of_points
from vergence.geometry.se3 import cross

_FARTHEST_M = 50.0
"""Noise makes far points infinitely far, or puts them behind the head; they are taken as here."""
_NEAREST_M = 0.02  # closer than any object that both eyes see


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Lenses and one relative pose, on which the pixels of a pair of images depend."""

    lenses: tuple[Camera, ...]
    T_second_first: Array
    """(4, 4) left camera in the right one, or earlier camera in the later one."""
    by_unknowns: Array
    """(k, K) derivatives of intrinsics and pose increments by head parameters and readings."""


@dataclass(frozen=True, eq=False)
class EpipolarResiduals:
    """Linearised residuals of N matches."""

    residuals: Array
    """(N,) [px], measured minus predicted; NaN where a pixel has no direction."""
    normals: Array
    """(N, 4) unit derivatives by left u, v, right u, v."""
    by_coordinates: Array
    """(N, k) derivatives of the predictions."""


def pair_coordinates(
    head: HeadCalibration, names: tuple[str, ...], joints: Array, cameras: tuple[str, str]
) -> Coordinates:
    """Linearise lenses and T_rcam_lcam by named parameters and readings: K = P + r unknowns."""
    left, right = (camera_motion(head, name, joints) for name in cameras)
    motion = relative_motion(left, right)
    return _coordinates(head, names, cameras, motion, [motion.by_first + motion.by_second])


def motion_coordinates(
    head: HeadCalibration, names: tuple[str, ...], before: Array, now: Array, camera: str
) -> Coordinates:
    """Linearise the lens and T_now_before of one camera: K = P + 2 r unknowns.

    They are named parameters, the readings now, and the readings before.
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
    """Compute the residuals of matches: pixels (N, 2) in two cameras at T_rcam_lcam (4, 4)."""
    R, t = T_rcam_lcam[:3, :3], T_rcam_lcam[:3, 3]
    point = _points(lenses, T_rcam_lcam, left, right)
    turned = times(R, point)
    first, second = (
        project_jacobians(lens, each)
        for lens, each in zip(lenses, (point, turned + t), strict=True)
    )
    normals = _normals(first[1], product(second[1], R))
    residuals, columns = np.zeros(len(left)), []
    for k, (seen, (pixels, _, by_lens)) in enumerate(
        zip((left, right), (first, second), strict=True)
    ):
        normal = normals[:, 2 * k : 2 * k + 2]
        residuals += dot(normal, seen - pixels)
        columns.append(times_transposed(by_lens, normal))
    by_point = times_transposed(second[1], normals[:, 2:])
    columns += [cross(turned, by_point), by_point]
    return EpipolarResiduals(residuals, normals, np.concatenate(columns, axis=1))


@ignoring_invalid
def motion_residuals(
    lens: Camera, T_now_before: Array, *, earlier: Array, later: Array, depths_m: Array
) -> tuple[Array, Array]:
    """Compute residuals (N, 2) [px] of points that a camera saw earlier and now, at pixels (N, 2).

    Their depths (N,) were along its optical axis at the earlier moment; the earlier pixels are
    taken as exact. Returns also derivatives (N, 2, k + 1) of the predictions by the coordinates and
    by the relative change of the depth. NaN where a pixel has no direction.
    """
    R, t = T_now_before[:3, :3], T_now_before[:3, 3]
    xy, by_earlier = normalise_jacobian(lens, earlier)
    point = vector(*batch_last(depths_m[:, None] * xy), depths_m)
    turned = times(R, point)
    _, _, by_lens_then = project_jacobians(lens, point)
    pixels, by_point, by_lens = project_jacobians(lens, turned + t)
    # The point follows what the earlier pixel demands, at its depth.
    by_pixels = product(product(by_point, R[:, :2]), by_earlier) * depths_m[:, None, None]
    return later - pixels, joined(
        by_lens - product(by_pixels, by_lens_then),
        by_pose_of_points(by_point, turned),
        times(by_point, turned)[..., None],
    )


def depths_of_matches(
    lenses: Sequence[Camera], T_rcam_lcam: Array, left: Array, right: Array
) -> tuple[Array, Array]:
    """Compute the depths (N,) [m] of matches along the optical axes of both cameras."""
    point = _points(lenses, T_rcam_lcam, left, right)
    depth_right = times(T_rcam_lcam[:3, :3], point)[:, 2] + T_rcam_lcam[2, 3]
    return np.maximum(point[:, 2], _NEAREST_M), np.maximum(depth_right, _NEAREST_M)


def _points(lenses: Sequence[Camera], T_rcam_lcam: Array, left: Array, right: Array) -> Array:
    """Compute the points (N, 3) midway between the rays of both pixels where they are nearest.

    In the left camera.
    """
    back = T_rcam_lcam[:3, :3].T
    xy, xy_right = (
        normalise_jacobian(lens, pixels)[0]
        for lens, pixels in zip(lenses, (left, right), strict=True)
    )
    ray = vector(xy[:, 0], xy[:, 1], 1.0)
    ray_right = times(back[:, :2], xy_right) + back[:, 2]
    other = -back @ T_rcam_lcam[:3, 3]
    ll, lr, rr = dot(ray, ray), dot(ray, ray_right), dot(ray_right, ray_right)
    lb, rb = dot(ray, other), dot(ray_right, other)
    sine2 = np.maximum(ll * rr - lr * lr, 1e-12)
    depths = (rr * lb - lr * rb) / sine2, (lr * lb - ll * rb) / sine2
    near, far = (
        np.where(z > 0, np.clip(z, _NEAREST_M, _FARTHEST_M), _FARTHEST_M)[:, None] for z in depths
    )
    return (near * ray + other + far * ray_right) / 2


def _normals(left: Array, right: Array) -> Array:
    """Compute the unit vectors (N, 4) normal to the three columns of (2, 3) over (2, 3).

    They are the cofactors.
    """
    ray_l, ray_r = (cross(rows[:, 0], rows[:, 1]) for rows in (left, right))
    (lu, lv), (ru, rv) = (
        batch_last(times(rows, ray)) for rows, ray in ((left, ray_r), (right, ray_l))
    )
    length = np.sqrt(lu * lu + lv * lv + ru * ru + rv * rv)
    return vector(lv, -lu, rv, -ru) / length[:, None]
