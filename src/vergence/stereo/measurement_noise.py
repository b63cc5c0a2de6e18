"""Noise of what points are located from: pixels, readings and measured poses, checked by shape.

Standard deviations are (n, count) for n points or (1, count) for all of them alike.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array, floats
from vergence.errors import VergenceError
from vergence.geometry.eye_motion import measured
from vergence.geometry.head import HeadCalibration, pixel_stds, reading_stds


def measurement_noise(
    head: HeadCalibration, joints: Array, n: int, pixel_std_px: ArrayLike, joint_std_rad: ArrayLike
) -> tuple[Array, Array]:
    """Check standard deviations: (n or 1, 4) of pixels and (n or 1, r) of readings or poses."""
    count = 12 if measured(joints) else len(head.kinematics.readings)
    return pixel_noise(pixel_std_px, n), noise_of_readings(joint_std_rad, count, n)


def given_or_stated(
    head: HeadCalibration,
    joints: Array,
    pixel_std_px: ArrayLike | None,
    joint_std_rad: ArrayLike | None,
    cameras: tuple[str, str] | None,
) -> tuple[ArrayLike, ArrayLike]:
    """Return the noise of pixels and readings; None: as the calibration states it, 0 if not."""
    if pixel_std_px is None:
        pixel_std_px = pixel_stds(head, cameras)
    if joint_std_rad is None:
        joint_std_rad = stated_reading_stds(head, joints)
    return pixel_std_px, joint_std_rad


def stated_reading_stds(head: HeadCalibration, joints: Array) -> Array:
    """Return the stated noise of readings (r,) [rad], or of measured poses (2,) [rad], [m]."""
    if measured(joints):
        levels = head.accuracy.joint_std if head.accuracy else ()
        return np.resize(levels or (0.0,), 2)
    return _reading_stds(head)


_reading_stds = lru_cache(maxsize=64)(reading_stds)


def noise_rows(std: ArrayLike, count: int, n: int, name: str) -> Array:
    """Check standard deviations (n or 1, count) of n measurements of `count` numbers each.

    From a number, (count,) or (n, count); VergenceError if they are neither, or one is negative.
    """
    stds = floats(name, std)
    if stds.shape not in ((), (count,), (n, count)):
        raise VergenceError(
            f"{name} is a number or an array of shape ({count},) or ({n}, {count}); found one of "
            f"shape {stds.shape}."
        )
    # Of many points some may have none: NaN, where they are not seen.
    wrong = (stds < 0) | (~np.isfinite(stds) & (stds.ndim < 2))
    if wrong.any():
        raise VergenceError(
            f"{name} is a standard deviation, 0 or more; found {stds[wrong].flat[0]:g}."
        )
    return np.atleast_2d(stds) if stds.ndim else stds.repeat(count)[None]


def pixel_noise(pixel_std_px: ArrayLike, n: int) -> Array:
    """Check standard deviations (n or 1, 4) of pixels; arguments and errors: `noise_rows`."""
    return noise_rows(pixel_std_px, 4, n, "pixel_std_px")


def pixel_variances(pixel_std_px: ArrayLike, n: int) -> Array:
    """Compute variances (n or 1, 4) of pixels, as weights of a triangulation.

    In the order left u, left v, right u, right v. Ones for points some of whose noise is zero or
    unknown: with an exact pixel there are no ratios. Errors are those of `noise_rows`.
    """
    std = pixel_noise(pixel_std_px, n)
    return np.where((std > 0).all(axis=1, keepdims=True), std * std, 1.0)


def noise_of_part(noise: Array, part: slice | int) -> Array:
    """Return the noise (..., count) of a chunk; that of all points is (count,)."""
    return noise[0] if len(noise) == 1 else noise[part]


def noise_of_readings(joint_std: ArrayLike, count: int, n: int) -> Array:
    """Check standard deviations (n or 1, r) of readings; of poses from rotation, translation.

    From a number, (r,) or (n, r), or for measured poses (count 12) the two numbers of `locate`.
    Errors are those of `noise_rows`.
    """
    if count == 12 and np.shape(joint_std) == (2,):
        return noise_rows(np.tile(np.repeat(joint_std, 3), 2), count, n, "joint_std_rad")
    return noise_rows(joint_std, count, n, "joint_std_rad")
