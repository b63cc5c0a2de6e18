"""What points are located from: pixels in both cameras, joint readings, and their noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Required, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array, floats
from vergence.errors import VergenceError, counted
from vergence.geometry.eye_motion import check_joints, measured
from vergence.geometry.head import HeadCalibration, pair_names, pixel_stds, reading_stds

CHUNK = 4096
"""Points at a time, so that memory does not grow; chosen with benchmarks/located_points.py."""


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
    left, right, joints = floats("left", left), floats("right", right), floats("joints", joints)
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
