"""Located points and their covariances: noise of pixels and joints, and the calibration's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array, floats, single_blas_thread
from vergence.data.dataset import MAX_GAP_S
from vergence.data.timing import Timing, moved_readings
from vergence.errors import VergenceError, counted
from vergence.geometry.batches import joined
from vergence.geometry.eye_motion import check_joints, measured
from vergence.geometry.head import HeadCalibration, stated_covariance, states_noise
from vergence.stereo.linearised import (
    by_head_parameters,
    by_noise,
    covariance_of_calibration,
    covariances_of,
    linearised,
    pair_covariance,
    pair_parameters,
)
from vergence.stereo.triangulation import (
    CHUNK,
    SightingArguments,
    Sightings,
    in_chunks,
    sightings,
    triangulated,
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


@single_blas_thread()
def locate(
    head: HeadCalibration,
    *,
    left: Array,
    right: Array,
    joints: Array,
    cameras: tuple[str, str] | None = None,
    pixel_std_px: ArrayLike | None = None,
    reading_std: ArrayLike | None = None,
) -> LocatedPoints:
    """Locate points that both eyes see, with their covariances.

    Args:
        head: with or without its accuracy.
        left: (N, 2) pixels in the left camera, or (2,) of one point; distorted; NaN: not seen.
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
        reading_std: noise of each reading: a number, (r,) or (N, r); of measured poses the two
            numbers of rotation [rad] and translation [m]. None: as the calibration found it.

    Raises:
        VergenceError: shapes do not fit, readings are not in radians, poses are not rigid, noise is
            negative, the head has no such camera, or left and right are exchanged.
    """
    seen = sightings(
        head,
        left=left,
        right=right,
        joints=joints,
        cameras=cameras,
        pixel_std_px=pixel_std_px,
        reading_std=reading_std,
    )
    known, noisy = pair_covariance(head, seen.cameras), states_noise(head)
    noisy = noisy or pixel_std_px is not None or reading_std is not None

    def find(seen: Sightings) -> tuple[Array, ...]:
        if not noisy:
            points, status = triangulated(seen)
            nothing = np.zeros((*status.shape, 3, 3))
            return points, nothing * np.nan, status, nothing
        located = linearised(seen, parameters=bool(known))
        covariance = covariances_of(joined(*by_noise(located, seen)))
        if not known:
            return located.points, covariance, located.status, np.zeros_like(covariance)
        shared = covariance_of_calibration(located, known)
        return located.points, covariance + shared, located.status, shared

    return LocatedPoints(*in_chunks(seen, find))


def joints_at_images(head: HeadCalibration, joints: ArrayLike, joint_time_s: ArrayLike) -> Array:
    """Move readings (N, r), or poses (N, 2, 4, 4), of one motion to the moments of its images.

    Each is moved by the head's time offset along a polynomial through its neighbours. The time
    stamps (N,) [s] increase by at most 0.2 s. VergenceError if they do not, or the joints are not
    those of the head.
    """
    joints, joint_time_s = floats("joints", joints), floats("joint_time_s", joint_time_s)
    shape = (2, 4, 4) if measured(joints) else (len(head.kinematics.readings),)
    if joint_time_s.ndim != 1 or joints.shape != (len(joint_time_s), *shape):
        raise VergenceError(
            f"Readings that have time stamps are one for each: found readings of shape "
            f"{joints.shape} and time stamps of shape {joint_time_s.shape}."
        )
    check_joints(head.kinematics, joints)
    steps = np.diff(joint_time_s)
    if not (np.isfinite(joint_time_s).all() and (steps >= 0).all() and (steps <= MAX_GAP_S).all()):
        raise VergenceError(
            f"Time stamps of a motion are finite and increase by at most {MAX_GAP_S} s from "
            f"reading to reading; locate each motion by itself. Found {joint_time_s!r:.80}."
        )
    distinct, which = np.unique(joint_time_s, return_inverse=True)  # points of one image
    first = np.searchsorted(joint_time_s, distinct)
    timing = Timing(distinct, np.ones(len(distinct), dtype=int))
    return moved_readings(joints[first], timing, head.time_offset_s)[which]


@single_blas_thread()
def locate_jointly(
    head: HeadCalibration,
    *,
    estimate: tuple[Sequence[str], Array],
    **arguments: Unpack[SightingArguments],
) -> LocatedPoints:
    """Locate points with a head and readings that were estimated together.

    The estimate is names of parameters of the head, and the covariance (P + r, P + r) of these and
    of the r readings (r,) [rad] of the one posture that serves all points. The covariance that the
    head states of its other parameters is added, as if these were independent. Other arguments and
    errors are those of `locate`.
    """
    seen = sightings(head, **arguments)
    parameters, covariance = estimate
    names, P = pair_parameters(head, seen.cameras), len(parameters)
    mine = [k for k, name in enumerate(parameters) if name in names]
    theirs = [names.index(parameters[k]) for k in mine]
    others = np.setdiff1d(np.arange(len(names)), theirs)
    stated, C = stated_covariance(head, [names[k] for k in others])

    def find(seen: Sightings) -> tuple[Array, ...]:
        located = linearised(seen)
        by_head = by_head_parameters(located, seen)
        own = np.zeros((*located.status.shape, 3, len(covariance)))
        own[..., mine], own[..., P:] = by_head[..., theirs], located.by_readings
        of_pixels, _ = by_noise(located, seen)
        of_others = _sandwich(by_head[..., others[stated]], C)
        whole = covariances_of(of_pixels) + _sandwich(own, covariance) + of_others
        of_head = _sandwich(own[..., :P], covariance[:P, :P])
        return located.points, whole, located.status, of_head + of_others

    return LocatedPoints(*in_chunks(seen, find))


def _sandwich(J: Array, C: Array) -> Array:
    return J @ C @ np.swapaxes(J, -1, -2)


@single_blas_thread()
def combination(
    head: HeadCalibration, *, weights: Array, **arguments: Unpack[SightingArguments]
) -> tuple[Array, Array]:
    """Sum points times weights (N,), to (3,) [m], with the covariance (3, 3) [m^2] of the sum.

    With weights 1/N an average, with 1 and -1 a difference. Errors of pixels are each point's own;
    those of readings are too, but are shared by all points where one posture serves all; and those
    of the calibration are always shared. Points that cannot be located must have weight zero, or
    the result is NaN. Other arguments and errors are those of `locate`; noise that neither the
    caller nor the calibration states is taken as none. VergenceError also if there are not as many
    weights as points, or one is not finite.
    """
    seen = sightings(head, **arguments)
    n, weights = len(seen.left), floats("weights", weights)
    if weights.shape != (n,) or not np.isfinite(weights).all():
        raise VergenceError(
            f"A combination of {counted(n, 'point')} has a finite weight for each, 0 for points "
            f"that do not count; found an array of shape {weights.shape}: {weights!r:.80}."
        )
    known = pair_covariance(head, seen.cameras)
    total, covariance = np.zeros(3), np.zeros((3, 3))
    by_readings = np.zeros((3, seen.reading_std.shape[-1]))
    by_head = np.zeros((3, len(known[0]) if known else 0))
    counting = np.flatnonzero(weights)
    for start in range(0, len(counting), CHUNK):
        part = counting[start : start + CHUNK]
        some, own = seen.take(part), weights[part][:, None, None]
        located = linearised(some, parameters=bool(known))
        by_pixels, by_reading = (each * own for each in by_noise(located, some))
        total += weights[part] @ located.points
        covariance += covariances_of(by_pixels).sum(axis=0)
        if seen.one_posture:
            by_readings = by_readings + by_reading.sum(axis=0)
        else:
            covariance += covariances_of(by_reading).sum(axis=0)
        if known:
            by_head = by_head + (by_head_parameters(located, some) * own).sum(axis=0)
    if known:
        covariance += _sandwich(by_head, known[0])
    return total, covariance + by_readings @ by_readings.T


def depth_error(
    depth_m: ArrayLike, baseline_m: ArrayLike, focal_px: ArrayLike, disparity_error_px: ArrayLike
) -> Array:
    """Compute the depth error (...) [m], from the camera centres, by one of disparity (Eq. 20).

    Eqs. 20 and 21 hold for two parallel cameras, on the optical axis; `locate` for all others.
    """
    depth, baseline, focal = (np.asarray(a, float) for a in (depth_m, baseline_m, focal_px))
    return depth**2 / (baseline * focal) * np.asarray(disparity_error_px, float)


def disparity_error(focal_px: ArrayLike, orientation_error_rad: ArrayLike) -> Array:
    """Compute the error (...) [px] in disparity by a wrong angle between the cameras (Eq. 21)."""
    return np.asarray(focal_px, float) * np.tan(np.asarray(orientation_error_rad, float))
