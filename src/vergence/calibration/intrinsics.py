"""Intrinsic parameters of a camera from views of a flat board (Zhang's method)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.calibration.lens_statistics import jackknife_covariance, noise_covariance
from vergence.calibration.lenses import LensFit, LensModel, fit_model, free_intrinsics
from vergence.calibration.observations import Observations
from vergence.errors import VergenceError
from vergence.geometry.board import corner_points
from vergence.geometry.camera import Camera, displaced_by_distortion
from vergence.geometry.head_accuracy import LensAccuracy
from vergence.geometry.parameter_names import PINHOLE
from vergence.vision.board_pose import determines_pose, seen_corners

LEAST_VIEWS = 3
"""Fewest views of a flat board: each gives two equations for up to five intrinsics (Zhang)."""
USELESS = 0.2
"""Standard deviation of a focal length, relative to it, from which it is refused: a ruler and the
data sheet know it better."""
_NOT_OBSERVABLE = (
    "The focal lengths fx and fy are not observable: the boards are seen at one angle only, or too "
    "few of them; slant the board by 20 to 40 degrees, in different directions."
)


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """What Zhang's method gives for one camera."""

    camera: Camera
    free: np.ndarray
    """(n,) indices of the intrinsics that were fitted, in the order of intrinsics_names."""
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
    """Calibrate the intrinsics of every camera by Zhang's method: the first step.

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
    """State by camera the lens model of Sec. II-A: narrow cameras have no distortion.

    Narrow are those whose names end in "narrow"; all others have the given model.
    """
    return {name: "none" if name.endswith("narrow") else wide_lens for name in observations.corners}


def calibrate_camera(
    corners: Array, points: Array, *, size: tuple[int, int], lens_model: LensModel
) -> Intrinsics:
    """Fit a camera to views of a flat board.

    Args:
        corners: (V, K, 2) pixels; NaN where a corner was not seen.
        points: (K, 3) the board's corners in frame target.
        size: width and height of the images [px].
        lens_model: which distortion coefficients are free.

    Raises:
        VergenceError: fewer than three views with four corners or more, or boards that do not
            determine the focal length.
    """
    seen = seen_corners(corners)
    if (found := int((seen.sum(axis=1) >= 4).sum())) < LEAST_VIEWS:
        raise VergenceError(
            f"Intrinsics need at least {LEAST_VIEWS} views of the board, found {found}; "
            "show the whole board to the camera at different angles."
        )
    corners = corners[determines_pose(points, seen)]
    if len(corners) < LEAST_VIEWS:
        raise VergenceError(_NOT_OBSERVABLE)
    try:
        intrinsics = _with_accuracy(fit_model(lens_model, None, corners, points, size), lens_model)
    except (cv2.error, ValueError, np.linalg.LinAlgError):
        # The steps of the fit lead to an impossible lens.
        raise VergenceError(_NOT_OBSERVABLE) from None
    focal = intrinsics.camera.matrix[[0, 1], [0, 1]]
    if not (np.array(intrinsics.focal_std_px) < USELESS * focal).all():
        raise VergenceError(_NOT_OBSERVABLE)
    return intrinsics


def _with_accuracy(fit: LensFit, model: LensModel) -> Intrinsics:
    """Compute the accuracy of a fit by the noise that is left, and by how views differ."""
    free, n, count = free_intrinsics(model), len(PINHOLE), np.count_nonzero(fit.errors)
    redundancy = count - 6 * len(fit.errors) - len(free)
    variance = fit.sum_squares / redundancy if redundancy > 0 else np.inf
    C, focal = noise_covariance(fit.rest, variance), fit.camera.matrix[[0, 1], [0, 1]]
    shown = displaced_by_distortion(fit.camera)[np.ix_(free[n:] - n, free[n:] - n)]
    stated = []
    for each in (C, jackknife_covariance(fit.errors, fit.rest)):
        std, displaced = np.sqrt(np.diag(each)), (each[n:, n:] * shown).sum()
        stated.append(((std[:2] / focal).mean(), std[2:n].mean(), np.sqrt(max(displaced, 0.0))))
    # The jackknife of few views is too small; they err by as much as their corners at least.
    of_focal, centre_px, distortion_px = np.max(stated, axis=0).tolist()
    return Intrinsics(
        fit.camera,
        free,
        rms_px=float(np.sqrt(2 * fit.sum_squares / count)),
        views=len(fit.errors),
        focal_std_px=tuple(np.sqrt(np.diag(C))[:2].tolist()),
        accuracy=LensAccuracy(focal=of_focal, centre_px=centre_px, distortion_px=distortion_px),
    )
