"""The constant pose between two cameras that see the same board (Sec. II-A, and R_fp, t_fp)."""

from __future__ import annotations

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.calibration.sequential.intrinsics import CRITERIA, repeatable
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera
from vergence.geometry.se3 import pose
from vergence.vision.board_pose import LEAST_CORNERS, seen_corners


def calibrate_pair(
    corners_a: Array, corners_b: Array, points: Array, a: Camera, b: Camera
) -> tuple[Array, float]:
    """Return T_b_a (4, 4) of two rigidly connected cameras, and the RMS residual [px].

    OpenCV's bundle adjustment of the relative pose, with the intrinsics fixed; exact to what its
    single precision allows.

    Args:
        corners_a: (V, K, 2) pixels in camera a; NaN where a corner was not seen.
        corners_b: (V, K, 2) pixels in camera b, at the same moments.
        points: (K, 3) the board's corners in frame target.
        a: its intrinsics.
        b: its intrinsics.

    Raises:
        VergenceError: no view shows six common corners.
    """
    both = seen_corners(corners_a) & seen_corners(corners_b)
    usable = np.flatnonzero(both.sum(axis=1) >= LEAST_CORNERS)
    if not len(usable):
        raise VergenceError(
            "The pose between two cameras needs views in which both see the board, found none."
        )
    with repeatable():
        rms, *_, R, t, _E, _F = cv2.stereoCalibrate(
            [points[both[v]].astype(np.float32) for v in usable],
            [corners_a[v, both[v]].astype(np.float32) for v in usable],
            [corners_b[v, both[v]].astype(np.float32) for v in usable],
            a.matrix.copy(),
            a.distortion.copy(),
            b.matrix.copy(),
            b.distortion.copy(),
            (a.width, a.height),
            flags=cv2.CALIB_FIX_INTRINSIC,
            criteria=CRITERIA,
        )
    return pose(R, t.ravel()), float(rms)
