"""Intrinsic parameters of a camera from views of a flat board (Zhang's method, by OpenCV)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.calibration.observations import Observations
from vergence.errors import VergenceError
from vergence.geometry.board import corner_points
from vergence.geometry.camera import Camera, project_jacobians
from vergence.geometry.projection import by_pose_of_points
from vergence.geometry.se3 import pose, rotation
from vergence.vision.board_pose import seen_corners

LensModel = Literal["none", "k1", "k1k2", "radial-tangential"]
"""Which distortion is fitted: none, k1, k1 and k2, or (k1, k2, p1, p2)."""

_K1, _K2, _K3 = cv2.CALIB_FIX_K1, cv2.CALIB_FIX_K2, cv2.CALIB_FIX_K3
_LENSES: dict[LensModel, tuple[int, int]] = {
    "none": (0, _K1 | _K2 | _K3 | cv2.CALIB_ZERO_TANGENT_DIST),
    "k1": (1, _K2 | _K3 | cv2.CALIB_ZERO_TANGENT_DIST),
    "k1k2": (2, _K3 | cv2.CALIB_ZERO_TANGENT_DIST),
    "radial-tangential": (4, _K3),
}
"""How many coefficients are fitted, and OpenCV's flags for it."""

# OpenCV's default of 30 iterations stops short of the optimum where distortion is strong.
CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)

USELESS = 0.2
"""Standard deviation of a focal length, relative to it, from which it is refused: a ruler and the
data sheet know it better."""
_NOT_OBSERVABLE = (
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


def calibrate_intrinsics(
    observations: Observations, *, wide_lens: LensModel = "radial-tangential"
) -> dict[str, Intrinsics]:
    """Return the intrinsics of every camera by Zhang's method: the first step.

    From which end a view is numbered does not matter here. The lens model is that of all cameras
    but the narrow ones, which have no distortion (Sec. II-A) and names that end in "narrow".
    VergenceError if a camera has fewer than three views, or they do not determine its focal length.
    """
    points = corner_points(observations.board)
    found = {}
    for name, corners in observations.corners.items():
        model = "none" if name.endswith("narrow") else wide_lens
        size = observations.sizes[name]
        try:
            found[name] = calibrate_camera(corners, points, size=size, lens_model=model)
        except VergenceError as error:
            raise VergenceError(f"{name}: {error}") from None
    return found


def calibrate_camera(
    corners: Array, points: Array, *, size: tuple[int, int], lens_model: LensModel
) -> Intrinsics:
    """Fit a camera to views of a flat board; exact to what OpenCV's single precision allows.

    Args:
        corners: (V, K, 2) pixels; NaN where a corner was not seen.
        points: (K, 3) the board's corners in frame target.
        size: width and height of the images [px].
        lens_model: which distortion coefficients are free.

    Raises:
        VergenceError: fewer than three views with four corners or more, or boards that do not
            determine the focal length.
    """
    usable = seen_corners(corners).sum(axis=1) >= 4
    if usable.sum() < 3:
        raise VergenceError(
            f"Intrinsics need at least 3 views of the board, found {usable.sum()}; "
            "show the whole board to the camera at different angles."
        )
    try:
        return _fitted(corners[usable], points, size, lens_model)
    except (cv2.error, ValueError, np.linalg.LinAlgError):
        # The steps of the fit lead to an impossible lens.
        raise VergenceError(_NOT_OBSERVABLE) from None


def _fitted(
    corners: Array, points: Array, size: tuple[int, int], lens_model: LensModel
) -> Intrinsics:
    seen = seen_corners(corners)
    coefficients, flags = _LENSES[lens_model]
    with repeatable():
        rms, matrix, distortion, rvecs, tvecs = cv2.calibrateCamera(
            [points[each].astype(np.float32) for each in seen],
            [view[each].astype(np.float32) for view, each in zip(corners, seen, strict=True)],
            size,
            np.eye(3),  # only the type of these two is used: no guess is given
            np.zeros(5),
            flags=flags,
            criteria=CRITERIA,
        )
    camera = Camera(
        width=size[0],
        height=size[1],
        matrix=np.asarray(matrix, float),
        distortion=np.asarray(distortion, float).ravel()[:5],
    )
    poses = pose(rotation(np.array(rvecs).reshape(-1, 3)), np.array(tvecs).reshape(-1, 3))
    std = _focal_std(camera, 4 + coefficients, poses, corners, points)
    if not (std < USELESS * camera.matrix[[0, 1], [0, 1]]).all():
        raise VergenceError(_NOT_OBSERVABLE)
    return Intrinsics(camera, float(rms), len(corners), (float(std[0]), float(std[1])))


def _focal_std(camera: Camera, free: int, poses: Array, corners: Array, points: Array) -> Array:
    """Return the standard deviations (2,) of fx and fy [px], with the views' poses projected out.

    Free were the first `free` intrinsics in the order of project_jacobians; infinite: not
    determined.
    """
    V, seen = len(poses), np.isfinite(corners)[..., None]
    turned = points @ np.swapaxes(poses[:, :3, :3], 1, 2)
    pixels, by_point, by_lens = project_jacobians(camera, turned + poses[:, None, :3, 3])
    of_view = np.where(seen, by_pose_of_points(by_point, turned), 0.0).reshape(V, -1, 6)
    of_lens = np.where(seen, by_lens[..., :free], 0.0).reshape(V, -1, free)
    of_view_T = np.swapaxes(of_view, 1, 2)
    rest = of_lens - of_view @ np.linalg.solve(of_view_T @ of_view, of_view_T @ of_lens)
    H = (np.swapaxes(rest, 1, 2) @ rest).sum(axis=0)
    redundancy = np.count_nonzero(seen) - 6 * V - free
    scale = np.sqrt(np.diag(H))
    if redundancy < 1 or not (scale > 0).all():
        return np.full(2, np.inf)
    values, vectors = np.linalg.eigh(H / np.outer(scale, scale))
    variance = (vectors**2 / np.maximum(values, 1e-15)).sum(axis=1) / scale**2
    residuals = np.where(seen[..., 0], corners - pixels, 0.0)
    return np.sqrt(variance * (residuals**2).sum() / redundancy)[:2]
