"""Intrinsic parameters of a camera from views of a flat board (Zhang's method)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.calibration.observations import Observations
from vergence.calibration.sequential.lens_fit import (
    NEGLIGIBLE_GAIN,
    ROUGH,
    LensFit,
    fit_lens,
    jackknife_covariance,
    noise_covariance,
    without_poses,
)
from vergence.calibration.sequential.lens_prior import EQUIDISTANT
from vergence.errors import VergenceError
from vergence.geometry.board import corner_points
from vergence.geometry.camera import Camera, displaced_by_distortion, pinhole
from vergence.geometry.head_accuracy import LensAccuracy
from vergence.geometry.lens import distort
from vergence.geometry.parameter_names import PINHOLE
from vergence.geometry.se3 import pose, rotation, transform
from vergence.vision.board_pose import (
    board_errors,
    board_poses,
    determines_pose,
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

_K1, _K2, _K3 = cv2.CALIB_FIX_K1, cv2.CALIB_FIX_K2, cv2.CALIB_FIX_K3
_BY_OPENCV: dict[LensModel, int] = {
    "none": _K1 | _K2 | _K3 | cv2.CALIB_ZERO_TANGENT_DIST,
    "k1": _K2 | _K3 | cv2.CALIB_ZERO_TANGENT_DIST,
    "k1k2": _K3 | cv2.CALIB_ZERO_TANGENT_DIST,
    "radial-tangential": _K3,
}
"""The models that OpenCV fits, and its flags for it; the others start from one of these."""
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
LEAST_VIEWS = 3
"""Fewest views of a flat board: each gives two equations for up to five intrinsics (Zhang)."""
SLANT_DOUBTED = 4.0
"""Mean square of a view's errors, relative to that of the typical view, from which the board's
slant is doubted."""
FISHEYE_DEG = (100.0, 140.0, 175.0)
"""Fields of view with which the fit of a fisheye lens is started, beside OpenCV's pinhole fit."""

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
    accuracy: LensAccuracy
    """Standard deviations of all that was fitted, also by how the views differ."""


def calibrate_intrinsics(
    observations: Observations,
    *,
    lenses: Mapping[str, LensModel] | None = None,
) -> dict[str, Intrinsics]:
    """Return the intrinsics of every camera by Zhang's method: the first step.

    From which end a view is numbered does not matter here. Lens models are stated by camera;
    where none is, it is the paper's. VergenceError if a camera has fewer than three views, or they
    do not determine its focal length.
    """
    points = corner_points(observations.board)
    models: dict[str, LensModel] = {**lenses_of_the_paper(observations), **(lenses or {})}
    found = {}
    for name, corners in observations.corners.items():
        size = observations.sizes[name]
        try:
            found[name] = calibrate_camera(corners, points, size=size, lens_model=models[name])
        except VergenceError as error:
            raise VergenceError(f"{name}: {error}") from None
    return found


def lenses_of_the_paper(
    observations: Observations, wide_lens: LensModel = "radial-tangential"
) -> dict[str, LensModel]:
    """Return by camera the lens model of Sec. II-A: narrow cameras have no distortion.

    Narrow are those whose names end in "narrow"; all others have the given model.
    """
    return {name: "none" if name.endswith("narrow") else wide_lens for name in observations.corners}


def calibrate_camera(
    corners: Array, points: Array, *, size: tuple[int, int], lens_model: LensModel
) -> Intrinsics:
    """Fit a camera to views of a flat board.

    Models that OpenCV fits are exact to what its single precision allows, the others to double
    precision.

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
    if usable.sum() < LEAST_VIEWS:
        raise VergenceError(
            f"Intrinsics need at least {LEAST_VIEWS} views of the board, found {usable.sum()}; "
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
    if lens_model in _BY_OPENCV:
        try:
            camera, poses, rms = by_opencv(corners, points, size, lens_model)
            return _checked(camera, poses, rms, corners, points, lens_model)
        except (cv2.error, ValueError, np.linalg.LinAlgError, VergenceError):
            pass  # a board on one line of corners, or found slanted the other way
    corners = corners[determines_pose(points, seen_corners(corners))]
    if len(corners) < LEAST_VIEWS:
        raise VergenceError(_NOT_OBSERVABLE)
    fit = fit_model(lens_model, None, corners, points, size)
    rms = np.sqrt(fit.sum_squares / np.count_nonzero(seen_corners(corners)))
    return _checked(fit.camera, fit.T_cam_target, float(rms), corners, points, lens_model)


def _checked(
    camera: Camera, poses: Array, rms: float, corners: Array, points: Array, model: LensModel
) -> Intrinsics:
    errors, by_pose, by_lens = board_errors(camera, poses, corners, points)
    free, n = free_intrinsics(model), len(PINHOLE)
    redundancy = 2 * np.count_nonzero(seen_corners(corners)) - 6 * len(poses) - len(free)
    variance = float((errors**2).sum()) / redundancy if redundancy > 0 else np.inf
    rest = without_poses(by_pose, by_lens[..., free])
    C, focal = noise_covariance(rest, variance), camera.matrix[[0, 1], [0, 1]]
    fx_std, fy_std = np.sqrt(np.diag(C))[:2].tolist()
    if not (np.array([fx_std, fy_std]) < USELESS * focal).all():
        raise VergenceError(_NOT_OBSERVABLE)
    shown = displaced_by_distortion(camera)[np.ix_(free[n:] - n, free[n:] - n)]
    stated = []
    for each in (C, jackknife_covariance(errors, rest)):
        std, displaced = np.sqrt(np.diag(each)), (each[n:, n:] * shown).sum()
        stated.append(((std[:2] / focal).mean(), std[2:n].mean(), np.sqrt(max(displaced, 0.0))))
    # Of few views the jackknife knows little; they err by as much as their corners at least.
    of_focal, centre_px, distortion_px = np.max(stated, axis=0).tolist()
    accuracy = LensAccuracy(focal=of_focal, centre_px=centre_px, distortion_px=distortion_px)
    return Intrinsics(camera, rms, len(corners), (fx_std, fy_std), accuracy)


def by_opencv(
    corners: Array, points: Array, size: tuple[int, int], lens_model: LensModel
) -> tuple[Camera, Array, float]:
    """Return a camera, its boards' poses (V, 4, 4) and the RMS residual [px], as OpenCV fits them.

    All views show four corners or more. cv2.error or ValueError: the fit leads to no camera.
    """
    seen = seen_corners(corners)
    with repeatable():
        rms, matrix, distortion, rvecs, tvecs = cv2.calibrateCamera(
            [points[each].astype(np.float32) for each in seen],
            [view[each].astype(np.float32) for view, each in zip(corners, seen, strict=True)],
            size,
            np.eye(3),  # only the type of these two is used: no guess is given
            np.zeros(5),
            flags=_BY_OPENCV[lens_model],
            criteria=CRITERIA,
        )
    camera = Camera(
        width=size[0],
        height=size[1],
        matrix=np.asarray(matrix, float),
        distortion=np.asarray(distortion, float).ravel()[:5],
    )
    poses = pose(rotation(np.array(rvecs).reshape(-1, 3)), np.array(tvecs).reshape(-1, 3))
    return camera, poses, float(rms)


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
    """Return a camera without distortion and the boards before it (Zhang's closed form)."""
    seen = seen_corners(corners)
    try:
        with repeatable():
            matrix = cv2.initCameraMatrix2D(
                [points[each].astype(np.float32) for each in seen],
                [view[each].astype(np.float32) for view, each in zip(corners, seen, strict=True)],
                size,
            )
        camera = Camera(*size, np.asarray(matrix, float))
    except (cv2.error, ValueError):
        return None
    poses = board_poses(camera, corners, points)
    return (camera, poses) if np.isfinite(poses).all() else None


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
                start = by_opencv(corners, points, size, "radial-tangential")[:2]
            elif lens_model == "radial-tangential-k3":
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
