"""Derivatives of located points, and their covariance by the calibration."""

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
from vergence.geometry.head import (
    HeadCalibration,
    parameter_names,
    stated_covariance,
    states_covariance,
)
from vergence.geometry.parameters import camera_columns
from vergence.geometry.projection import project_with_jacobians
from vergence.geometry.se3 import cross
from vergence.stereo.triangulation import Sightings, intersect_rays


def pair_parameters(head: HeadCalibration, cameras: tuple[str, str]) -> tuple[str, ...]:
    """List the names of the P parameters that the points of a pair of cameras depend on."""
    names = parameter_names(head)
    return tuple(names[k] for k in _of_pair(head, cameras)[0])


@lru_cache(maxsize=64)
def _of_pair(head: HeadCalibration, cameras: tuple[str, str]) -> tuple[np.ndarray, ...]:
    """Find the parameters of both cameras, and the indices of each camera's among them."""
    columns = [camera_columns(head, name) for name in cameras]
    both = np.unique(np.concatenate(columns))
    return both, *(np.searchsorted(both, own) for own in columns)


@dataclass(frozen=True, eq=False)
class Linearised:
    """Located points, and their derivatives by pixels, readings and parameters.

    Derivatives are those of rays that meet, which holds to first order. NaN: not located.
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


def by_head_parameters(located: Linearised, seen: Sightings) -> Array:
    """Compute the derivatives (..., 3, P) of points by the P `pair_parameters`."""
    both, *columns = _of_pair(seen.head, seen.cameras)
    total = batch_first(np.zeros((3, len(both), *located.status.shape)), 2)
    for k, parts in enumerate(located.pixels_by_head):
        # The point moves so that its projection stays at the detected pixel.
        by_pixels = located.by_pixels[..., 2 * k : 2 * k + 2]
        total[..., columns[k]] -= product(by_pixels, joined(*parts))
    return total


def by_noise(located: Linearised, seen: Sightings) -> tuple[Array, Array]:
    """Compute changes (..., 3, 4), (..., 3, r) of points by one std of each pixel and reading."""
    by_pixels = located.by_pixels * seen.pixel_std_px[..., None, :]
    return by_pixels, located.by_readings * seen.reading_std[..., None, :]


def covariances_of(changes: Array) -> Array:
    """Compute covariances (..., 3, 3) of K independent errors with changes (..., 3, K)."""
    return product(changes, changes.swapaxes(-1, -2))


@ignoring_invalid
def linearised(seen: Sightings, *, parameters: bool = True) -> Linearised:
    """Locate points and compute their derivatives, all points at once.

    Args:
        seen: pixels and readings of the points.
        parameters: whether to compute the derivatives by the head's parameters too.
    """
    head = seen.head
    eyes = eye_motions(head, seen.joints, errors=parameters)
    points, status = intersect_rays(seen, [eye.T_base_eye for eye in eyes])
    views = [
        project_with_jacobians(
            head.camera(name), head.T_rbase_lbase, eye.T_base_eye, points, parameters=parameters
        )
        for name, eye in zip(seen.cameras, eyes, strict=True)
    ]
    by_pixels = _by_pixels(views[0].by_point, views[1].by_point, seen.variances)
    by_readings, pixels_by_head = [], []
    for k, (eye, J) in enumerate(zip(eyes, views, strict=True)):
        by_moves = product(J.by_T_base_eye, eye.by_moves)
        # The point moves so that its projection stays at the detected pixel.
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

    Three pixel coordinates determine a point: both in the left image, and the one along the
    epipolar line in the right image. The fourth, across that line, is the residual, which is
    distributed over the pixels in proportion to their variances. The derivatives follow from the
    implicit function theorem, with the derivatives left and right (..., 2, 3) of both projections
    by the point.
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


@lru_cache(maxsize=64)
def pair_covariance(head: HeadCalibration, cameras: tuple[str, str]) -> tuple[Array, ...]:
    """Select the stated covariance (P, P) of `pair_parameters`; empty if none is stated.

    Then its blocks by the `camera_columns` of left and left, left and right, right and right.
    """
    if not states_covariance(head):
        return ()
    both, left, right = _of_pair(head, cameras)
    stated, known = stated_covariance(head, pair_parameters(head, cameras))
    C = np.zeros((len(both), len(both)))
    C[np.ix_(stated, stated)] = known
    return C, C[np.ix_(left, left)], C[np.ix_(left, right)], C[np.ix_(right, right)]


def covariance_of_calibration(located: Linearised, known: tuple[Array, ...]) -> Array:
    """Compute the part of a `pair_covariance` in the covariances (..., 3, 3) of points.

    It is propagated through the covariance of the four pixel coordinates, in half the time.
    """
    _, by_left, across, by_right = known
    left, right = (joined(*parts) for parts in located.pixels_by_head)
    pixels = batch_first(np.empty((4, 4, *located.status.shape)), 2)
    pixels[..., :2, :2] = _sandwiched(left, by_left, left)
    pixels[..., :2, 2:] = _sandwiched(left, across, right)
    pixels[..., 2:, :2] = pixels[..., :2, 2:].swapaxes(-1, -2)
    pixels[..., 2:, 2:] = _sandwiched(right, by_right, right)
    return _sandwiched(located.by_pixels, pixels, located.by_pixels)


def _sandwiched(J: Array, C: Array, other: Array) -> Array:
    return product(product(J, C), other.swapaxes(-1, -2))
