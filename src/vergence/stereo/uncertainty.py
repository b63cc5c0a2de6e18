"""Located points and their covariances: noise of pixels and joints, and the calibration's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array
from vergence.data.dataset import MAX_GAP_S
from vergence.data.timing import Timing, moved_readings
from vergence.errors import VergenceError, counted
from vergence.geometry.eye_motion import check_joints, measured
from vergence.geometry.head import (
    HeadCalibration,
    check_states_covariance,
    reading_stds,
    stated_covariance,
    states_noise,
)
from vergence.stereo.calibration_covariance import (
    covariance_of_calibration,
    pair_covariance,
    pair_factor,
)
from vergence.stereo.linearised import (
    Linearised,
    by_head_parameters,
    linearised_part,
    pair_parameters,
)
from vergence.stereo.triangulation import (
    checked_arguments,
    chunks,
    in_chunks,
    noise_of_part,
    noise_rows,
    pixel_noise,
    pixel_variances,
    triangulate_at,
)


@dataclass(frozen=True, eq=False)
class LocatedPoints:
    """Where N points are."""

    xyz: Array
    """(N, 3) [m] in the left eye's base frame (x forward = depth, y left, z up); NaN where the
    status is not OK."""
    covariance: Array
    """(N, 3, 3) [m^2], to first order, of noise and calibration together; NaN where the status is
    not OK, or where neither the caller nor the calibration states any noise."""
    status: np.ndarray
    """(N,) of triangulation.Status."""
    calibration_covariance: Array
    """(N, 3, 3) [m^2]: the part of `covariance` that the calibration's makes. Its errors are the
    same in all points, so that no average makes them smaller: see `combination`. Zero where the
    calibration states none."""


def locate(
    head: HeadCalibration,
    *,
    left: Array,
    right: Array,
    joints: Array,
    cameras: tuple[str, str] | None = None,
    pixel_std_px: ArrayLike | None = None,
    joint_std_rad: ArrayLike | None = None,
    joint_time_s: ArrayLike | None = None,
) -> LocatedPoints:
    """Return where points are that both eyes see, and how well that is known.

    Args:
        head: with or without its accuracy.
        left: (N, 2) pixels in the left camera, distortion included; NaN: not seen.
        right: (N, 2) pixels of the same points in the right camera.
        joints: (r,) joint readings [rad] of one posture that serves all points, or (N, r), in the
            order of head.kinematics.readings, by default left pan, left tilt, right pan, right
            tilt. Or, where the eyes' poses are measured, T_base_eye of the left and the right eye:
            (2, 4, 4), or (N, 2, 4, 4).
        cameras: names of a camera of the left eye and one of the right; None: the main ones (the
            wide ones, where a head has such).
        pixel_std_px: noise of (left u, left v, right u, right v), by which they are weighted; a
            number stands for all, and (4,) or (N, 4) are taken as they are. None: that of the
            corners of the calibration.
        joint_std_rad: noise of each reading: a number, (r,) or (N, r); of measured poses the two
            numbers of rotation [rad] and translation [m]. None: as the calibration found it.
        joint_time_s: (N,) time stamps of the readings of one motion, at most 0.2 s apart; each is
            then moved to the moment that its image shows, by the head's time offset, along a
            polynomial through its neighbours. None: the eyes stood still.

    Raises:
        VergenceError: shapes do not fit, readings are not in radians, poses are not rigid, noise is
            negative, time stamps are not those of one motion, the head has no such camera, or left
            and right are exchanged.
    """
    if joint_time_s is not None:
        joints = _at_the_images(head, joints, joint_time_s)
    left, right, joints = checked_arguments(left, right, joints, head.kinematics)
    known, n = pair_covariance(head, cameras), len(left)
    if not states_noise(head) and pixel_std_px is None and joint_std_rad is None:
        points, status = triangulate_at(
            head, left=left, right=right, joints=joints, cameras=cameras
        )
        return LocatedPoints(points, np.full((n, 3, 3), np.nan), status, np.zeros((n, 3, 3)))
    pixel_std_px, joint_std_rad = _or_stated(head, joints, pixel_std_px, joint_std_rad)
    noise = _noise(head, joints, n, pixel_std_px, joint_std_rad)
    given = head, (left, right), joints, cameras, pixel_variances(pixel_std_px, n)

    def find(part: slice) -> tuple[Array, ...]:
        seen = linearised_part(*given, part=part, parameters=known is not None)
        by_pixels, by_readings = _by_noise(seen, noise, part)
        covariance = _squares(by_pixels) + _squares(by_readings)
        if known is None:
            return seen.points.T, covariance, seen.status, np.zeros_like(covariance)
        shared = covariance_of_calibration(seen, known)
        return seen.points.T, covariance + shared, seen.status, shared

    return LocatedPoints(*in_chunks(n, find))


def _or_stated(
    head: HeadCalibration,
    joints: Array,
    pixel_std_px: ArrayLike | None,
    joint_std_rad: ArrayLike | None,
) -> tuple[ArrayLike, ArrayLike]:
    """Return the noise of pixels and readings; None: as the calibration states it, 0 if not."""
    if pixel_std_px is None:
        pixel_std_px = (head.accuracy and head.accuracy.pixel_std_px) or 0.0
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


def _at_the_images(head: HeadCalibration, joints: ArrayLike, joint_time_s: ArrayLike) -> Array:
    """Return readings, or poses, at the moments of the images; VergenceError: see `locate`."""
    joints, joint_time_s = (np.asarray(each, dtype=float) for each in (joints, joint_time_s))
    shape = (2, 4, 4) if measured(joints) else (len(head.kinematics.readings),)
    if joint_time_s.ndim != 1 or joints.shape != (len(joint_time_s), *shape):
        raise VergenceError(
            f"Readings that have time stamps are one for each: found readings of shape "
            f"{joints.shape} and time stamps of shape {joint_time_s.shape}."
        )
    if unknown := int((~np.isfinite(joint_time_s)).sum()):
        raise VergenceError(
            f"Time stamps of readings are finite; found {unknown} of {len(joint_time_s)} NaN or "
            "infinite; leave their points out."
        )
    check_joints(head.kinematics, joints)
    steps = np.diff(joint_time_s)
    if (steps < 0).any() or (steps > MAX_GAP_S).any():
        raise VergenceError(
            f"Time stamps of a motion increase by at most {MAX_GAP_S} s from reading to reading, "
            f"found {steps.min():.3g} to {steps.max():.3g} s; locate each motion by itself."
        )
    distinct, which = np.unique(joint_time_s, return_inverse=True)  # points of one image
    first = np.searchsorted(joint_time_s, distinct)
    timing = Timing(distinct, np.ones(len(distinct), dtype=int))
    return moved_readings(joints[first], timing, head.time_offset_s)[which]


def locate_with_covariance(
    head: HeadCalibration,
    *,
    left: Array,
    right: Array,
    joints: Array,
    pixel_std_px: ArrayLike,
    joint_std_rad: ArrayLike,
    cameras: tuple[str, str] | None = None,
) -> tuple[Array, Array]:
    """Return points (N, 3) [m] and the covariances (N, 3, 3) [m^2] that measurement noise makes.

    The calibration is taken as exact. NaN where a point cannot be located. Arguments and errors are
    those of `locate`.
    """
    found = locate(
        _exact(head),
        left=left,
        right=right,
        joints=joints,
        cameras=cameras,
        pixel_std_px=pixel_std_px,
        joint_std_rad=joint_std_rad,
    )
    return found.xyz, found.covariance


@lru_cache(maxsize=64)
def _exact(head: HeadCalibration) -> HeadCalibration:
    """Return a head that states no accuracy."""
    return replace(head, accuracy=None)


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
    weights = np.asarray(weights, dtype=float)
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
    pixel_std_px, joint_std_rad = _or_stated(head, joints, pixel_std_px, joint_std_rad)
    noise, one = _noise(head, joints, n, pixel_std_px, joint_std_rad), joints.ndim in (1, 3)
    given = head, (left, right), joints, cameras, pixel_variances(pixel_std_px, n)
    total, covariance = np.zeros(3), np.zeros((3, 3))
    by_readings, by_head = np.zeros((3, len(noise[1]))), np.zeros((3, len(factor)))
    for part in chunks(n):
        seen = linearised_part(*given, part=part)
        own = weights[part]
        points, by_pixels, by_reading, by_parameter = (
            np.where(own == 0, 0.0, each) * own
            for each in (
                seen.points,
                *_by_noise(seen, noise, part),
                by_head_parameters(head, cameras, seen),
            )
        )
        total += points.sum(axis=-1)
        covariance += _squares(by_pixels).sum(axis=0)
        if not one:
            covariance += _squares(by_reading).sum(axis=0)
        by_readings = by_readings + one * by_reading.sum(axis=-1)
        by_head = by_head + by_parameter.sum(axis=-1)
    for shared in (by_readings, by_head @ factor):
        covariance += shared @ shared.T
    return total, covariance


def locate_jointly(
    head: HeadCalibration,
    *,
    left: Array,
    right: Array,
    joints: Array,
    parameters: Sequence[str],
    covariance: Array,
    pixel_std_px: ArrayLike,
    cameras: tuple[str, str] | None = None,
) -> LocatedPoints:
    """Return where points are, if head and readings were estimated together.

    The covariance (P + r, P + r) is of the named parameters of the head, then of the r readings
    (r,) [rad] of the one posture that serves all points. What the head states of its other
    parameters counts too, as if it were independent. Other arguments and errors are those of
    `locate`.
    """
    left, right, joints = checked_arguments(left, right, joints, head.kinematics)
    n, P, names = len(left), len(parameters), pair_parameters(head, cameras)
    noise, variances = pixel_noise(pixel_std_px, n), pixel_variances(pixel_std_px, n)
    mine = [k for k, name in enumerate(parameters) if name in names]
    theirs = [names.index(parameters[k]) for k in mine]
    others = [k for k in range(len(names)) if k not in theirs]
    stated, C = stated_covariance(head, [names[k] for k in others])
    beside = [others[k] for k in stated]

    def find(part: slice) -> tuple[Array, ...]:
        seen = linearised_part(head, (left, right), joints, cameras, variances, part=part)
        by_head = by_head_parameters(head, cameras, seen)
        own = np.zeros((3, len(covariance), len(seen.status)))
        own[:, mine], own[:, P:] = by_head[:, theirs], seen.by_readings
        own, rest = own.transpose(2, 0, 1), by_head[:, beside].transpose(2, 0, 1)
        of_rest = rest @ C @ rest.swapaxes(1, 2)
        of_head = own[..., :P] @ covariance[:P, :P] @ own[..., :P].swapaxes(1, 2)
        whole = _squares(seen.by_pixels * noise_of_part(noise, part))
        whole += own @ covariance @ own.swapaxes(1, 2)
        return seen.points.T, whole + of_rest, seen.status, of_head + of_rest

    return LocatedPoints(*in_chunks(n, find))


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
    joints, n = np.asarray(joints, dtype=float), len(left[0])
    noise, points, changes = _noise(head, joints, n, pixel_std_px, joint_std_rad), [], []
    for own in zip(left, right, strict=True):
        u_l, u_r, readings = checked_arguments(*own, joints, head.kinematics)
        given = head, (u_l, u_r), readings, cameras, pixel_variances(pixel_std_px, n)
        seen = linearised_part(*given, parameters=False)
        points.append(seen.points.T)
        changes.append(_by_noise(seen, noise))
    (a_px, a_rad), (b_px, b_rad) = changes
    return *points, _squares(a_px) + _squares(b_px) + _squares(a_rad - b_rad)


def calibration_covariance(
    head: HeadCalibration,
    *,
    left: Array,
    right: Array,
    joints: Array,
    cameras: tuple[str, str] | None = None,
) -> Array:
    """Return what the calibration's covariance adds (N, 3, 3) [m^2] to points that are located.

    Arguments and errors are those of `locate`; VergenceError also if the head states no covariance.
    """
    check_states_covariance(head)
    found = locate(head, left=left, right=right, joints=joints, cameras=cameras)
    return np.where(np.isnan(found.covariance), np.nan, found.calibration_covariance)


def _squares(changes: Array) -> Array:
    """Return covariances (n, 3, 3) of changes (3, K, n) by K independent standard deviations."""
    return np.einsum("ikn,jkn->nij", changes, changes)


def _noise(
    head: HeadCalibration, joints: Array, n: int, pixel_std_px: ArrayLike, joint_std_rad: ArrayLike
) -> tuple[Array, Array]:
    """Return standard deviations (4, n or 1) of pixels and (r, n or 1) of readings or poses."""
    count = 12 if measured(joints) else len(head.kinematics.readings)
    return pixel_noise(pixel_std_px, n), noise_of_readings(joint_std_rad, count, n)


def _by_noise(
    seen: Linearised, noise: tuple[Array, Array], part: slice = slice(None)
) -> tuple[Array, Array]:
    """Return changes (3, 4, n) and (3, r, n) of points by one standard deviation of each."""
    of_pixels, of_readings = (noise_of_part(each, part) for each in noise)
    return seen.by_pixels * of_pixels, seen.by_readings * of_readings


def noise_of_readings(joint_std: ArrayLike, count: int, n: int) -> Array:
    """Return standard deviations (r, n or 1) of readings; of poses from rotation, translation.

    From a number, (r,) or (n, r), or for measured poses (count 12) the two numbers of `locate`.
    Errors are those of `noise_rows`.
    """
    if count == 12 and np.shape(joint_std) == (2,):
        return noise_rows(np.tile(np.repeat(joint_std, 3), 2), count, n, "joint_std_rad")
    return noise_rows(joint_std, count, n, "joint_std_rad")
