"""Foveation: the wide pixel of a point that falls on the fovea (Sec. III, Eqs. 18-19).

The paper's foveal camera is `narrow` here, its peripheral one `wide`, and R_fp, t_fp are
`head.T_narrow_wide`, the pose of the wide camera in the narrow one. The paper subtracts principal
points and omits distortion; pixels here include both. The formulas use the inverse depth, so that
an infinite depth needs no special case. See docs/equations.md and docs/conventions.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.gaze.fixation import solve_fixation
from vergence.gaze.state import EyeCameras, default_roles
from vergence.geometry.camera import project, unproject
from vergence.geometry.head import HeadCalibration, T_narrow_wide
from vergence.geometry.kinematics import Side
from vergence.geometry.se3 import checked_points, inverse, transform


def ideal_wide_pixel(
    calibration: HeadCalibration,
    eye: Side,
    depth_m: ArrayLike,
    *,
    cameras: EyeCameras | None = None,
) -> Array:
    """Eqs. 18-19: project points on the narrow camera's axis to wide pixels (..., 2).

    A point at such a wide pixel falls on the principal point of the narrow image, whatever its
    intrinsic parameters. The depths (...) [m] are along the narrow camera's axis; infinity gives
    the limit. None: the eye's cameras by their default names. Raises VergenceError if a depth is
    not above 0, or the eye does not have both cameras.
    """
    names = cameras or EyeCameras(wide=f"{eye}_wide", narrow=f"{eye}_narrow")
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
    wide, narrow = (calibration.camera(f"{eye}_{lens}").intrinsics for lens in ("wide", "narrow"))
    ray = unproject(wide, ideal_wide_pixel(calibration, eye, believed_m))
    depth = np.broadcast_to(np.asarray(depth_m, dtype=float), ray.shape[:-1])[..., None]
    T = T_narrow_wide(calibration, eye)
    seen = project(narrow, ray @ T[:3, :3].T + T[:3, 3] / depth)  # scaled by 1 / depth
    return seen - narrow.matrix[:2, 2]


def gaze_angles(
    calibration: HeadCalibration, points_lbase: Array, *, cameras: Sequence[str] | None = None
) -> Array:
    """Compute the readings (..., r) [rad] that centre points in both eyes: version and vergence.

    Points (..., 3) [m] are in the left eye's base frame. They are centred on the principal points
    of the named cameras, at most one of each eye; None: the narrow ones, or an eye's main one. See
    `solve_fixation` for NaN. Raises VergenceError if the head has no such camera, or points are not
    (..., 3).
    """
    points_lbase = checked_points(points_lbase)
    if cameras is None:
        cameras = [roles.narrow for roles in default_roles(calibration).values()]
    if isinstance(cameras, str) or not len(cameras):
        raise VergenceError(
            f"cameras are names of one or more, such as {[*calibration.cameras][:1]}; found "
            f"{cameras!r:.80}."
        )
    targets = {}
    for name in cameras:
        right = calibration.camera(name).eye == "right"
        targets[name] = (
            transform(calibration.T_rbase_lbase, points_lbase) if right else points_lbase
        )
    return solve_fixation(calibration, targets)
