"""Intrinsic parameters of a camera from views of a flat board (Zhang's method)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.calibration.lens_statistics import jackknife_covariance, noise_covariance
from vergence.calibration.lenses import LensModel, fit_model, free_intrinsics, without_poses
from vergence.calibration.observations import Observations
from vergence.errors import VergenceError
from vergence.geometry.board import corner_points
from vergence.geometry.camera import Camera, displaced_by_distortion
from vergence.geometry.head_accuracy import LensAccuracy
from vergence.geometry.parameter_names import PINHOLE
from vergence.vision.board_pose import board_errors, determines_pose, seen_corners

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
    return Intrinsics(camera, free, rms, len(corners), (fx_std, fy_std), accuracy)
