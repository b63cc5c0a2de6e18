"""Stereo that follows moving eyes (Sec. II-C): pixels and joint readings in, points out.

Equation numbers are the paper's; docs/equations.md says where its printed forms were mended.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Unpack

import numpy as np

from vergence.arrays import Array, floats
from vergence.errors import VergenceError, counted
from vergence.geometry.batches import dot, ignoring_invalid, times, times_transposed
from vergence.geometry.camera import Camera, normalise_jacobian
from vergence.geometry.eye_motion import eye_poses
from vergence.geometry.head import HeadCalibration, base_pose
from vergence.geometry.kinematics import check_radians
from vergence.geometry.neck import head_pose
from vergence.geometry.projection import camera_pose
from vergence.geometry.se3 import checked_points, cross, transform
from vergence.stereo.sightings import SightingArguments, Sightings, in_chunks, sightings

PARALLEL_RAD = 1e-12
"""Angle between two rays up to which they count as parallel: what rounding errors make."""


class Status(IntEnum):
    """What became of one point."""

    OK = 0
    NOT_SEEN = 1
    """A pixel or a joint reading is NaN, or a pixel lies beyond the lens model's reach."""
    PARALLEL = 2
    """The two rays are parallel to within rounding errors."""
    BEHIND = 3
    """The rays meet behind a camera."""


def triangulate_at(
    head: HeadCalibration, **arguments: Unpack[SightingArguments]
) -> tuple[Array, np.ndarray]:
    """Triangulate points (N, 3) [m] in the left eye's base frame, with status (N,) (Eqs. 3, 4, 11).

    NaN where the status is not OK. Of the noise of pixels only the ratios count; left out: equal.
    Arguments and errors are those of `uncertainty.locate`.
    """
    arguments.setdefault("pixel_std_px", 1.0)
    seen = sightings(head, **arguments)
    points, status = in_chunks(seen, triangulated)
    return points, status


def triangulated(seen: Sightings) -> tuple[Array, np.ndarray]:
    """Compute points (..., 3) [m], NaN where the status (...) is not OK."""
    eyes = eye_poses(seen.head, seen.joints)
    return intersect_rays(seen, (eyes[..., 0, :, :], eyes[..., 1, :, :]))


@ignoring_invalid
def intersect_rays(seen: Sightings, eyes: Sequence[Array]) -> tuple[Array, np.ndarray]:
    """Compute points (..., 3) in the left eye's base frame, where rays of pixels meet, and status.

    Rays of noisy pixels pass each other; they are first corrected so that they meet. The eyes are
    poses T_base_eye (..., 4, 4) of the left and the right one.
    """
    pair = [seen.head.camera(name) for name in seen.cameras]
    poses = [
        camera_pose(mounted, seen.head.T_rbase_lbase, T)
        for mounted, T in zip(pair, eyes, strict=True)
    ]
    (R_left, centre), (R_right, other) = ((T[..., :3, :3], T[..., :3, 3]) for T in poses)
    lenses, base = (pair[0].intrinsics, pair[1].intrinsics), other - centre
    left, right = _coplanar_rays(seen, lenses, (R_left, R_right), base)
    normal = cross(left, right)
    size = dot(normal, normal)
    # base = s left - r right: the cross product with one ray leaves the depth along the other.
    depth, depth_right = (dot(cross(base, ray), normal) / size for ray in (right, left))
    parallel = size <= PARALLEL_RAD**2 * (dot(left, left) * dot(right, right))
    unseen = ~np.isfinite((left + right + base).sum(axis=-1))
    status = np.where((depth <= 0) | (depth_right <= 0), int(Status.BEHIND), int(Status.OK))
    status = np.where(parallel, int(Status.PARALLEL), status)
    status = np.where(unseen, int(Status.NOT_SEEN), status)
    points = centre + depth[..., None] * left
    return np.where((status == Status.OK)[..., None], points, np.nan), status


def _coplanar_rays(
    seen: Sightings, lenses: tuple[Camera, Camera], rotations: tuple[Array, Array], base: Array
) -> tuple[Array, Array]:
    """Compute the rays (..., 3) of pixels, corrected so that each pair lies in one plane.

    The pixels are moved onto each other's epipolar lines by the least sum of squares relative to
    their variances: Sampson's correction, to first order the maximum of the likelihood. The base
    (..., 3) from the left to the right camera, and their rotations, are in the frame of the rays.
    """
    pixels, variances = (seen.left, seen.right), seen.variances
    found = [normalise_jacobian(lens, uv) for lens, uv in zip(lenses, pixels, strict=True)]
    across = [R[..., :2] for R in rotations]
    left, right = (times(across[k], found[k][0]) + R[..., 2] for k, R in enumerate(rotations))
    # gap = left ray . (right ray x base), and its derivatives by the pixels.
    normals = cross(right, base), cross(base, left)
    gap, power, steps = dot(left, normals[0]), 0.0, []
    for k, (_, by_pixels) in enumerate(found):
        slope = times_transposed(by_pixels, times_transposed(across[k], normals[k]))
        step = slope * variances[..., 2 * k : 2 * k + 2]
        power = power + dot(step, slope)
        steps.append(times(across[k], times(by_pixels, step)))
    factor = (gap / power)[..., None]
    return left - factor * steps[0], right - factor * steps[1]


def in_head(head: HeadCalibration, points_lbase: Array) -> Array:
    """Map points (..., 3) [m] from the left eye's base frame into frame head."""
    return transform(base_pose(head, "left"), checked_points(points_lbase))


def in_body(head: HeadCalibration, points_lbase: Array, neck_angles: Array) -> Array:
    """Eq. 12: map points (..., 3) [m] from the left eye's base frame into frame body.

    The neck's angles (..., n) [rad] are in the order of its chain; leading dimensions broadcast.

    Raises:
        VergenceError: the angles are not as many as the neck has joints, or not in radians, or the
            shapes do not fit; a neck without joints takes `np.empty(0)`.
    """
    angles = floats("neck_angles", neck_angles)
    joints = len(head.neck.axes)
    if angles.shape[-1:] != (joints,):
        raise VergenceError(
            f"The neck of this head has {counted(joints, 'joint')}; found an array of angles "
            f"of shape {angles.shape}."
        )
    check_radians(angles, "Angles of the neck")
    points = checked_points(points_lbase, angles.shape[:-1])
    return transform(head_pose(head.neck, angles), transform(base_pose(head, "left"), points))
