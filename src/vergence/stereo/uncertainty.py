"""Located points and their covariances: noise of pixels and joints, and the calibration's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array, floats, single_blas_thread
from vergence.data.dataset import MAX_GAP_S
from vergence.data.timing import Timing, moved_readings
from vergence.errors import VergenceError
from vergence.geometry.eye_motion import check_joints, measured
from vergence.geometry.head import (
    HeadCalibration,
    pair_names,
    stated_covariance,
    states_noise,
)
from vergence.stereo.calibration_covariance import (
    covariance_of_calibration,
    pair_covariance,
)
from vergence.stereo.linearised import (
    by_head_parameters,
    by_noise,
    covariances_of,
    linearised_part,
    pair_parameters,
)
from vergence.stereo.measurement_noise import (
    given_or_stated,
    measurement_noise,
    noise_of_part,
    pixel_noise,
    pixel_variances,
)
from vergence.stereo.triangulation import Part, checked_arguments, in_chunks, triangulate_at


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
    cameras = pair_names(head, cameras)
    if joint_time_s is not None:
        joints = _at_the_images(head, joints, joint_time_s)
    left, right, joints = checked_arguments(left, right, joints, head.kinematics)
    known, n = pair_covariance(head, cameras), len(left)
    if not states_noise(head) and pixel_std_px is None and joint_std_rad is None:
        points, status = triangulate_at(
            head, left=left, right=right, joints=joints, cameras=cameras
        )
        return LocatedPoints(points, np.full((n, 3, 3), np.nan), status, np.zeros((n, 3, 3)))
    pixel_std_px, joint_std_rad = given_or_stated(
        head, joints, pixel_std_px, joint_std_rad, cameras
    )
    noise = measurement_noise(head, joints, n, pixel_std_px, joint_std_rad)
    given = head, (left, right), joints, cameras, pixel_variances(pixel_std_px, n)

    def find(part: Part) -> tuple[Array, ...]:
        seen = linearised_part(*given, part=part, parameters=known is not None)
        by_pixels, by_readings = by_noise(seen, noise, part)
        covariance = covariances_of(by_pixels) + covariances_of(by_readings)
        if known is None:
            return seen.points, covariance, seen.status, np.zeros_like(covariance)
        shared = covariance_of_calibration(seen, known)
        return seen.points, covariance + shared, seen.status, shared

    return LocatedPoints(*in_chunks(n, find))


def _at_the_images(head: HeadCalibration, joints: ArrayLike, joint_time_s: ArrayLike) -> Array:
    """Return readings, or poses, at the moments of the images; VergenceError: see `locate`."""
    joints, joint_time_s = floats("joints", joints), floats("joint_time_s", joint_time_s)
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


@single_blas_thread()
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

    def find(part: Part) -> tuple[Array, ...]:
        seen = linearised_part(head, (left, right), joints, cameras, variances, part=part)
        by_head = by_head_parameters(head, cameras, seen)
        own, rest = np.zeros((*seen.status.shape, 3, len(covariance))), by_head[..., beside]
        own[..., mine], own[..., P:] = by_head[..., theirs], seen.by_readings
        of_rest = rest @ C @ rest.swapaxes(-1, -2)
        of_head = own[..., :P] @ covariance[:P, :P] @ own[..., :P].swapaxes(-1, -2)
        whole = covariances_of(seen.by_pixels * noise_of_part(noise, part)[..., None, :])
        whole += own @ covariance @ own.swapaxes(-1, -2)
        return seen.points, whole + of_rest, seen.status, of_head + of_rest

    return LocatedPoints(*in_chunks(n, find))
