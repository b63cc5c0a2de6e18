"""The readings at which eyes fixate points: the inverse of their kinematics."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vergence.arrays import Array
from vergence.geometry.eye_motion import eye_linearised
from vergence.geometry.head import HeadCalibration
from vergence.geometry.se3 import cross

_NEWTON_STEPS = 20
_CONVERGED = 1e-8  # of x/z and y/z, and of a reading: the next step of Newton's method squares it
_COMPROMISE = 0.1  # of x/z and y/z, where eyes that share a joint cannot both be centred


def readings_to(
    calibration: HeadCalibration, targets: Mapping[str, Array], *, limits_rad: Array | None = None
) -> Array:
    """Return the readings (..., r) [rad] that centre a point in each of some cameras.

    Gauss-Newton on all axes at once, to machine precision, with the joints' imperfections and with
    the cameras off their rotation centres. Where eyes share a joint and cannot both be centred, the
    sum of squares is least.

    Args:
        calibration: of the head.
        targets: by camera, points (..., 3) [m] in the base frame of its eye, to be centred on the
            principal point, so that the lens does not matter.
        limits_rad: (r,) the largest readings to either side, within which the points are centred
            as nearly as may be; None: the joints turn as far as it takes.

    Returns:
        Readings in the order of kinematics.readings; NaN for those that move no eye of these
        cameras, and where no posture centres the points: one is NaN, on the pan axis, or closer
        than the camera.

    Raises:
        VergenceError: the head has no such camera.
    """
    kinematics, shape = (
        calibration.kinematics,
        np.broadcast_shapes(*(points.shape[:-1] for points in targets.values())),
    )
    r = len(kinematics.readings)
    limits = np.full(r, np.inf) if limits_rad is None else limits_rad
    readings = np.full((*shape, r), np.nan)
    by_eye = {name: kinematics.used(calibration.camera(name).eye) for name in targets}
    coupled = len(set().union(*by_eye.values())) < sum(map(len, by_eye.values()))
    for names in [list(targets)] if coupled else [[name] for name in targets]:
        used = sorted(set().union(*(by_eye[name] for name in names)))
        some = {name: np.broadcast_to(targets[name], (*shape, 3)) for name in names}
        readings[..., used] = _centre(calibration, some, used, limits[used])
    return readings


def _centre(
    calibration: HeadCalibration,
    targets: Mapping[str, Array],
    used: list[int],
    limits: Array,
) -> Array:
    """Return the readings (..., u) that centre the points in the cameras of one or both eyes."""
    kinematics, points = calibration.kinematics, {}
    usable, turns, maps = np.asarray(True), [], []
    for name, p in targets.items():
        here = np.isfinite(p).all(axis=-1) & (p[..., :2] != 0).any(axis=-1)
        usable = usable & here
        points[name] = np.where(here[..., None], p, [1.0, 0, 0])
        x, y, z = np.moveaxis(points[name], -1, 0)
        turn = np.stack([0 * x, -np.arctan2(z, np.hypot(x, y)), np.arctan2(y, x)], axis=-1)
        chain = kinematics.chains[calibration.camera(name).eye]
        turns.append(turn - chain.offset_rad @ chain.axes)
        maps.append((chain.axes.T @ chain.mixing)[:, used])
    readings = np.zeros((*usable.shape, len(kinematics.readings)))
    start = np.concatenate(turns, axis=-1) @ np.linalg.pinv(np.concatenate(maps)).T
    readings[..., used] = start
    reached = _CONVERGED if 2 * len(targets) <= len(used) else _COMPROMISE
    step = error = np.full(usable.shape, np.inf)[..., None]
    front = usable
    for _ in range(_NEWTON_STEPS):
        found = [_off_centre(calibration, name, readings, p) for name, p in points.items()]
        errors, jacobians, fronts = zip(*found, strict=True)
        error, J = np.concatenate(errors, axis=-1), np.concatenate(jacobians, axis=-2)
        step = _gauss_newton(J[..., used], error)
        now = readings[..., used]
        held = (np.abs(now) >= limits) & (now * step < 0)
        if held.any():  # joints that rest against a limit leave the others to do the best
            free = np.where(held[..., None, :], 0.0, J[..., used])
            step = np.where(held, 0.0, _gauss_newton(free, error))
        readings[..., used] = np.clip(now - np.clip(step, -0.5, 0.5), -limits, limits)
        front = np.concatenate(fronts, axis=-1).all(axis=-1)
        if ((np.abs(step) < _CONVERGED).all(axis=-1) | ~front).all():
            break
    settled = (np.abs(step) < _CONVERGED).all(axis=-1) & (np.abs(error) < reached).all(axis=-1)
    good = usable & front & (settled | np.isfinite(limits).any())
    return np.where(good[..., None], readings[..., used], np.nan)


def _gauss_newton(J: Array, error: Array) -> Array:
    return (np.linalg.pinv(J) @ error[..., None])[..., 0]


def _off_centre(
    calibration: HeadCalibration, name: str, readings: Array, p: Array
) -> tuple[Array, Array, np.ndarray]:
    """Return x/z and y/z (..., 2) of points in a camera, and derivatives (..., 2, r) by readings.

    Both are zero for points that are not in front of it, which the last result (..., 1) says.
    """
    mounted = calibration.camera(name)
    R_eye_cam, t_eye_cam = mounted.T_eye_cam[:3, :3], mounted.T_eye_cam[:3, 3]
    T, _, by_reading = eye_linearised(calibration.kinematics, mounted.eye, readings)
    arm = p - T[..., :3, 3]
    R_base_cam = T[..., :3, :3] @ R_eye_cam
    in_cam = (arm[..., None, :] @ R_base_cam)[..., 0, :] - t_eye_cam @ R_eye_cam
    front = in_cam[..., 2:] > 0
    depth = np.where(front, in_cam[..., 2:], 1.0)
    error = np.where(front, in_cam[..., :2] / depth, 0.0)
    # An increment of the eye's pose moves the point the other way.
    turns, shifts = np.split(np.swapaxes(by_reading, -1, -2), 2, axis=-1)
    moves = -(cross(turns, arm[..., None, :]) + shifts) @ R_base_cam
    J = np.swapaxes(moves[..., :2] - moves[..., 2:] * error[..., None, :], -1, -2)
    return error, np.where(front[..., None], J / depth[..., None], 0.0), front
