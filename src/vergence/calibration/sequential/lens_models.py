"""The lens models that can be fitted to views of a board, and their fits.

`fit_model` fits them in double precision, from a start that is near the truth or from one that it
seeks.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from threading import Lock
from typing import Literal

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.calibration.sequential.lens_fit import NEGLIGIBLE_GAIN, ROUGH, LensFit, fit_lens
from vergence.calibration.sequential.lens_prior import EQUIDISTANT
from vergence.geometry.camera import Camera, pinhole
from vergence.geometry.lens import distort
from vergence.geometry.parameter_names import PINHOLE
from vergence.geometry.se3 import transform
from vergence.vision.board_pose import (
    board_poses,
    refined_poses,
    seen_corners,
    seen_from_the_other_side,
)

LensModel = Literal[
    "none",
    "k1",
    "k1k2",
    "radial-tangential",
    "radial-tangential-k3",
    "rational",
    "fisheye",
]
"""Which distortion is fitted: none, k1, k1 and k2, (k1, k2, p1, p2), the same and k3, or all of the
rational (8) or the fisheye (4) model of geometry.lens."""

FREE_COEFFICIENTS: dict[LensModel, int] = {
    "none": 0,
    "k1": 1,
    "k1k2": 2,
    "radial-tangential": 4,
    "radial-tangential-k3": 5,
    "rational": 8,
    "fisheye": 4,
}
"""How many coefficients are fitted: the first ones of geometry.lens."""
SLANT_DOUBTED = 4.0
"""Mean square of a view's errors, relative to that of the typical view, from which the board's
slant is doubted."""
FISHEYE_DEG = (100.0, 140.0, 175.0)
"""Fields of view with which the fit of a fisheye lens is started, beside OpenCV's pinhole fit."""

# OpenCV's default of 30 iterations stops short of the optimum where distortion is strong.
CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)


_FACTORS = 1.0, 2.0, 4.0, 0.5
"""On the focal lengths of Zhang's closed form, of what a fit is started from."""
_lock = Lock()
_threads_before: list[int] = []
"""How many threads OpenCV had when each calibration began that is still fitting."""


@contextmanager
def repeatable() -> Iterator[None]:
    """Let OpenCV use one thread: with several its sums differ in their last digits every time.

    It is a setting of the whole process, which comes back when the last of the calibrations that
    run at the same time leaves.
    """
    with _lock:
        _threads_before.append(cv2.getNumThreads())
        cv2.setNumThreads(1)
    try:
        yield
    finally:
        with _lock:
            if len(_threads_before) == 1:
                cv2.setNumThreads(_threads_before[0])
            _threads_before.pop()  # the first is that of the process and stays until the end


Start = tuple[Camera, Array]
"""A camera and the poses (V, 4, 4) of the boards before it."""


def fit_model(
    lens_model: LensModel,
    start: Start | None,
    corners: Array,
    points: Array,
    size: tuple[int, int],
    *,
    tolerance: float = NEGLIGIBLE_GAIN,
) -> LensFit:
    """Return the fit of a lens model in double precision.

    Args:
        lens_model: which coefficients are free.
        start: a camera near the truth with its boards: of the same or of the radial-tangential
            model, or for a rational lens a fisheye one; None: it is sought.
        corners: (V, K, 2) pixels, NaN where not seen; each view has four or more.
        points: (K, 3) the board's corners in frame target.
        size: width and height of the images [px].
        tolerance: see fit_lens.

    Raises:
        cv2.error or ValueError or numpy.linalg.LinAlgError: the fit leads to no camera.
    """
    free = free_intrinsics(lens_model)
    fit = _fit_from(lens_model, start, corners, points, size, tolerance)
    # A board that is small in the image may have been found slanted the other way.
    squares = (fit.errors**2).sum(axis=1) / np.count_nonzero(seen_corners(corners), axis=1)
    doubtful = np.flatnonzero(squares > SLANT_DOUBTED * np.median(squares))
    if not len(doubtful):
        return fit
    T = fit.T_cam_target.copy()
    other = seen_from_the_other_side(T[doubtful], points)
    found, cost = refined_poses(fit.camera, corners[doubtful], points, other)
    better = cost < (fit.errors[doubtful] ** 2).sum(axis=1)
    T[doubtful[better]] = found[better]
    if not better.any():
        return fit
    return fit_lens(fit.camera, free, T, corners, points, tolerance=tolerance)


def pinhole_start(corners: Array, points: Array, size: tuple[int, int]) -> Start | None:
    """Return a camera without distortion and the boards before it (Zhang's closed form).

    Where it has corners behind the camera, other focal lengths are tried: noise makes the closed
    form short by a factor of up to four where views show a few corners each. If there are such
    views for every one of them, the camera is fitted to the others first.
    """
    seen = seen_corners(corners)
    try:
        with repeatable():
            matrix = cv2.initCameraMatrix2D(
                [points[each].astype(np.float32) for each in seen],
                [view[each].astype(np.float32) for view, each in zip(corners, seen, strict=True)],
                size,
            )
        matrix = np.asarray(matrix, float)
        cameras = [Camera(*size, matrix * [[f, 1, 1], [1, f, 1], [1, 1, 1]]) for f in _FACTORS]
    except (cv2.error, ValueError):
        return None
    best: tuple[Camera, Array, np.ndarray] | None = None
    for camera in cameras:
        poses, before = _before_camera(camera, corners, points)
        if before.all():
            return camera, poses
        if best is None or before.sum() > best[2].sum():
            best = camera, poses, before
    assert best is not None
    camera, poses, before = best
    if before.sum() < 3:  # Zhang's method needs three views
        return None
    fit = fit_lens(camera, free_intrinsics("none"), poses[before], corners[before], points)
    poses, before = _before_camera(fit.camera, corners, points)
    return (fit.camera, poses) if before.all() else None


def _before_camera(camera: Camera, corners: Array, points: Array) -> tuple[Array, np.ndarray]:
    """Return poses (V, 4, 4) of boards, and which (V,) have all their seen corners in front."""
    poses, seen = board_poses(camera, corners, points), seen_corners(corners)
    in_front = transform(poses[:, None], points)[..., 2] > 0
    return poses, np.asarray((in_front | ~seen).all(axis=1))


def free_intrinsics(lens_model: LensModel) -> np.ndarray:
    """Return which intrinsics a lens model leaves free, as indices of intrinsics_names."""
    return np.arange(len(PINHOLE) + FREE_COEFFICIENTS[lens_model])


def _fit_from(
    lens_model: LensModel,
    start: Start | None,
    corners: Array,
    points: Array,
    size: tuple[int, int],
    tolerance: float,
) -> LensFit:
    free = free_intrinsics(lens_model)
    if lens_model == "fisheye":
        return _fit_fisheye(start, corners, points, size, tolerance)
    if lens_model == "rational":
        # From zeros the way is too long: along the valley of the rational model numerator and
        # denominator nearly cancel. A fisheye lens is near any lens, and its fit is quick.
        if start is None or start[0].model != "fisheye":
            fisheye = _fit_fisheye(start, corners, points, size, tolerance)
            start = fisheye.camera, fisheye.T_cam_target
        camera = _rational(*start, points)
    else:
        if start is None:
            start = pinhole_start(corners, points, size)
            if start is None:
                raise ValueError("no pinhole camera shows these boards")
            if lens_model == "radial-tangential-k3":
                before = _fit_from("radial-tangential", start, corners, points, size, ROUGH)
                start = before.camera, before.T_cam_target
        k = np.zeros(5)
        k[: len(free) - len(PINHOLE)] = start[0].distortion[: len(free) - len(PINHOLE)]
        camera = replace(start[0], distortion=k)
    return fit_lens(camera, free, start[1], corners, points, tolerance=tolerance)


def _rational(fisheye: Camera, T_cam_target: Array, points: Array) -> Camera:
    """Return the rational lens that is nearest to a fisheye one where it saw boards.

    With the denominator of an equidistant lens; the numerator by linear least squares.
    """
    seen = transform(T_cam_target[:, None], points)
    largest = (np.hypot(seen[..., 0], seen[..., 1]) / seen[..., 2]).max()
    r = np.tan(np.linspace(0.01, 1, 200) * np.arctan(largest))
    radius, _ = distort("fisheye", tuple(fisheye.distortion.tolist()), r, np.zeros_like(r))[:2]
    powers = r[:, None] ** [2, 4, 6]
    of_one = r / (1 + powers @ EQUIDISTANT)  # in the image, by each part of the numerator
    rows = of_one[:, None] * powers
    scale = rows.max(axis=0)
    k1, k2, k3 = np.linalg.lstsq(rows / scale, radius - of_one)[0] / scale
    k = np.array([k1, k2, 0, 0, k3, *EQUIDISTANT])
    return replace(fisheye, distortion=k, model="rational")


def _fit_fisheye(
    start: Start | None, corners: Array, points: Array, size: tuple[int, int], tolerance: float
) -> LensFit:
    """Return the best of the fits from several focal lengths: a pinhole fit may be far off."""
    free = free_intrinsics("fisheye")
    starts = [pinhole(*size, size[0] / np.radians(each), model="fisheye") for each in FISHEYE_DEG]
    if start is not None:  # it has the right focal length in the image's middle
        fx, fy = start[0].matrix[[0, 1], [0, 1]].tolist()
        starts.insert(0, pinhole(*size, (fx, fy), model="fisheye"))
    best = None
    for k, camera in enumerate(starts):
        given = start is not None and k == 0
        T = start[1] if start is not None and given else board_poses(camera, corners, points)
        if not np.isfinite(T).all():
            continue
        try:
            rough = fit_lens(camera, free[:4], T, corners, points, iterations=10, tolerance=ROUGH)
            found = fit_lens(
                rough.camera, free, rough.T_cam_target, corners, points, tolerance=tolerance
            )
        except (ValueError, np.linalg.LinAlgError):
            continue
        if best is None or found.sum_squares < best.sum_squares:
            best = found
        if given:
            break
    if best is None:
        raise ValueError("no start of a fisheye lens shows all boards")
    return best
