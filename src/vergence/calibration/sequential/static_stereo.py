"""The constant pose between two cameras that see the same pattern (Sec. II-A, and R_fp, t_fp)."""

from __future__ import annotations

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.calibration.sequential.intrinsics import (
    CRITERIA,
    repeatable,
    seen_corners,
    target_poses,
)
from vergence.calibration.sequential.polish import polish_pair
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera
from vergence.geometry.se3 import pose


def calibrate_pair(
    corners_a: Array, corners_b: Array, points: Array, a: Camera, b: Camera
) -> tuple[Array, float]:
    """Return T_b_a (4, 4) of two rigidly connected cameras, and the RMS residual [px].

    OpenCV's bundle adjustment of the relative pose with the intrinsics held, polished in double
    precision.

    Args:
        corners_a: (V, K, 2) pixels in camera a; NaN where a corner was not seen.
        corners_b: (V, K, 2) likewise in camera b, at the same moments.
        points: (K, 3) the pattern's corners in frame target.
        a: intrinsics of camera a.
        b: intrinsics of camera b.

    Raises:
        VergenceError: no view shows six common corners.
    """
    both = seen_corners(corners_a) & seen_corners(corners_b)
    usable = both.sum(axis=1) >= 6
    if not usable.any():
        raise VergenceError(
            "The pose between two cameras needs views in which both see the board, found none."
        )
    with repeatable():
        *_, R, t, _E, _F = cv2.stereoCalibrate(
            [points[s].astype(np.float32) for s in both[usable]],
            [c[s].astype(np.float32) for c, s in zip(corners_a[usable], both[usable], strict=True)],
            [c[s].astype(np.float32) for c, s in zip(corners_b[usable], both[usable], strict=True)],
            a.matrix.copy(),
            a.distortion.copy(),
            b.matrix.copy(),
            b.distortion.copy(),
            (a.width, a.height),
            flags=cv2.CALIB_FIX_INTRINSIC,
            criteria=CRITERIA,
        )
    seen_a, seen_b = (
        np.where(both[usable][..., None], c[usable], np.nan) for c in (corners_a, corners_b)
    )
    T_a_target = target_poses(a, seen_a, points)
    return polish_pair(pose(R, t.ravel()), T_a_target, (seen_a, seen_b), points, (a, b))
