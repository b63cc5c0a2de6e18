"""Foveation (Sec. III, Eqs. 18-19), and the readings at which the eyes fixate points.

The paper's foveal camera is `narrow` here, its peripheral one `wide`, and R_fp, t_fp are
`head.wide_pose_in_narrow`. The paper subtracts principal points and omits distortion; pixels here
include both. See docs/equations.md and docs/conventions.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.gaze.state import EyeCameras, GazeSettings, default_roles
from vergence.geometry.camera import pinhole, project, unproject
from vergence.geometry.eye_motion import eye_motion
from vergence.geometry.head import HeadCalibration, MountedCamera, wide_pose_in_narrow
from vergence.geometry.kinematics import (
    Kinematics,
    Side,
    least_readings,
    pan_tilt_along,
    turn_by_readings,
)
from vergence.geometry.projection import project_point, project_with_jacobians
from vergence.geometry.se3 import checked_points, inverse, transform


def ideal_wide_pixel(
    calibration: HeadCalibration,
    eye: Side,
    depth_m: ArrayLike,
    *,
    cameras: EyeCameras | None = None,
) -> Array:
    """Eqs. 18-19: project points on the narrow camera's axis to wide pixels (..., 2).

    The depths (...) [m] are along the narrow camera's axis and may be infinite. None: the eye's
    cameras by their default roles. Raises VergenceError if a depth is not above 0.
    """
    names = cameras or default_roles(calibration)[eye]
    wide, narrow = calibration.camera(names.wide), calibration.camera(names.narrow)
    depth = np.asarray(depth_m, dtype=float)
    wrong = ~(depth > 0)
    if wrong.any():
        raise VergenceError(
            f"A depth must be above 0 m, infinity included; found {depth[wrong].flat[0]:g} m."
        )
    # A point of the axis is z e_3 in the narrow camera and z r - R_fp^T t_fp in the wide one, with
    # r the third column of R_fp^T. Division by z leaves its projection and admits 1 / z = 0.
    T_wide_narrow = inverse(inverse(narrow.T_eye_cam) @ wide.T_eye_cam)
    points = T_wide_narrow[:3, 2] + T_wide_narrow[:3, 3] / depth[..., None]
    return project(wide.intrinsics, points)


def foveal_miss(
    calibration: HeadCalibration, eye: Side, depth_m: ArrayLike, believed_m: ArrayLike
) -> Array:
    """Compute the offset (..., 2) [px] from the fovea's principal point by a wrong depth.

    The point is at the wide pixel of Eqs. 18-19 for the believed depth (...) [m] along the narrow
    camera's axis; its true depth (...) [m] is along the wide camera's axis.
    """
    roles = default_roles(calibration)[eye]
    wide, narrow = (calibration.camera(name).intrinsics for name in (roles.wide, roles.narrow))
    ray = unproject(wide, ideal_wide_pixel(calibration, eye, believed_m))
    depth = np.broadcast_to(np.asarray(depth_m, dtype=float), ray.shape[:-1])[..., None]
    T = wide_pose_in_narrow(calibration, eye)
    seen = project(narrow, ray @ T[:3, :3].T + T[:3, 3] / depth)  # scaled by 1 / depth
    return seen - narrow.matrix[:2, 2]


def gaze_angles(
    calibration: HeadCalibration, points_lbase: Array, *, cameras: Sequence[str] | None = None
) -> Array:
    """Compute the readings (..., r) [rad] that centre points in both eyes: version and vergence.

    Points (..., 3) [m] are in the left eye's base frame. They are centred on the principal points
    of the named cameras, at most one of each eye; None: the narrow ones, or an eye's main one. See
    `solve_fixation` for NaN. VergenceError for unknown cameras, or points that are not (..., 3).
    """
    points_lbase = checked_points(points_lbase)
    if cameras is None:
        cameras = [roles.narrow for roles in default_roles(calibration).values()]
    points = {
        "left": points_lbase,
        "right": transform(calibration.T_rbase_lbase, points_lbase),
    }
    targets = {name: points[calibration.camera(name).eye] for name in cameras}
    return solve_fixation(calibration, targets)


def best_pixels(settings: GazeSettings, points_lbase: Array) -> tuple[Array, Array]:
    """Compute the readings (..., r) [rad] that centre points (..., 3) [m], and the pixels then.

    The pixels (..., E, 2) are those in the narrow or only camera of each of the E eyes in use.
    """
    head, names = settings.calibration, settings.narrow
    readings = gaze_angles(head, points_lbase, cameras=names)
    pixels = [project_point(head, name, readings, points_lbase) for name in names]
    return readings, np.stack(pixels, axis=-2)


_UNIT_LENS = pinhole(1, 1, 1.0)  # its pixels are x/z and y/z
_CONVERGED = 1e-8
"""Error of x/z and y/z, and step of a joint [rad], at convergence: one more step squares it."""


def solve_fixation(calibration: HeadCalibration, targets: Mapping[str, Array]) -> Array:
    """Compute the readings (..., r) [rad] that centre a point in each of some cameras.

    The targets are, by camera, points (..., 3) [m] in the base frame of its eye, to be centred on
    the principal point by Gauss-Newton iteration. Eyes that share a joint minimise the sum of their
    squared errors. Readings are NaN if they move no eye of these cameras, and for points that not
    all of the eyes can centre. Raises VergenceError if the head has no such camera.
    """
    kinematics, points, cameras = calibration.kinematics, {}, {}
    used = sorted({r for name in targets for r in kinematics.used(calibration.camera(name).eye)})
    shape = np.broadcast_shapes(*(points.shape[:-1] for points in targets.values()))
    usable, turns, maps = np.asarray(True), [], []
    for name in targets:
        p = np.broadcast_to(targets[name], (*shape, 3))
        here = np.isfinite(p).all(axis=-1) & (p[..., :2] != 0).any(axis=-1)
        usable = usable & here
        points[name] = np.where(here[..., None], p, [1.0, 0, 0])
        pan, tilt = pan_tilt_along(*np.moveaxis(points[name], -1, 0))
        turn = np.stack([0 * pan, tilt, pan], axis=-1)
        cameras[name] = replace(calibration.camera(name), intrinsics=_UNIT_LENS)
        chain = kinematics.chains[cameras[name].eye]
        turns.append(turn - chain.offset_rad @ chain.axes)
        maps.append(turn_by_readings(chain)[:, used])
    factors = kinematics.gear_ratios[used]  # steps are those of joints, also before a gear
    readings = np.zeros((*usable.shape, len(kinematics.readings)))
    readings[..., used] = least_readings(np.concatenate(maps), np.concatenate(turns, axis=-1))
    # Eyes that share a joint cannot both be centred: 0.5 of x/z and y/z, the edge of a usual image,
    # is the most to accept.
    reached = _CONVERGED if 2 * len(targets) <= len(used) else 0.5
    settled, front = np.zeros(usable.shape, dtype=bool), usable
    for _ in range(20):  # most points need four steps
        seen = [_off_centre(kinematics, cameras[name], readings, p) for name, p in points.items()]
        errors, jacobians, fronts = zip(*seen, strict=True)
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
    found = np.full(readings.shape, np.nan)
    found[..., used] = np.where((usable & front & settled)[..., None], readings[..., used], np.nan)
    return found


def _off_centre(
    kinematics: Kinematics, mounted: MountedCamera, readings: Array, p: Array
) -> tuple[Array, Array, np.ndarray]:
    """Project points in an eye's base to x/z and y/z (..., 2), with derivatives (..., 2, r).

    Both are zero for points behind the camera; the last result (..., 1) is whether they are ahead.
    """
    eye = eye_motion(kinematics, mounted.eye, readings, errors=False)
    # The identity in place of T_rbase_lbase: the points are in this base already.
    found = project_with_jacobians(mounted, np.eye(4), eye.T_base_eye, p, parameters=False)
    error, by_pose = found.pixels, found.by_T_base_eye
    front = np.asarray(np.isfinite(error).all(axis=-1, keepdims=True))
    J = np.where(front[..., None], by_pose @ eye.by_readings(eye.by_moves), 0.0)
    return np.where(front, error, 0.0), J, front
