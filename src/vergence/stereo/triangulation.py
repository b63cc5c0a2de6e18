"""Stereo that follows moving eyes (Sec. II-C): pixels and joint readings in, points out.

Equation numbers are the paper's; docs/equations.md says where its printed forms were mended.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array, floats
from vergence.errors import VergenceError, counted
from vergence.geometry.batches import (
    dot,
    ignoring_invalid,
    times,
    times_transposed,
)
from vergence.geometry.camera import Camera, normalise_jacobian
from vergence.geometry.eye_motion import check_joints, eye_poses
from vergence.geometry.head import HeadCalibration, MountedCamera, T_head_base
from vergence.geometry.kinematics import Kinematics, check_radians
from vergence.geometry.neck import T_body_head
from vergence.geometry.projection import camera_pose
from vergence.geometry.se3 import checked_points, cross, transform
from vergence.stereo.extrinsics import stereo_cameras
from vergence.stereo.measurement_noise import noise_of_part, pixel_variances

CHUNK = 4096
"""Points at a time: their arrays stay in the processor's cache, and memory does not grow."""
PARALLEL_RAD = 1e-12
"""Angle between two rays up to which they count as parallel: what rounding errors make."""


Part = slice | int
"""Some of many points, or one of them without a batch."""


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
    head: HeadCalibration,
    *,
    left: Array,
    right: Array,
    joints: Array,
    cameras: tuple[str, str] | None = None,
    pixel_std_px: ArrayLike = 1.0,
) -> tuple[Array, np.ndarray]:
    """Return points in the left eye's base frame, and their status (Eqs. 3, 4 and 11).

    Args:
        head: a calibration with a camera in each eye.
        left: (N, 2) pixels in the left camera, distortion included; NaN: not seen.
        right: (N, 2) pixels in the right camera.
        joints: readings [rad], (r,) for all points or (N, r), or eye poses (2, 4, 4) or (N, 2, 4,
            4).
        cameras: names of the left and the right camera; None: the main ones.
        pixel_std_px: noise of (left u, left v, right u, right v), of which only the ratios count: a
            number, (4,) or (N, 4).

    Returns:
        Points (N, 3) [m], NaN where the status is not OK, and the status (N,).

    Raises:
        VergenceError: shapes do not fit, readings are not in radians, poses are not rigid, the
            noise is negative, or the head has no such pair of cameras.
    """
    left, right, joints = checked_arguments(left, right, joints, head.kinematics)
    pair, n = stereo_cameras(head, cameras), len(left)
    variances = pixel_variances(pixel_std_px, n)

    def find(part: Part) -> tuple[Array, np.ndarray]:
        eyes = np.moveaxis(eye_poses(head, joints_of_part(joints, part)), -3, 0)
        pixels = left[part], right[part]
        return intersect_rays(
            pair, head.T_rbase_lbase, eyes, pixels, noise_of_part(variances, part)
        )

    points, status = in_chunks(n, find)
    return points, status


@ignoring_invalid
def intersect_rays(
    pair: tuple[MountedCamera, MountedCamera],
    T_rbase_lbase: Array,
    eyes: Sequence[Array],
    pixels: tuple[Array, Array],
    variances: Array,
) -> tuple[Array, np.ndarray]:
    """Compute points (..., 3) in the left eye's base frame, where rays of pixels meet, and status.

    Rays of noisy pixels pass each other; they are first corrected so that they meet.

    Args:
        pair: a left and a right camera.
        T_rbase_lbase: (4, 4) of the head.
        eyes: poses T_base_eye (..., 4, 4) of the left and the right eye.
        pixels: (..., 2) left and right, distortion included.
        variances: (..., 4) of the pixels: left u, left v, right u, right v.
    """
    (R_left, centre), (R_right, other) = (
        camera_pose(mounted, T_rbase_lbase, T) for mounted, T in zip(pair, eyes, strict=True)
    )
    lenses, base = (pair[0].intrinsics, pair[1].intrinsics), other - centre
    left, right = _coplanar_rays(lenses, pixels, (R_left, R_right), base, variances)
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
    lenses: tuple[Camera, Camera],
    pixels: tuple[Array, Array],
    rotations: tuple[Array, Array],
    base: Array,
    variances: Array,
) -> tuple[Array, Array]:
    """Compute the rays (..., 3) of pixels, corrected so that each pair lies in one plane.

    The pixels are moved onto each other's epipolar lines by the least sum of squares relative to
    their variances: Sampson's correction, to first order the maximum of the likelihood.

    Args:
        lenses: of the left and the right camera.
        pixels: (..., 2) left and right, distortion included.
        rotations: (..., 3, 3) of the cameras, in the frame in which the rays are returned.
        base: (..., 3) from the left to the right camera, in this frame.
        variances: (..., 4) of the pixels: left u, left v, right u, right v.
    """
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


def chunks(n: int) -> Iterator[slice]:
    """Yield slices of at most CHUNK that together are range(n)."""
    for start in range(0, n, CHUNK):
        yield slice(start, min(start + CHUNK, n))


def in_chunks(n: int, find: Callable[[Part], tuple[Array, ...]]) -> tuple[Array, ...]:
    """Compute something of n points, a chunk at a time: arrays whose rows are points.

    A single point is computed without a batch, by numpy's scalars, in a third of the time.
    """
    if n == 1:
        return tuple(each[None] for each in find(0))
    found = None
    for part in chunks(n):
        own = find(part)
        found = found or tuple(np.empty((n, *each.shape[1:]), each.dtype) for each in own)
        for into, each in zip(found, own, strict=True):
            into[part] = each
    return found or find(slice(0))


def joints_of_part(joints: Array, part: Part) -> Array:
    """Return the readings, or measured poses, of a chunk; those of one posture serve all."""
    return joints if joints.ndim in (1, 3) else joints[part]


def checked_arguments(
    left: Array, right: Array, joints: Array, kinematics: Kinematics
) -> tuple[Array, Array, Array]:
    """Return float arrays; VergenceError if they are not (N, 2), (N, 2) and readings.

    These are angles (r,) or (N, r) in radians, or measured eye poses (2, 4, 4) or (N, 2, 4, 4),
    which are rigid.
    """
    left, right, joints = floats("left", left), floats("right", right), floats("joints", joints)
    if left.ndim != 2:
        raise VergenceError(f"Locating points needs left of shape (N, 2), found {left.shape}.")
    n, r = len(left), len(kinematics.readings)
    for name, array, shapes in (
        ("left", left, [(n, 2)]),
        ("right", right, [(n, 2)]),
        ("joints", joints, [(n, r), (r,), (n, 2, 4, 4), (2, 4, 4)]),
    ):
        if array.shape not in shapes:
            raise VergenceError(
                f"Locating {counted(n, 'point')} needs {name} of shape "
                f"{' or '.join(map(str, shapes))}, found {array.shape}."
            )
    check_joints(kinematics, joints)
    return left, right, joints


def in_head(head: HeadCalibration, points_lbase: Array) -> Array:
    """Map points (..., 3) [m] from the left eye's base frame into frame head.

    VergenceError if they are not (..., 3).
    """
    return transform(T_head_base(head, "left"), checked_points(points_lbase))


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
    return transform(T_body_head(head.neck, angles), transform(T_head_base(head, "left"), points))
