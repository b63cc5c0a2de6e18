"""Located points with their derivatives by all that they depend on.

`uncertainty` makes covariances of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from vergence.arrays import Array
from vergence.geometry.components import (
    Component,
    Rows,
    components,
    cross,
    dot,
    ignoring_invalid,
    quotient,
    stacked,
)
from vergence.geometry.eye_motion import eye_motions, measured
from vergence.geometry.head import HeadCalibration, pair_names
from vergence.geometry.parameters import camera_columns, parameter_names
from vergence.geometry.projection import by_camera_columns, by_increments, projected
from vergence.stereo.extrinsics import per_pair, stereo_cameras
from vergence.stereo.measurement_noise import noise_of_part, pixel_variances
from vergence.stereo.triangulation import checked_arguments, intersect_rays, joints_of_part


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
    """n located points, and how they change with all that they depend on, components first.

    To first order: of rays that pass each other far off, derivatives are those of rays that meet.
    NaN: not located.
    """

    points: Array
    """(3, n)."""
    status: np.ndarray
    """(n,)."""
    by_pixels: Array
    """(3, 4, n) with left u, left v, right u, right v."""
    by_readings: Array
    """(3, r, n) with the readings, or the increments of both measured poses (r = 12)."""
    pixels_by_head: tuple[Sequence[tuple[Component, Component]], ...]
    """(p, 2) by camera, by components: its pixels by its `parameters.camera_columns`; empty where
    they are not wanted."""


def by_head_parameters(
    head: HeadCalibration, cameras: tuple[str, str] | None, seen: Linearised
) -> Array:
    """Return how points change (3, P, n) with the P `pair_parameters`."""
    total = np.zeros((3, len(pair_parameters(head, cameras)), seen.points.shape[1]))
    for k, (pairs, columns) in enumerate(
        zip(seen.pixels_by_head, pair_columns(head, cameras), strict=True)
    ):
        by_u, by_v = seen.by_pixels[:, 2 * k, None], seen.by_pixels[:, 2 * k + 1, None]
        pixels = stacked(pairs, seen.status.shape, 2)
        # The point makes up for what changes, so that its projection stays where it was seen.
        total[:, columns] -= by_u * pixels[:, 0] + by_v * pixels[:, 1]
    return total


def by_noise(
    seen: Linearised, noise: tuple[Array, Array], part: slice = slice(None)
) -> tuple[Array, Array]:
    """Return changes (3, 4, n) and (3, r, n) of points by one standard deviation of each."""
    of_pixels, of_readings = (noise_of_part(each, part) for each in noise)
    return seen.by_pixels * of_pixels, seen.by_readings * of_readings


def covariances_of(changes: Array) -> Array:
    """Return covariances (n, 3, 3) of changes (3, K, n) by K independent standard deviations."""
    return np.einsum("ikn,jkn->nij", changes, changes)


def linearised(
    head: HeadCalibration,
    *,
    left: Array,
    right: Array,
    joints: Array,
    cameras: tuple[str, str] | None = None,
) -> Linearised:
    """Return points and all their derivatives, for as many points as memory has room for.

    Pixels count equally. Arguments and errors are those of `locate`.
    """
    left, right, joints = checked_arguments(left, right, joints, head.kinematics)
    return linearised_part(head, (left, right), joints, cameras, pixel_variances(1.0, len(left)))


def linearised_part(
    head: HeadCalibration,
    pixels: tuple[Array, Array],
    joints: Array,
    cameras: tuple[str, str] | None,
    variances: Array,
    *,
    part: slice = slice(None),
    parameters: bool = True,
) -> Linearised:
    """Locate some of N points; `parameters`: whether derivatives by the head's are wanted too.

    Variances are those of `measurement_noise.pixel_variances`.
    """
    pixels, joints = (pixels[0][part], pixels[1][part]), joints_of_part(joints, part)
    variances = noise_of_part(variances, part)
    pair, eyes = stereo_cameras(head, cameras), eye_motions(head, joints)
    points, status = intersect_rays(pair, head.T_rbase_lbase, eyes, pixels, variances)
    shape, point = status.shape, components(points)
    rows = [
        projected(mounted, head.T_rbase_lbase, eye.R, eye.t, point, parameters=parameters)
        for mounted, eye in zip(pair, eyes, strict=True)
    ]
    with ignoring_invalid(point[0]):
        by_pixels = _by_pixels(rows[0].by_point, rows[1].by_point, components(variances))
    count = 12 if measured(joints) else joints.shape[1]
    by_readings = [[0.0] * count for _ in range(3)]
    pixels_by_head = []
    for k, (eye, own) in enumerate(zip(eyes, rows, strict=True)):
        by_angles = by_increments(own.by_T_base_eye, eye.by_angles)
        for total, by_pixel in zip(by_readings, by_pixels, strict=True):
            # The point makes up for what changes, so that its projection stays where it was seen.
            moves = [by_pixel[2 * k] * u + by_pixel[2 * k + 1] * v for u, v in by_angles]
            for joint, reading, factor in eye.angle_by_readings:
                total[reading] = total[reading] - factor * moves[joint]
        if parameters:
            pixels_by_head.append(by_camera_columns(own, eye, by_angles))
    return Linearised(
        points,
        status,
        stacked(by_pixels, shape, 2),
        stacked(by_readings, shape, 2),
        tuple(pixels_by_head),
    )


def _by_pixels(left: Rows, right: Rows, variances: Sequence[Component]) -> Rows:
    """Return the derivatives (3, 4) of a located point by its pixels.

    Three pixel coordinates determine a point: both of the left image, and in the right one that
    along the epipolar line. The fourth says by how much the rays miss each other, and the pixels
    share this in proportion to their variances.

    Args:
        left: (2, 3) derivatives of the left pixel by the point.
        right: (2, 3) the same of the right one.
        variances: (4) of left u, left v, right u, right v.
    """
    a, b = left
    along = cross(a, b)  # the left ray
    m1, m2 = dot(right[0], along), dot(right[1], along)
    c = [m1 * one + m2 * other for one, other in zip(*right, strict=True)]
    d = [m1 * other - m2 * one for one, other in zip(*right, strict=True)]
    scale = quotient(1.0, m1 * m1 + m2 * m2)
    by_a, by_b = ([scale * each for each in of] for of in (cross(b, c), cross(c, a)))
    along = [scale * each for each in along]
    rows = [
        (to_a, to_b, m1 * ray, m2 * ray) for to_a, to_b, ray in zip(by_a, by_b, along, strict=True)
    ]
    miss = -dot(d, by_a), -dot(d, by_b), -m2, m1
    shares = [each * variance for each, variance in zip(miss, variances, strict=True)]
    total = sum(share * each for share, each in zip(shares, miss, strict=True))
    found = []
    for row in rows:
        along_miss = quotient(sum(p * q for p, q in zip(row, shares, strict=True)), total)
        found.append([p - along_miss * q for p, q in zip(row, miss, strict=True)])
    return found
