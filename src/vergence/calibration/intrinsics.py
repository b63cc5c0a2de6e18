"""Intrinsic parameters of a camera from views of a flat board (Zhang's method)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.calibration.lenses import LensFit, LensModel, fit_model, free_intrinsics
from vergence.calibration.observations import Observations
from vergence.calibration.priors import known_lens_std
from vergence.errors import VergenceError
from vergence.geometry.board import corner_points
from vergence.geometry.camera import Camera, displaced_by_distortion
from vergence.geometry.head_accuracy import LensAccuracy
from vergence.geometry.lens import PINHOLE
from vergence.geometry.parameters import lens_vector
from vergence.vision.board_pose import board_errors, board_poses, determines_pose, seen_corners

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
    covariance: Array
    """(n, n) of what was fitted: by the noise that is left, larger where views differ by more."""
    accuracy: LensAccuracy
    """Standard deviations of all that was fitted, also by how the views differ."""


def calibrate_intrinsics(
    observations: Observations,
    *,
    lenses: Mapping[str, LensModel] | None = None,
) -> dict[str, Intrinsics]:
    """Calibrate the intrinsics of every camera by Zhang's method: the first step.

    From which end a view is numbered does not matter here. Lens models are stated by camera;
    where none is, it is the paper's. A known lens is kept where it is better known than by the
    images. VergenceError if another camera has fewer than three views, or they do not determine
    its focal length.
    """
    points = corner_points(observations.board)
    models: dict[str, LensModel] = {**lenses_of_the_paper(observations), **(lenses or {})}
    found = {}
    for name, corners in observations.corners.items():
        known = observations.known_lenses.get(name)
        shown = determines_pose(points, seen_corners(corners)).any()
        before = _known_intrinsics(*known, corners, points) if known and shown else None
        try:
            found[name] = calibrate_camera(
                corners, points, size=observations.sizes[name], lens_model=models[name]
            )
        except VergenceError as error:
            if before is None:
                raise VergenceError(f"{name}: {error}") from None
            found[name] = before
        if before is not None and before.focal_std_px[0] < found[name].focal_std_px[0]:
            found[name] = before
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

    Pixels (V, K, 2) are NaN where corners (K, 3) were not seen. VergenceError for fewer than three
    views with four corners or more, or boards that do not determine the focal length.
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


def _known_intrinsics(camera: Camera, percent: float, corners: Array, points: Array) -> Intrinsics:
    """Take a lens as it was known before; boards in images (V, K, 2) are fitted to it."""
    corners = corners[determines_pose(points, seen_corners(corners))]
    errors, *_ = board_errors(camera, board_poses(camera, corners, points), corners, points)
    std = known_lens_std(camera, percent)
    free = np.flatnonzero(std * lens_vector(camera))
    return Intrinsics(
        camera,
        free,
        rms_px=float(np.sqrt(2 * (errors**2).sum() / max(np.count_nonzero(errors), 1))),
        views=len(corners),
        focal_std_px=tuple(std[:2].tolist()),
        covariance=np.diag(std[free] ** 2),
        accuracy=LensAccuracy(
            focal=percent / 100, centre_px=std[2], distortion_px=percent / 100 * camera.width / 2
        ),
    )


def _with_accuracy(fit: LensFit, model: LensModel) -> Intrinsics:
    """Compute the accuracy of a fit by the noise that is left, and by how views differ."""
    free, n, count = free_intrinsics(model), len(PINHOLE), np.count_nonzero(fit.errors)
    redundancy = count - 6 * len(fit.errors) - len(free)
    variance = fit.sum_squares / redundancy if redundancy > 0 else np.inf
    C, focal = noise_covariance(fit.rest, variance), fit.camera.matrix[[0, 1], [0, 1]]
    by_views = jackknife_covariance(fit.errors, fit.rest)
    larger = max(1.0, float((np.diag(by_views) / np.diag(C))[:2].max()))
    shown = displaced_by_distortion(fit.camera)[np.ix_(free[n:] - n, free[n:] - n)]
    stated = []
    for each in (C, by_views):
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
        covariance=larger * C,
        accuracy=LensAccuracy(focal=of_focal, centre_px=centre_px, distortion_px=distortion_px),
    )


FOLDS = 5
"""Parts of the views, each predicted from the others."""
SMALLEST_EIGENVALUE = 1e-13
"""Least eigenvalue, of information scaled to a unit diagonal, of a direction that is determined."""


def noise_covariance(rest: Array, variance: float) -> Array:
    """Compute the covariance (n, n) of fitted intrinsics, if all corners err independently.

    By the derivatives (V, 2 K, n) of the corners' pixels, of `without_poses`, and the variance of
    these. Infinite: not determined.
    """
    H = (np.swapaxes(rest, 1, 2) @ rest).sum(axis=0)
    scale = np.sqrt(np.diag(H))
    if not np.isfinite(variance) or not (scale > 0).all():
        return np.full(H.shape, np.inf)
    values, vectors = np.linalg.eigh(H / np.outer(scale, scale))
    return variance * (vectors / np.maximum(values, 1e-15)) @ vectors.T / np.outer(scale, scale)


def jackknife_covariance(errors: Array, rest: Array) -> Array:
    """Compute the covariance (n, n) of fitted intrinsics, by the change that each view makes.

    The jackknife, for clusters: it includes errors that the corners of a view share, such as those
    by the bend of the board. The lens without a view is one Gauss-Newton step away from that of all
    views, whose errors (V, 2 K) [px] and derivatives (V, 2 K, n) are given: see `without_poses`.
    """
    V, (H, g) = len(errors), _by_view(errors, rest)
    moved = _solve(H.sum(axis=0) - H, g)
    moved -= moved.mean(axis=0)
    return (V - 1) / V * moved.T @ moved


def held_out_squares(fit: LensFit) -> Array:
    """Compute (V,) [px^2] the squares of each view's errors, predicted by a lens from other views.

    The views are divided into FOLDS; of a view itself only the board's pose is fitted. The lens
    without a fold is one Gauss-Newton step away from that of all views.
    """
    V = len(fit.errors)
    number, squares = np.arange(V) % FOLDS, np.empty(V)
    H, g = _by_view(fit.errors, fit.rest)
    for k in range(FOLDS):
        mine = number == k
        moved = _solve(H[~mine].sum(axis=0), g[mine].sum(axis=0))
        squares[mine] = ((fit.errors[mine] + fit.rest[mine] @ moved) ** 2).sum(axis=1)
    return squares


def _by_view(errors: Array, rest: Array) -> tuple[Array, Array]:
    """Compute what each view adds to the normal equations of the intrinsics: (V, n, n), (V, n)."""
    rest_T = np.swapaxes(rest, 1, 2)
    return rest_T @ rest, (rest_T @ errors[..., None])[..., 0]


def _solve(H: Array, g: Array) -> Array:
    """Solve for the shortest x (..., n) of H x = g, in units of H's diagonal; H may be singular."""
    scale = np.sqrt(np.maximum(np.diagonal(H, axis1=-2, axis2=-1), 1e-300))
    values, vectors = np.linalg.eigh(H / scale[..., None, :] / scale[..., None])
    inverse = np.where(values > SMALLEST_EIGENVALUE, 1 / np.maximum(values, 1e-300), 0.0)
    along = (np.swapaxes(vectors, -1, -2) @ (g / scale)[..., None])[..., 0]
    return (vectors @ (inverse * along)[..., None])[..., 0] / scale
