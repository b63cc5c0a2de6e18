"""Fit lens models to views of a flat board.

The boards' poses are latent. `fit_model` starts near the truth, or seeks a start of its own. What
is left of the intrinsics' derivatives after the poses have been projected out also gives, to first
order, how well a view would have been predicted without it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.calibration.priors import EQUIDISTANT, lens_block, lens_priors
from vergence.estimation.least_squares import TOLERANCE, least_squares
from vergence.estimation.variables import Variables
from vergence.geometry.camera import Camera, pinhole
from vergence.geometry.lens import PINHOLE, distort
from vergence.geometry.se3 import transform
from vergence.vision.board_pose import (
    BoardViews,
    board_errors,
    board_latent,
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
ROUGH = 1e-2
"""Predicted decrease of the cost at which a fit stops that is only compared with others: a tenth of
a standard deviation."""
SLANT_DOUBTED = 4.0
"""Mean square of a view's errors, relative to that of the typical view, from which the board's
slant is doubted."""
FISHEYE_DEG = (100.0, 140.0, 175.0)
"""Fields of view [degrees] with which the fit of a fisheye lens is started."""
FOCAL_FACTORS = 1.0, 2.0, 4.0, 0.5
"""On the focal lengths of Zhang's closed form: noise makes these short by a factor of up to four
where views show a few corners each."""

Start = tuple[Camera, Array]
"""A camera and the poses (V, 4, 4) of the boards before it."""


@dataclass(frozen=True, eq=False)
class LensFit:
    """A lens with the boards before it, at the least sum of squares."""

    camera: Camera
    T_cam_target: Array
    """(V, 4, 4)."""
    errors: Array
    """(V, 2 K) [px] projected minus seen; zero where not seen."""
    rest: Array
    """(V, 2 K, n) derivatives of the errors by the n free intrinsics, poses projected out."""

    @property
    def sum_squares(self) -> float:
        """Compute the sum of squares of the errors [px^2]."""
        return float((self.errors**2).sum())


def fit_lens(
    camera: Camera,
    free: np.ndarray,
    T_cam_target: Array,
    corners: Array,
    points: Array,
    *,
    iterations: int = 60,
    tolerance: float = TOLERANCE,
) -> LensFit:
    """Fit a lens to views of a board, by the likelihood of the noise level that makes it largest.

    The fit starts from a camera and boards T_cam_target (V, 4, 4); the intrinsics with indices
    `free` (n,) may change. Pixels (V, K, 2) are NaN where corners (K, 3) were not seen. ValueError
    if a corner has no place in the image at the start.
    """
    views = BoardViews(corners=corners, points=points)
    last = len(PINHOLE) + len(camera.distortion) - 1
    found = least_squares(
        [views, *lens_priors(camera, last in free)],
        Variables({"lens": lens_block(camera, free)}, board_latent(T_cam_target)),
        iterations=iterations,
        tolerance=tolerance,
    )
    camera, T = found.x["lens"], found.x.latent.value
    errors, by_pose, by_lens = board_errors(camera, T, corners, points)
    return LensFit(camera, T, errors, without_poses(by_pose, by_lens[..., free]))


def without_poses(by_pose: Array, by_lens: Array) -> Array:
    """Project derivatives by poses (V, 2 K, 6) out of those (V, 2 K, n) by the lens."""
    by_pose_T = np.swapaxes(by_pose, 1, 2)
    return by_lens - by_pose @ np.linalg.solve(by_pose_T @ by_pose, by_pose_T @ by_lens)


def fit_model(
    lens_model: LensModel,
    start: Start | None,
    corners: Array,
    points: Array,
    size: tuple[int, int],
    *,
    tolerance: float = TOLERANCE,
) -> LensFit:
    """Fit a lens model to views of a board with four corners or more, NaN where not seen.

    The start is near the truth, of the same or of the radial-tangential model, or for a rational
    lens a fisheye; None: it is sought. cv2.error, ValueError or numpy.linalg.LinAlgError if the fit
    leads to no camera.
    """
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
    free = free_intrinsics(lens_model)
    return fit_lens(fit.camera, free, T, corners, points, tolerance=tolerance)


def free_intrinsics(lens_model: LensModel) -> np.ndarray:
    """Find which intrinsics a lens model leaves free, as indices of intrinsics_names."""
    return np.arange(len(PINHOLE) + FREE_COEFFICIENTS[lens_model])


def pinhole_start(corners: Array, points: Array, size: tuple[int, int]) -> Start | None:
    """Find a camera without distortion and the boards before it (Zhang's closed form).

    Where it has corners behind the camera, other focal lengths are tried. If each has such views,
    the camera is fitted to the others first. None: no camera has all boards in front.
    """
    seen = seen_corners(corners)
    try:
        matrix = cv2.initCameraMatrix2D(
            [points[each].astype(np.float32) for each in seen],
            [view[each].astype(np.float32) for view, each in zip(corners, seen, strict=True)],
            size,
        )
        matrix = np.asarray(matrix, float)
        cameras = [Camera(*size, matrix * [[f, 1, 1], [1, f, 1], [1, 1, 1]]) for f in FOCAL_FACTORS]
    except (cv2.error, ValueError):
        return None
    starts = []
    for camera in cameras:
        poses, in_front = _in_front(camera, corners, points)
        if in_front.all():
            return camera, poses
        starts.append((camera, poses, in_front))
    camera, poses, in_front = max(starts, key=lambda start: start[2].sum())
    if in_front.sum() < 3:  # Zhang's method needs three views
        return None
    fit = fit_lens(camera, free_intrinsics("none"), poses[in_front], corners[in_front], points)
    poses, in_front = _in_front(fit.camera, corners, points)
    return (fit.camera, poses) if in_front.all() else None


def _in_front(camera: Camera, corners: Array, points: Array) -> tuple[Array, np.ndarray]:
    """Find poses (V, 4, 4) of boards, and which (V,) have all their seen corners in front."""
    poses, seen = board_poses(camera, corners, points), seen_corners(corners)
    in_front = transform(poses[:, None], points)[..., 2] > 0
    return poses, np.asarray((in_front | ~seen).all(axis=1))


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
    """Find the rational lens that is nearest to a fisheye one where it saw boards.

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
    """Take the best of the fits from several focal lengths: a pinhole fit may be far off."""
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
