"""Located points with their derivatives by all that they depend on.

`uncertainty` makes covariances of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from vergence.arrays import Array
from vergence.geometry.batches import (
    batch_first,
    batch_last,
    dot,
    ignoring_invalid,
    joined,
    product,
    times,
    times_transposed,
    vector,
)
from vergence.geometry.eye_motion import eye_motions
from vergence.geometry.head import HeadCalibration, pair_names
from vergence.geometry.parameters import camera_columns, parameter_names
from vergence.geometry.projection import projected
from vergence.geometry.se3 import cross
from vergence.stereo.extrinsics import per_pair, stereo_cameras
from vergence.stereo.measurement_noise import noise_of_part, pixel_variances
from vergence.stereo.triangulation import Part, checked_arguments, intersect_rays, joints_of_part


@per_pair
def pair_parameters(head: HeadCalibration, cameras: tuple[str, str] | None) -> tuple[str, ...]:
    """Return the names of the P parameters that the points of a pair of cameras depend on."""
    return _of_pair(head, cameras)[0]


@per_pair
def pair_columns(
    head: HeadCalibration, cameras: tuple[str, str] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return where the columns of each camera are among the `pair_parameters`."""
    return _of_pair(head, cameras)[1]


def _of_pair(
    head: HeadCalibration, cameras: tuple[str, str] | None
) -> tuple[tuple[str, ...], tuple[np.ndarray, np.ndarray]]:
    left, right = (tuple(camera_columns(head, name).tolist()) for name in pair_names(head, cameras))
    return _of_columns(parameter_names(head), left, right)


@lru_cache(maxsize=64)
def _of_columns(
    everything: tuple[str, ...], left: tuple[int, ...], right: tuple[int, ...]
) -> tuple[tuple[str, ...], tuple[np.ndarray, np.ndarray]]:
    """Return the names of the parameters that either depends on, and where those of each are."""
    both = sorted({*left, *right})
    first, second = (np.array([both.index(k) for k in own]) for own in (left, right))
    return tuple(everything[k] for k in both), (first, second)


@dataclass(frozen=True, eq=False)
class Linearised:
    """Located points, and how they change with all that they depend on.

    To first order: of rays that pass each other far off, derivatives are those of rays that meet.
    NaN: not located.
    """

    points: Array
    """(..., 3)."""
    status: np.ndarray
    """(...)."""
    by_pixels: Array
    """(..., 3, 4) with left u, left v, right u, right v."""
    by_readings: Array
    """(..., 3, r) with the readings, or the increments of both measured poses (r = 12)."""
    pixels_by_head: tuple[tuple[Array, ...], ...]
    """By camera parts (..., 2, p) of the derivatives of its pixels by its
    `parameters.camera_columns`; empty where they are not wanted."""


def by_head_parameters(
    head: HeadCalibration, cameras: tuple[str, str] | None, seen: Linearised
) -> Array:
    """Compute how points change (..., 3, P) with the P `pair_parameters`."""
    count = len(pair_parameters(head, cameras))
    total = batch_first(np.zeros((3, count, *seen.status.shape)), 2)
    for k, (parts, columns) in enumerate(
        zip(seen.pixels_by_head, pair_columns(head, cameras), strict=True)
    ):
        # The point makes up for what changes, so that its projection stays where it was seen.
        by_pixels = seen.by_pixels[..., 2 * k : 2 * k + 2]
        total[..., columns] -= product(by_pixels, joined(*parts))
    return total


def by_noise(
    seen: Linearised, noise: tuple[Array, Array], part: Part = slice(None)
) -> tuple[Array, Array]:
    """Compute changes (..., 3, 4) and (..., 3, r) of points by one standard deviation of each."""
    of_pixels, of_readings = (noise_of_part(each, part)[..., None, :] for each in noise)
    return seen.by_pixels * of_pixels, seen.by_readings * of_readings


def covariances_of(changes: Array) -> Array:
    """Compute covariances (..., 3, 3) of changes (..., 3, K) by K independent deviations."""
    return product(changes, changes.swapaxes(-1, -2))


def linearised(
    head: HeadCalibration,
    *,
    left: Array,
    right: Array,
    joints: Array,
    cameras: tuple[str, str] | None = None,
) -> Linearised:
    """Locate points with all their derivatives, for as many points as memory has room for.

    Pixels count equally. Arguments and errors are those of `locate`.
    """
    left, right, joints = checked_arguments(left, right, joints, head.kinematics)
    return linearised_part(head, (left, right), joints, cameras, pixel_variances(1.0, len(left)))


@ignoring_invalid
def linearised_part(
    head: HeadCalibration,
    pixels: tuple[Array, Array],
    joints: Array,
    cameras: tuple[str, str] | None,
    variances: Array,
    *,
    part: Part = slice(None),
    parameters: bool = True,
) -> Linearised:
    """Locate some of N points; `parameters`: whether derivatives by the head's are wanted too.

    Variances are those of `measurement_noise.pixel_variances`.
    """
    pixels, joints = (pixels[0][part], pixels[1][part]), joints_of_part(joints, part)
    variances = noise_of_part(variances, part)
    pair, eyes = stereo_cameras(head, cameras), eye_motions(head, joints, errors=parameters)
    poses = [eye.T_base_eye for eye in eyes]
    points, status = intersect_rays(pair, head.T_rbase_lbase, poses, pixels, variances)
    seen = [
        projected(mounted, head.T_rbase_lbase, T, points, parameters=parameters)
        for mounted, T in zip(pair, poses, strict=True)
    ]
    by_pixels = _by_pixels(seen[0].by_point, seen[1].by_point, variances)
    by_readings, pixels_by_head = [], []
    for k, (eye, J) in enumerate(zip(eyes, seen, strict=True)):
        by_moves = product(J.by_T_base_eye, eye.by_moves)
        # The point makes up for what changes, so that its projection stays where it was seen.
        moves = product(by_pixels[..., 2 * k : 2 * k + 2], by_moves[..., : len(eye.mixing)])
        by_readings.append(eye.by_readings(moves))
        if parameters:
            pixels_by_head.append(
                (J.by_lens, J.by_T_eye_cam, J.by_T_rbase_lbase, eye.by_errors(by_moves))
            )
    left, right = by_readings
    return Linearised(points, status, by_pixels, -(left + right), tuple(pixels_by_head))


def _by_pixels(left: Array, right: Array, variances: Array) -> Array:
    """Compute the derivatives (..., 3, 4) of a located point by its pixels.

    Three pixel coordinates determine a point: both of the left image, and in the right one that
    along the epipolar line. The fourth is how far the rays miss each other, and the pixels share
    this in proportion to their variances. By the implicit function theorem, of the point whose
    projections are nearest to its pixels.

    Args:
        left: (..., 2, 3) derivatives of the left pixel by the point.
        right: (..., 2, 3) the same of the right one.
        variances: (..., 4) of left u, left v, right u, right v.
    """
    a, b = left[..., 0, :], left[..., 1, :]
    ray = cross(a, b)
    across = times(right, ray)  # the direction of the epipolar line
    m1, m2 = batch_last(across)
    scale = (1.0 / (m1 * m1 + m2 * m2))[..., None]
    along, off = times_transposed(right, across), times_transposed(right, vector(-m2, m1))
    inverse = batch_first(np.empty((3, 4, *m1.shape)), 2)
    inverse[..., 0], inverse[..., 1] = scale * cross(b, along), scale * cross(along, a)
    inverse[..., 2:] = (scale * ray)[..., :, None] * across[..., None, :]
    by_left = times_transposed(inverse[..., :2], off)
    miss = batch_first(np.empty((4, *m1.shape)))
    miss[..., :2], miss[..., 2], miss[..., 3] = -by_left, -m2, m1
    shares = miss * variances
    by_miss = times(inverse, shares) / dot(shares, miss)[..., None]
    return inverse - by_miss[..., :, None] * miss[..., None, :]
