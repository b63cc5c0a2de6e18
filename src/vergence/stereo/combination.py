"""Sums and differences of located points, whose errors are in part the same."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array, floats, single_blas_thread
from vergence.errors import VergenceError, counted
from vergence.geometry.head import HeadCalibration
from vergence.stereo.calibration_covariance import pair_factor
from vergence.stereo.linearised import by_head_parameters, by_noise, covariances_of, linearised_part
from vergence.stereo.measurement_noise import given_or_stated, measurement_noise, pixel_variances
from vergence.stereo.triangulation import checked_arguments, chunks


@single_blas_thread()
def combination(
    head: HeadCalibration,
    *,
    weights: Array,
    left: Array,
    right: Array,
    joints: Array,
    cameras: tuple[str, str] | None = None,
    pixel_std_px: ArrayLike | None = None,
    joint_std_rad: ArrayLike | None = None,
) -> tuple[Array, Array]:
    """Return the sum (3,) [m] of points times weights (N,), and its covariance (3, 3) [m^2].

    With weights 1/N an average, with 1 and -1 a difference. Errors of pixels are each point's own;
    those of readings are too, but are shared by all points where one posture serves all; and those
    of the calibration are always shared. Points that cannot be located must have weight zero, or
    the result is NaN. Other arguments and errors are those of `locate`; noise that neither the
    caller nor the calibration states is taken as none. VergenceError also if there are not as many
    weights as points, or one is not finite.
    """
    left, right, joints = checked_arguments(left, right, joints, head.kinematics)
    factor, n = pair_factor(head, cameras), len(left)
    weights = floats("weights", weights)
    if weights.shape != (n,):
        raise VergenceError(
            f"A combination of {counted(n, 'point')} has a weight for each; found an array of "
            f"shape {weights.shape}."
        )
    if not np.isfinite(weights).all():
        raise VergenceError(
            "Weights of a combination are finite, 0 for points that do not count; found "
            f"{weights[~np.isfinite(weights)][0]:g}."
        )
    pixel_std_px, joint_std_rad = given_or_stated(
        head, joints, pixel_std_px, joint_std_rad, cameras
    )
    noise = measurement_noise(head, joints, n, pixel_std_px, joint_std_rad)
    one = joints.ndim in (1, 3)
    given = head, (left, right), joints, cameras, pixel_variances(pixel_std_px, n)
    total, covariance = np.zeros(3), np.zeros((3, 3))
    by_readings, by_head = np.zeros((3, noise[1].shape[1])), np.zeros((3, len(factor)))
    for part in chunks(n):
        seen = linearised_part(*given, part=part)
        own, counts = weights[part][:, None, None], weights[part] != 0
        by_pixels, by_reading, by_parameter = (
            (each * own)[counts]
            for each in (*by_noise(seen, noise, part), by_head_parameters(head, cameras, seen))
        )
        total += weights[part][counts] @ seen.points[counts]
        covariance += covariances_of(by_pixels).sum(axis=0)
        if not one:
            covariance += covariances_of(by_reading).sum(axis=0)
        by_readings = by_readings + one * by_reading.sum(axis=0)
        by_head = by_head + by_parameter.sum(axis=0)
    for shared in (by_readings, by_head @ factor):
        covariance += shared @ shared.T
    return total, covariance


def locate_both(
    head: HeadCalibration,
    *,
    left: tuple[Array, Array],
    right: tuple[Array, Array],
    joints: Array,
    pixel_std_px: ArrayLike,
    joint_std_rad: ArrayLike,
    cameras: tuple[str, str] | None = None,
) -> tuple[Array, Array, Array]:
    """Return two points that are seen together, and the covariance of their difference.

    Both are seen by the same cameras at the same readings, so that an error of the readings is in
    both, and cancels as far as the two are near each other. The calibration is taken as exact.

    `left` and `right` have the pixels (N, 2) of points a and of points b; other arguments and
    errors are those of `locate`. Returns points a and b (N, 3) [m], and covariances (N, 3, 3) [m^2]
    of a - b, in the left eye's base frame; NaN where a point cannot be located.
    """
    joints, n = floats("joints", joints), len(left[0])
    noise, points, changes = measurement_noise(head, joints, n, pixel_std_px, joint_std_rad), [], []
    for own in zip(left, right, strict=True):
        u_l, u_r, readings = checked_arguments(*own, joints, head.kinematics)
        given = head, (u_l, u_r), readings, cameras, pixel_variances(pixel_std_px, n)
        seen = linearised_part(*given, parameters=False)
        points.append(seen.points)
        changes.append(by_noise(seen, noise))
    (a_px, a_rad), (b_px, b_rad) = changes
    return *points, covariances_of(a_px) + covariances_of(b_px) + covariances_of(a_rad - b_rad)
