"""Stereo that follows moving eyes (Sec. II-C): pixels and joint readings in, points out.

Equation numbers are the paper's; docs/equations.md says where its printed forms were mended.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Required, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array, floats
from vergence.errors import VergenceError, counted
from vergence.geometry.batches import dot, ignoring_invalid, times, times_transposed
from vergence.geometry.camera import Camera, normalise_jacobian
from vergence.geometry.eye_motion import check_joints, eye_poses, measured
from vergence.geometry.head import HeadCalibration, base_pose, pair_names, pixel_stds, reading_stds
from vergence.geometry.kinematics import check_radians
from vergence.geometry.neck import head_pose
from vergence.geometry.projection import camera_pose
from vergence.geometry.se3 import checked_points, cross, transform

CHUNK = 4096
"""Points at a time, so that memory does not grow; chosen with benchmarks/located_points.py."""
PARALLEL_RAD = 1e-12
"""Angle between two rays up to which they count as parallel: what rounding errors make."""


@dataclass(frozen=True, eq=False)
class Sightings:
    """N points that both eyes see, or one of them without a batch."""

    head: HeadCalibration
    cameras: tuple[str, str]
    left: Array
    """(..., 2) pixels in the left camera, distortion included."""
    right: Array
    """(..., 2) in the right camera."""
    joints: Array
    """(r,) readings [rad] of one posture, or (..., r); or poses (2, 4, 4) or (..., 2, 4, 4)."""
    pixel_std_px: Array
    """(4,) or (..., 4) of left u, left v, right u, right v."""
    reading_std: Array
    """(r,) or (..., r) of readings [rad], or the increments of poses."""

    @property
    def variances(self) -> Array:
        """(4,) or (..., 4) by which pixels are weighted; ones where one is exact or unknown."""
        std = self.pixel_std_px
        return np.where((std > 0).all(axis=-1, keepdims=True), std * std, 1.0)

    @property
    def one_posture(self) -> bool:
        """Whether one posture serves all points."""
        return self.joints.ndim in (1, 3)

    def take(self, part: slice | int | np.ndarray) -> Sightings:
        """Select some of the points, or one of them without a batch."""
        pixels, readings = self.pixel_std_px, self.reading_std
        return replace(
            self,
            left=self.left[part],
            right=self.right[part],
            joints=self.joints if self.one_posture else self.joints[part],
            pixel_std_px=pixels if pixels.ndim == 1 else pixels[part],
            reading_std=readings if readings.ndim == 1 else readings[part],
        )


class SightingArguments(TypedDict, total=False):
    """Arguments of `locate` that other functions share."""

    left: Required[ArrayLike]
    right: Required[ArrayLike]
    joints: Required[ArrayLike]
    cameras: tuple[str, str] | None
    pixel_std_px: ArrayLike | None
    reading_std: ArrayLike | None


def sightings(
    head: HeadCalibration,
    *,
    left: ArrayLike,
    right: ArrayLike,
    joints: ArrayLike,
    cameras: tuple[str, str] | None = None,
    pixel_std_px: ArrayLike | None = None,
    reading_std: ArrayLike | None = None,
) -> Sightings:
    """Check what points are located from; arguments and errors are those of `locate`.

    Noise that neither the caller nor the calibration states is zero.
    """
    names = pair_names(head, cameras)
    left, right = np.atleast_2d(floats("left", left)), np.atleast_2d(floats("right", right))
    joints = floats("joints", joints)
    if left.ndim != 2:
        raise VergenceError(f"Locating points needs left of shape (N, 2), found {left.shape}.")
    n, r = len(left), len(head.kinematics.readings)
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
    check_joints(head.kinematics, joints)
    if pixel_std_px is None:
        pixel_std_px = pixel_stds(head, names)
    pixels = _deviations("pixel_std_px", pixel_std_px, n, 4)
    readings = reading_deviations(head, joints, reading_std, n)
    return Sightings(head, names, left, right, joints, pixels, readings)


def reading_deviations(
    head: HeadCalibration, joints: Array, reading_std: ArrayLike | None, n: int
) -> Array:
    """Check the noise (r,) or (n, r) of readings, or (12,) of two measured poses.

    Of poses it may be two numbers, of rotation [rad] and translation [m]; None: as stated.
    """
    count = 12 if measured(joints) else len(head.kinematics.readings)
    if reading_std is None:
        levels = head.accuracy.joint_std if head.accuracy else ()
        poses = np.resize(levels or (0.0,), 2)
        reading_std = poses if measured(joints) else reading_stds(head)
    if count == 12 and np.shape(reading_std) == (2,):
        reading_std = np.tile(np.repeat(reading_std, 3), 2)
    return _deviations("reading_std", reading_std, n, count)


def _deviations(name: str, std: ArrayLike, n: int, count: int) -> Array:
    """Check standard deviations (count,) or (n, count), from these or a number for all."""
    stds = floats(name, std)
    if stds.shape not in ((), (count,), (n, count)):
        raise VergenceError(
            f"{name} is a number or an array of shape ({count},) or ({n}, {count}); found one of "
            f"shape {stds.shape}."
        )
    # Of many points some may have NaN, if they are not seen.
    wrong = (stds < 0) | (~np.isfinite(stds) & (stds.ndim < 2))
    if wrong.any():
        raise VergenceError(
            f"{name} is a standard deviation, 0 or more; found {stds[wrong].flat[0]:g}."
        )
    return stds if stds.ndim else stds.repeat(count)


def in_chunks(seen: Sightings, find: Callable[[Sightings], tuple[Array, ...]]) -> tuple[Array, ...]:
    """Compute something of points, a chunk at a time: arrays whose rows are points.

    A single point is computed without a batch, by numpy's scalars: in a control step this takes
    0.3 ms, and 0.5 ms with arrays of one element.
    """
    n = len(seen.left)
    if n == 1:
        return tuple(each[None] for each in find(seen.take(0)))
    found = None
    for start in range(0, max(n, 1), CHUNK):
        part = slice(start, start + CHUNK)
        some = find(seen.take(part))
        found = found or tuple(np.empty((n, *each.shape[1:]), each.dtype) for each in some)
        for into, each in zip(found, some, strict=True):
            into[part] = each
    assert found
    return found


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
