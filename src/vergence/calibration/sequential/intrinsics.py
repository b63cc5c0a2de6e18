"""Intrinsic parameters of one camera from views of a flat pattern (Zhang, by OpenCV)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal, get_args

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.calibration.sequential.polish import (
    board_jacobians,
    intrinsics_std,
    iterate,
    polish_intrinsics,
)
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera, project
from vergence.geometry.se3 import exp, pose, rotation, transform

LensModel = Literal["none", "k1", "k1k2", "radial-tangential"]
"""Which distortion is fitted: none, k1, k1 and k2, or (k1, k2, p1, p2)."""

_FREE = {  # of (fx, fy, cx, cy, k1, k2, p1, p2, k3)
    "none": np.array([1, 1, 1, 1, 0, 0, 0, 0, 0], dtype=bool),
    "k1": np.array([1, 1, 1, 1, 1, 0, 0, 0, 0], dtype=bool),
    "k1k2": np.array([1, 1, 1, 1, 1, 1, 0, 0, 0], dtype=bool),
    "radial-tangential": np.array([1, 1, 1, 1, 1, 1, 1, 1, 0], dtype=bool),
}
_FLAGS = {
    "none": cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST,
    "k1": cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST,
    "k1k2": cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST,
    "radial-tangential": cv2.CALIB_FIX_K3,
}
assert set(_FLAGS) == set(_FREE) == set(get_args(LensModel))

# OpenCV's default of 30 iterations stops short of the optimum where distortion is strong.
CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)


USELESS = 0.2
"""Standard deviation of a focal length, relative to it, from which it is refused: a ruler and the
data sheet know it better."""
_UNTOLD = (
    "The focal lengths fx and fy are not observable: the boards are seen at one angle only, or too "
    "few of them; slant the board by 20 to 40 degrees, in different directions."
)


@contextmanager
def repeatable() -> Iterator[None]:
    """Let OpenCV use one thread: with several its sums differ in their last digits every time."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """What Zhang's method gives for one camera."""

    camera: Camera
    rms_px: float
    """Root mean square of the distance between corners and their reprojections."""
    views: int
    focal_std_px: tuple[float, float]
    """Standard deviations of fx and fy, if all corners have independent errors of the size that
    is left."""


def seen_corners(corners: Array) -> np.ndarray:
    """Return (..., K) of bool: which corners (..., K, 2) were seen."""
    return np.asarray(np.isfinite(corners).all(axis=-1))


def calibrate_intrinsics(
    corners: Array, points: Array, *, size: tuple[int, int], lens_model: LensModel
) -> Intrinsics:
    """Fit a camera to views of a flat pattern: OpenCV's method, polished in double precision.

    Args:
        corners: (V, K, 2) pixels; NaN where a corner was not seen.
        points: (K, 3) the pattern's corners in frame target.
        size: width and height of the images [px].
        lens_model: which distortion coefficients are free.

    Raises:
        VergenceError: fewer than three views with four corners or more, or boards that do not
            tell the focal length.
    """
    seen = seen_corners(corners)
    usable = seen.sum(axis=1) >= 4
    if usable.sum() < 3:
        raise VergenceError(
            f"Intrinsics need at least 3 views of the board, found {usable.sum()}; "
            "show the whole board to the camera at different angles."
        )
    try:
        return _fitted(corners[usable], points, size, lens_model)
    except (cv2.error, ValueError, np.linalg.LinAlgError):
        # The steps of the fit lead to a lens that is none.
        raise VergenceError(_UNTOLD) from None


def _fitted(
    corners: Array, points: Array, size: tuple[int, int], lens_model: LensModel
) -> Intrinsics:
    views = [(points[s], c[s]) for c, s in zip(corners, seen_corners(corners), strict=True)]
    with repeatable():
        _, matrix, distortion, rvecs, tvecs = cv2.calibrateCamera(
            [p.astype(np.float32) for p, _ in views],
            [c.astype(np.float32).reshape(-1, 1, 2) for _, c in views],
            size,
            np.eye(3),  # only the type of these two is used: no guess is given
            np.zeros(5),
            flags=_FLAGS[lens_model],
            criteria=CRITERIA,
        )
    start = Camera(
        width=size[0],
        height=size[1],
        matrix=np.asarray(matrix, float),
        distortion=np.asarray(distortion, float).ravel()[:5],
    )
    poses = pose(rotation(np.array(rvecs).reshape(-1, 3)), np.array(tvecs).reshape(-1, 3))
    free = _FREE[lens_model]
    camera, poses = polish_intrinsics(start, free, poses, corners, points)
    errors = corners - project(camera, transform(poses[:, None], points))
    std = intrinsics_std(camera, free, poses, corners, points)[:2]
    if not (std < USELESS * camera.matrix[[0, 1], [0, 1]]).all():
        raise VergenceError(_UNTOLD)
    rms = float(np.sqrt(2 * np.nanmean(errors**2)))
    return Intrinsics(camera, rms, len(corners), (float(std[0]), float(std[1])))


def target_poses(camera: Camera, corners: Array, points: Array) -> Array:
    """Return T_cam_target (V, 4, 4) of each view.

    NaN where fewer than six corners are seen, or where these lie on one line, about which the
    board could turn.

    Args:
        camera: with its distortion.
        corners: (V, K, 2) pixels; NaN where a corner was not seen.
        points: (K, 3) the pattern's corners in frame target.
    """
    poses = np.full((len(corners), 4, 4), np.nan)
    for v, view in enumerate(corners):
        seen = seen_corners(view)
        if seen.sum() < 6 or _in_line(points[seen]):
            continue
        found, rvec, tvec = cv2.solvePnP(
            points[seen], view[seen], camera.matrix, camera.distortion, flags=cv2.SOLVEPNP_ITERATIVE
        )
        if found:
            poses[v] = pose(rotation(rvec.ravel()), tvec.ravel())
    usable = np.isfinite(poses).all(axis=(1, 2))
    if usable.any():
        poses[usable] = _polish_poses(camera, poses[usable], corners[usable], points)
    return poses


def _in_line(points: Array) -> bool:
    """Return whether points (N, 3) lie on one line, as corners of a single row do."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[1] < 1e-3 * spread[0])


def _polish_poses(camera: Camera, poses: Array, corners: Array, points: Array) -> Array:
    """Return the poses (V, 4, 4) at the minimum of the reprojection errors, by Gauss-Newton."""
    seen = np.isfinite(corners)

    def step() -> float:
        nonlocal poses
        pixels, d_pose, _, _ = board_jacobians(camera, poses, points)
        J = np.where(seen[..., None], d_pose, 0.0).reshape(len(poses), -1, 6)
        residuals = np.where(seen, corners - pixels, 0.0).reshape(len(poses), -1, 1)
        J_T = np.swapaxes(J, 1, 2)
        xi = np.linalg.solve(J_T @ J, J_T @ residuals)[:, :, 0]
        poses = poses @ exp(xi)
        return float(np.abs(xi).max())

    iterate(step)
    return poses
