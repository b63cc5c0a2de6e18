"""The constant pose between two cameras that see the same board (Sec. II-A, and R_fp, t_fp)."""

from __future__ import annotations

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.calibration.sequential.hand_eye import agreeing_rotations
from vergence.calibration.sequential.lens_models import CRITERIA, repeatable
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera, normalise, undistort
from vergence.geometry.se3 import inverse, known_poses, mean_pose, pose
from vergence.vision.board_pose import LEAST_CORNERS, board_poses, seen_corners

WIDEST = 2.0
"""Tangent of the angle from the axis (63 degrees) beyond which undistorted corners are left out:
their errors grow with its square."""


def calibrate_pair(
    corners_a: Array,
    corners_b: Array,
    points: Array,
    a: Camera,
    b: Camera,
    *,
    names: tuple[str, str] = ("camera a", "camera b"),
) -> tuple[Array, float]:
    """Return T_b_a (4, 4) of two rigidly connected cameras, and the RMS residual [px].

    OpenCV's bundle adjustment of the relative pose, with the intrinsics fixed; exact to what its
    single precision allows. Corners of fisheye and rational lenses are undistorted before, up to
    WIDEST from the axis; the residual is then that of undistorted pixels.

    Args:
        corners_a: (V, K, 2) pixels in camera a; NaN where a corner was not seen.
        corners_b: (V, K, 2) pixels in camera b, at the same moments.
        points: (K, 3) the board's corners in frame target.
        a: its intrinsics.
        b: its intrinsics.
        names: of both, for the message.

    Raises:
        VergenceError: no view shows six common corners that are not on one line.
    """
    # stereoCalibrate has no fisheye model, and fails far from the axis of a rational lens.
    wide = bool({"fisheye", "rational"} & {a.model, b.model})
    if wide:
        corners_a, a = _undistorted(corners_a, a)
        corners_b, b = _undistorted(corners_b, b)
    both = seen_corners(corners_a) & seen_corners(corners_b)
    usable = np.flatnonzero(both.sum(axis=1) >= LEAST_CORNERS)
    # OpenCV's own start is a median of rotation vectors, which fails for cameras that are rolled
    # against each other by about half a turn.
    T_a, T_b = (
        board_poses(camera, np.where(both[..., None], corners, np.nan)[usable], points)
        for camera, corners in ((a, corners_a), (b, corners_b))
    )
    between = T_b @ inverse(T_a)
    known = np.flatnonzero(known_poses(between))
    if not len(known):
        raise VergenceError(
            f"The pose between {' and '.join(names)} needs views in which both see "
            f"{LEAST_CORNERS} corners of the board, not all on one line and not far from the "
            "images' middles; found none."
        )
    if wide:  # a few corners near the axis may put a board where it is not
        known = known[agreeing_rotations(between[known, :3, :3])]
    usable, between = usable[known], between[known]
    start = mean_pose(between)
    with repeatable():
        rms, _K1, _D1, _K2, _D2, R, t, *_ = cv2.stereoCalibrateExtended(
            [points[both[v]].astype(np.float32) for v in usable],
            [corners_a[v, both[v]].astype(np.float32) for v in usable],
            [corners_b[v, both[v]].astype(np.float32) for v in usable],
            a.matrix.copy(),
            a.distortion.copy(),
            b.matrix.copy(),
            b.distortion.copy(),
            a.size,
            start[:3, :3],
            start[:3, 3:],
            flags=cv2.CALIB_FIX_INTRINSIC | cv2.CALIB_USE_EXTRINSIC_GUESS,
            criteria=CRITERIA,
        )
    return pose(R, t.ravel()), float(rms)


def _undistorted(corners: Array, camera: Camera) -> tuple[Array, Camera]:
    """Return the corners as a pinhole camera would see them, NaN far from the axis, and it."""
    xy = normalise(camera, corners)
    near = np.linalg.norm(xy, axis=-1) < WIDEST
    pixels = np.where(near[..., None], undistort(camera, corners), np.nan)
    return pixels, Camera(camera.width, camera.height, camera.matrix)
