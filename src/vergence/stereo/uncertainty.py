"""Located points and their covariances: noise of pixels and joints, and the calibration's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array
from vergence.data.dataset import MAX_GAP_S
from vergence.data.timing import Timing, moved_readings
from vergence.errors import VergenceError
from vergence.geometry.head import Accuracy, HeadCalibration, reading_stds
from vergence.geometry.projection import (
    measured,
)
from vergence.stereo.linearised import (
    Linearised,
    by_head_parameters,
    linearised,
    matrix_products,
    pair_columns,
    pair_parameters,
    weighted_linearised,
)
from vergence.stereo.triangulation import (
    checked,
    chunks,
    of_part,
    pixel_variances,
    postures,
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
    joint_time_s: Array | None = None,
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
        joint_std_rad: noise of each reading, likewise; of measured poses the two numbers of
            rotation [rad] and translation [m]. None: as the calibration found it.
        joint_time_s: (N,) time stamps of the readings of one motion, at most 0.2 s apart; each is
            then moved to the moment that its image shows, by the head's time offset, along a
            polynomial through its neighbours. None: the eyes stood still.

    Raises:
        VergenceError: shapes do not fit, the head has no such camera, or left and right are
            exchanged.
    """
    if joint_time_s is not None:
        joints = _at_the_images(head, joints, joint_time_s)
    left, right, joints = checked(left, right, joints, len(head.kinematics.readings))
    known, n = _calibration(head, cameras), len(left)
    if known is None and pixel_std_px is None and joint_std_rad is None:
        points, status = triangulate_at(
            head, left=left, right=right, joints=joints, cameras=cameras
        )
        return LocatedPoints(points, np.full((n, 3, 3), np.nan), status, np.zeros((n, 3, 3)))
    accuracy = head.accuracy or Accuracy(method="paper")
    if pixel_std_px is None:
        pixel_std_px = accuracy.pixel_std_px or 0.0
    if joint_std_rad is None:
        joint_std_rad = stated_reading_stds(head, joints)
    points, status = np.empty((n, 3)), np.empty(n, dtype=int)
    covariance, shared = np.empty((n, 3, 3)), np.zeros((n, 3, 3))
    weights, pixel_stds = pixel_variances(pixel_std_px, n), _rows(pixel_std_px, n)
    for part in chunks(n):
        pixels = left[part], right[part]
        seen = weighted_linearised(
            head,
            pixels,
            postures(joints, part),
            cameras,
            of_part(weights, part),
            parameters=known is not None,
        )
        points[part], status[part] = seen.points.T, seen.status
        noise = [seen.by_pixels * pixel_stds[:, part], seen.by_readings]
        noise[1] = noise[1] * noise_of_readings(joint_std_rad, noise[1].shape[1], n)[:, part]
        covariance[part] = _squares(np.concatenate(noise, axis=1))
        if known is not None:
            shared[part] = _of_calibration(seen, known)
            covariance[part] += shared[part]
    return LocatedPoints(points, covariance, status, shared)


def stated_reading_stds(head: HeadCalibration, joints: Array) -> Array:
    """Return the stated noise of readings (r,) [rad], or of measured poses (2,) [rad], [m]."""
    if measured(joints):
        levels = head.accuracy.joint_std if head.accuracy else ()
        return np.resize(levels or (0.0,), 2)
    return reading_stds(head)


def _at_the_images(head: HeadCalibration, joints: Array, joint_time_s: Array) -> Array:
    """Return readings, or poses, at the moments of the images; VergenceError: see `locate`."""
    shape = (2, 4, 4) if measured(joints) else (len(head.kinematics.readings),)
    if joints.shape != (len(joint_time_s), *shape):
        raise VergenceError(
            f"Readings that have time stamps are one for each: found {joints.shape} readings and "
            f"{len(joint_time_s)} time stamps."
        )
    steps = np.diff(joint_time_s)
    if not np.isfinite(joint_time_s).all() or (steps < 0).any() or (steps > MAX_GAP_S).any():
        raise VergenceError(
            f"Time stamps of a motion increase by at most {MAX_GAP_S} s from reading to reading, "
            f"found {steps.min():.3g} to {steps.max():.3g} s; locate each motion by itself."
        )
    distinct, which = np.unique(joint_time_s, return_inverse=True)  # points of one image
    first = np.searchsorted(joint_time_s, distinct)
    timing = Timing(distinct, np.ones(len(distinct), dtype=int))
    move = partial(moved_readings, timing=timing, seconds=head.time_offset_s)
    if not measured(joints):
        return move(joints[first])[which]
    return np.stack([move(T) for T in np.moveaxis(joints[first], 1, 0)], axis=1)[which]


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
    pixel_std_px: ArrayLike = 0.0,
    joint_std_rad: ArrayLike = 0.0,
) -> tuple[Array, Array]:
    """Return the sum (3,) [m] of points times weights (N,), and its covariance (3, 3) [m^2].

    With weights 1/N an average, with 1 and -1 a difference. Errors of pixels are each point's own;
    those of readings are too, but are shared by all points where one posture serves all; and those
    of the calibration are always shared. Points that cannot be located must have weight zero, or
    the result is NaN. Other arguments and errors are those of `locate`.
    """
    left, right, joints = checked(left, right, joints, len(head.kinematics.readings))
    factor, n = _factor(head, cameras), len(left)
    pixel_stds = _rows(pixel_std_px, n)
    weights_px, one = pixel_variances(pixel_std_px, n), joints.ndim in (1, 3)
    total, covariance = np.zeros(3), np.zeros((3, 3))
    by_readings, by_head = np.zeros((3, 1)), np.zeros((3, len(factor)))
    for part in chunks(n):
        pixels = left[part], right[part]
        seen = weighted_linearised(
            head,
            pixels,
            postures(joints, part),
            cameras,
            of_part(weights_px, part),
            parameters=True,
        )
        own = np.where(weights[part] == 0, 0.0, weights[part])
        points, *changes = (
            np.where(own == 0, 0.0, each) * own
            for each in (
                seen.points,
                seen.by_pixels,
                seen.by_readings,
                by_head_parameters(head, cameras, seen),
            )
        )
        total += points.sum(axis=-1)
        covariance += _squares(changes[0] * pixel_stds[:, part]).sum(axis=0)
        noisy = changes[1] * noise_of_readings(joint_std_rad, changes[1].shape[1], n)[:, part]
        if one:
            by_readings = by_readings + noisy.sum(axis=-1)
        else:
            covariance += _squares(noisy).sum(axis=0)
        by_head = by_head + changes[2].sum(axis=-1)
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
    (r,) [rad] of the one posture that serves all points. Other arguments and errors are those of
    `locate`.
    """
    seen = linearised(head, left=left, right=right, joints=joints, cameras=cameras)
    names, n = pair_parameters(head, cameras), seen.points.shape[1]
    by_head = by_head_parameters(head, cameras, seen)
    nothing = np.zeros((3, n))
    rows = [by_head[:, names.index(k)] if k in names else nothing for k in parameters]
    own = np.concatenate([np.stack(rows, axis=1), seen.by_readings], axis=1).transpose(2, 0, 1)
    both = _squares(seen.by_pixels * _rows(pixel_std_px, n)) + own @ covariance @ own.swapaxes(1, 2)
    of_head, P = own[..., : len(rows)], len(rows)
    shared = of_head @ covariance[:P, :P] @ of_head.swapaxes(1, 2)
    return LocatedPoints(seen.points.T, both, seen.status, shared)


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
    n, weights = len(left[0]), pixel_variances(pixel_std_px, len(left[0]))
    pixel_stds, points, changes = _rows(pixel_std_px, n), [], []
    for own in zip(left, right, strict=True):
        u_l, u_r, readings = checked(*own, joints, len(head.kinematics.readings))
        readings = readings[None] if readings.ndim in (1, 3) else readings
        seen = weighted_linearised(head, (u_l, u_r), readings, cameras, weights, parameters=False)
        points.append(seen.points.T)
        changes += [seen.by_pixels * pixel_stds, seen.by_readings]
    shared = changes.pop(1) - changes.pop()
    shared = shared * noise_of_readings(joint_std_rad, shared.shape[1], n)
    return *points, _squares(np.concatenate([*changes, shared], axis=1))


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
    if head.accuracy is None or not head.accuracy.parameters:
        raise VergenceError(
            "This calibration states no covariance; `vergence calibrate --method bundle` makes "
            "one that does."
        )
    found = locate(head, left=left, right=right, joints=joints, cameras=cameras)
    return np.where(np.isnan(found.covariance), np.nan, found.calibration_covariance)


@dataclass(frozen=True, eq=False)
class _Calibration:
    """Of a covariance of a head what the pixels of two cameras depend on."""

    own: tuple[np.ndarray, np.ndarray]
    """By camera which of its columns are known to be uncertain, (p_l,) and (p_r,)."""
    by_left: Array
    """(p_l + p_r, p_l) covariance of both cameras' with the left one's."""
    by_right: Array
    """(p_r, p_r)."""


@lru_cache(maxsize=64)
def _calibration(head: HeadCalibration, cameras: tuple[str, str] | None) -> _Calibration | None:
    """Return the covariance that the pixels of a pair depend on; None where none is stated."""
    if head.accuracy is None or not head.accuracy.parameters:
        return None
    rows = {name: k for k, name in enumerate(head.accuracy.parameters)}
    names, (left, right) = pair_parameters(head, cameras), pair_columns(head, cameras)
    of_base = np.array([name.startswith("T_rbase_lbase.") for name in names])
    stated = np.array([name in rows for name in names])
    own = np.flatnonzero((stated & ~of_base)[left]), np.flatnonzero(stated[right])
    order = [rows[names[k]] for k in (*left[own[0]], *right[own[1]])]
    C, n = head.accuracy.covariance[np.ix_(order, order)], len(own[0])
    return _Calibration(own, np.ascontiguousarray(C[:, :n]), np.ascontiguousarray(C[n:, n:]))


def _of_calibration(seen: Linearised, known: _Calibration) -> Array:
    """Return the covariances (n, 3, 3) that the calibration's covariance makes.

    First that of the four pixel coordinates, of which a point is made: it takes half the time.
    """
    left, right = (rows[:, own] for rows, own in zip(seen.pixels_by_head, known.own, strict=True))
    by_left, by_right = known.by_left @ left, known.by_right @ right
    split = left.shape[1]
    pixels = np.empty((4, 4, left.shape[2]))
    for i in (0, 1):
        for j in (0, 1):
            pixels[i, j] = np.add.reduce(left[i] * by_left[j, :split])
            pixels[2 + i, 2 + j] = np.add.reduce(right[i] * by_right[j])
            pixels[i, 2 + j] = pixels[2 + j, i] = np.add.reduce(right[j] * by_left[i, split:])
    half = matrix_products(seen.by_pixels, pixels)
    return _products(half, seen.by_pixels)


@lru_cache(maxsize=64)
def _factor(head: HeadCalibration, cameras: tuple[str, str] | None) -> Array:
    """Return F (P, q) with F F^T the calibration's covariance of `pair_parameters`."""
    accuracy, names = head.accuracy, pair_parameters(head, cameras)
    if accuracy is None or not accuracy.parameters:
        return np.zeros((len(names), 0))
    rows = {name: k for k, name in enumerate(accuracy.parameters)}
    stated = np.array([name in rows for name in names])
    order = [rows[name] for name in names if name in rows]
    C = accuracy.covariance[np.ix_(order, order)]
    std = np.sqrt(np.diag(C))
    values, vectors = np.linalg.eigh(C / std / std[:, None])
    factor = np.zeros((len(names), len(order)))
    factor[stated] = std[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    return factor


def _squares(changes: Array) -> Array:
    """Return covariances (n, 3, 3) of changes (3, K, n) by K independent standard deviations."""
    return _products(changes, changes)


def _products(left: Array, right: Array) -> Array:
    """Return the symmetric products (n, 3, 3) of (3, K, n) and (3, K, n) over K."""
    found = np.empty((left.shape[-1], 3, 3))
    for i in range(3):
        for j in range(i, 3):
            found[:, i, j] = found[:, j, i] = np.add.reduce(left[i] * right[j])
    return found


def _rows(std: ArrayLike, n: int) -> Array:
    """Return standard deviations (4, n) of pixels, from a number, (4,) or (n, 4)."""
    return np.broadcast_to(np.asarray(std, dtype=float), (n, 4)).T


def noise_of_readings(joint_std: ArrayLike, count: int, n: int) -> Array:
    """Return the standard deviations (r, n) of readings; of poses from rotation, translation."""
    std = np.asarray(joint_std, dtype=float)
    if std.shape == (2,) and count == 12:
        std = np.tile(np.repeat(np.broadcast_to(std, (2,)), 3), 2)
    return np.broadcast_to(std, (n, count)).T
