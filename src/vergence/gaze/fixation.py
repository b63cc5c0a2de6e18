"""Inverse kinematics of the eyes: the readings at which they fixate points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from vergence.arrays import Array
from vergence.geometry.camera import pinhole
from vergence.geometry.eye_motion import eye_motion
from vergence.geometry.head import HeadCalibration, MountedCamera
from vergence.geometry.kinematics import (
    Kinematics,
    least_readings,
    pan_tilt_along,
    turn_by_readings,
)
from vergence.geometry.projection import project_with_jacobians

_UNIT_LENS = pinhole(1, 1, 1.0)  # its pixels are x/z and y/z
_CONVERGED = 1e-8
"""Error of x/z and y/z, and step of a joint [rad], at convergence: one more step squares it."""


def solve_fixation(calibration: HeadCalibration, targets: Mapping[str, Array]) -> Array:
    """Compute the readings (..., r) [rad] that centre a point in each of some cameras.

    Gauss-Newton iteration to machine precision, with the joints' imperfections and with the cameras
    off their rotation centres. Eyes that share a joint minimise the sum of their squared errors.

    The targets are, by camera, points (..., 3) [m] in the base frame of its eye, to be centred on
    the principal point, so that the lens does not matter. Readings are NaN if they move no eye of
    these cameras, and for points that no posture centres: NaN, on the pan axis, or closer than the
    camera. Raises VergenceError if the head has no such camera.
    """
    kinematics = calibration.kinematics
    shape = np.broadcast_shapes(*(points.shape[:-1] for points in targets.values()))
    readings = np.full((*shape, len(kinematics.readings)), np.nan)
    by_camera = {name: kinematics.used(calibration.camera(name).eye) for name in targets}
    coupled = len(set().union(*by_camera.values())) < sum(map(len, by_camera.values()))
    for names in [list(targets)] if coupled else [[name] for name in targets]:
        used = sorted(set().union(*(by_camera[name] for name in names)))
        some = {name: np.broadcast_to(targets[name], (*shape, 3)) for name in names}
        readings[..., used] = _centre(calibration, some, used)
    return readings


def _centre(calibration: HeadCalibration, targets: Mapping[str, Array], used: list[int]) -> Array:
    """Compute the readings (..., u) of one eye, or of two that share a joint."""
    kinematics, points, cameras = calibration.kinematics, {}, {}
    usable, turns, maps = np.asarray(True), [], []
    for name, p in targets.items():
        here = np.isfinite(p).all(axis=-1) & (p[..., :2] != 0).any(axis=-1)
        usable = usable & here
        points[name] = np.where(here[..., None], p, [1.0, 0, 0])
        pan, tilt = pan_tilt_along(*np.moveaxis(points[name], -1, 0))
        turn = np.stack([0 * pan, tilt, pan], axis=-1)
        cameras[name] = replace(calibration.camera(name), intrinsics=_UNIT_LENS)
        chain = kinematics.chains[cameras[name].eye]
        turns.append(turn - chain.offset_rad @ chain.axes)
        maps.append(turn_by_readings(chain)[:, used])
    factors = kinematics.factors[used]  # steps are those of joints, also before a gear
    readings = np.zeros((*usable.shape, len(kinematics.readings)))
    readings[..., used] = least_readings(np.concatenate(maps), np.concatenate(turns, axis=-1))
    # Eyes that share a joint cannot both be centred: 0.1 of x/z and y/z is the most to accept.
    reached = _CONVERGED if 2 * len(targets) <= len(used) else 0.1
    settled, front = np.zeros(usable.shape, dtype=bool), usable
    for _ in range(20):  # most points need four steps
        found = [_off_centre(kinematics, cameras[name], readings, p) for name, p in points.items()]
        errors, jacobians, fronts = zip(*found, strict=True)
        error = np.concatenate(errors, axis=-1)
        J: Array = np.concatenate(jacobians, axis=-2)[..., used]
        step = (np.linalg.pinv(J) @ error[..., None])[..., 0]
        turn = np.clip(factors * step, -0.5, 0.5)  # [rad], as far as the projection is linear
        readings[..., used] -= turn / factors
        front = np.concatenate(fronts, axis=-1).all(axis=-1)
        settled = (np.abs(turn) < _CONVERGED).all(axis=-1)
        settled &= (np.abs(error) < reached).all(axis=-1)  # the error before this step
        if (settled | ~front).all():
            break
    return np.where((usable & front & settled)[..., None], readings[..., used], np.nan)


def _off_centre(
    kinematics: Kinematics, mounted: MountedCamera, readings: Array, p: Array
) -> tuple[Array, Array, np.ndarray]:
    """Project points in an eye's base to x/z and y/z (..., 2), with derivatives (..., 2, r).

    Both are zero for points behind the camera; the last result (..., 1) is whether they are before
    it. The camera has _UNIT_LENS.
    """
    eye = eye_motion(kinematics, mounted.eye, readings, errors=False)
    # The identity in place of T_rbase_lbase: the points are in this base already.
    found = project_with_jacobians(mounted, np.eye(4), eye.T_base_eye, p, parameters=False)
    error, by_pose = found.pixels, found.by_T_base_eye
    front = np.asarray(np.isfinite(error).all(axis=-1, keepdims=True))
    J = np.where(front[..., None], by_pose @ eye.by_readings(eye.by_moves), 0.0)
    return np.where(front, error, 0.0), J, front
