"""Least squares of one lens and the boards before it, in double precision, for every lens model.

The boards' poses are eliminated view by view (the Schur complement), which leaves a system in the
intrinsics alone. What is left of the intrinsics' derivatives after the poses have been projected
out also says, to first order, how well a view would have been predicted without it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.calibration.sequential.lens_prior import lens_prior
from vergence.geometry.camera import Camera
from vergence.geometry.parameters import lens_of_vector, lens_vector
from vergence.geometry.se3 import boxplus
from vergence.vision.board_pose import board_errors

ITERATIONS = 60
"""At most, of Levenberg and Marquardt's method."""
NEGLIGIBLE_GAIN = 1e-10
"""Predicted decrease of the sum of squares, relative to it, from which a fit has converged."""
ROUGH = 1e-6
"""Predicted decrease at which a fit stops that is only compared with others."""
FOLDS = 5
"""Parts of the views, each predicted by a lens from the others."""
EXACT_PX2 = 1e-20
"""Mean square of errors at which a fit is exact."""
SMALLEST_EIGENVALUE = 1e-13
"""Least eigenvalue, of information scaled to a unit diagonal, of a direction that is determined."""


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
        """Return the sum of squares of the errors [px^2]."""
        return float((self.errors**2).sum())


def fit_lens(
    camera: Camera,
    free: np.ndarray,
    T_cam_target: Array,
    corners: Array,
    points: Array,
    *,
    iterations: int = ITERATIONS,
    tolerance: float = NEGLIGIBLE_GAIN,
) -> LensFit:
    """Return the fit of a lens to views of a board, by Levenberg and Marquardt's method.

    What is assumed of the lens beforehand (`lens_prior`) counts beside the noise that the errors
    show: the likelihood is that of the noise level which makes it largest.

    Args:
        camera: to start from.
        free: (n,) indices of the intrinsics that may change, in the order of intrinsics_names.
        T_cam_target: (V, 4, 4) to start from.
        corners: (V, K, 2) pixels; NaN where not seen.
        points: (K, 3) in frame target.
        iterations: at most.
        tolerance: predicted decrease of the sum of squares, relative to it, at which it stops.

    Raises:
        ValueError: a corner has no place in the image at the start.
    """
    count = np.count_nonzero(np.isfinite(corners))
    damping, lens = 1e-4, camera
    state = _linearised(lens, free, T_cam_target, corners, points)
    if state is None:
        raise ValueError("the start of a lens shows a corner behind the camera")

    def cost(state: _Linear, lens: Camera) -> float:
        """Return the sum of squares, raised by the prior: count log(cost) is -2 log posterior."""
        return float((state[0] ** 2).sum() * np.exp(lens_prior(lens)[0] / count))

    T = T_cam_target
    for _ in range(iterations):
        lowest = cost(state, lens)
        variance = (state[0] ** 2).sum() / count
        _, half_gradient, information = lens_prior(lens)
        prior = variance * information[free], -variance * half_gradient[free]
        accepted = False
        while not accepted:
            step_lens, step_view, gain = _step(state, prior, damping)
            if gain <= tolerance * lowest + EXACT_PX2 * state[0].size or damping > 1e10:
                return _fit(lens, T, state)
            values = lens_vector(lens)
            values[free] += step_lens
            try:
                trial = lens_of_vector(lens, values)
            except ValueError:
                damping *= 10
                continue
            moved = boxplus(T, step_view)
            found = None
            if np.isfinite(lens_prior(trial)[0]):
                found = _linearised(trial, free, moved, corners, points)
            accepted = found is not None and cost(found, trial) <= lowest
            if found is not None and accepted:
                lens, T, state, damping = trial, moved, found, max(damping / 10, 1e-14)
            else:
                damping *= 10
    return _fit(lens, T, state)


_Linear = tuple[Array, Array, Array]


def _linearised(
    camera: Camera, free: np.ndarray, T: Array, corners: Array, points: Array
) -> _Linear | None:
    """Return errors (V, 2 K), and their derivatives by poses (V, 2 K, 6) and lens (V, 2 K, n)."""
    with np.errstate(over="ignore", invalid="ignore"):
        errors, by_pose, by_lens = board_errors(camera, T, corners, points)
    return (errors, by_pose, by_lens[..., free]) if np.isfinite(errors).all() else None


def _step(state: _Linear, prior: tuple[Array, Array], damping: float) -> tuple[Array, Array, float]:
    """Return the steps of the lens (n,) and of the poses (V, 6), and the decrease they promise.

    The prior's information on the lens (n,), and its gradient, are in units of the errors.
    """
    errors, of_view, of_lens = state
    of_view_T = np.swapaxes(of_view, 1, 2)
    N = of_view_T @ of_view
    N[:, range(6), range(6)] *= 1 + damping
    g_view = -(of_view_T @ errors[..., None])
    both = np.linalg.solve(N, np.concatenate([of_view_T @ of_lens, g_view], axis=2))
    coupling, alone = both[..., :-1], both[..., -1]
    gg = np.einsum("vin,vim->nm", of_lens, of_lens, optimize=True)
    gg[np.diag_indices_from(gg)] += prior[0]
    gg[np.diag_indices_from(gg)] *= 1 + damping
    cross = of_view_T @ of_lens
    S = gg - np.einsum("vin,vim->nm", cross, coupling, optimize=True)
    g_lens = prior[1] - np.einsum("vin,vi->n", of_lens, errors, optimize=True)
    g = g_lens - np.einsum("vin,vi->n", cross, alone, optimize=True)
    step_lens = _solve(S, g) if len(g) else g
    step_view = alone - coupling @ step_lens
    gain = float(step_lens @ g_lens + (step_view * g_view[..., 0]).sum())
    return step_lens, step_view, gain


def _solve(H: Array, g: Array) -> Array:
    """Return the shortest x (..., n) of H x = g, in units of H's diagonal; H may be singular."""
    scale = np.sqrt(np.maximum(np.diagonal(H, axis1=-2, axis2=-1), 1e-300))
    values, vectors = np.linalg.eigh(H / scale[..., None, :] / scale[..., None])
    inverse = np.where(values > SMALLEST_EIGENVALUE, 1 / np.maximum(values, 1e-300), 0.0)
    along = (np.swapaxes(vectors, -1, -2) @ (g / scale)[..., None])[..., 0]
    return (vectors @ (inverse * along)[..., None])[..., 0] / scale


def _fit(camera: Camera, T: Array, state: _Linear) -> LensFit:
    errors, of_view, of_lens = state
    return LensFit(camera, T, errors, without_poses(of_view, of_lens))


def without_poses(by_pose: Array, by_lens: Array) -> Array:
    """Return derivatives (V, 2 K, n) by the lens, with those by poses (V, 2 K, 6) projected out."""
    by_pose_T = np.swapaxes(by_pose, 1, 2)
    return by_lens - by_pose @ np.linalg.solve(by_pose_T @ by_pose, by_pose_T @ by_lens)


def noise_covariance(rest: Array, variance: float) -> Array:
    """Return the covariance (n, n) of fitted intrinsics, if all corners err independently.

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
    """Return the covariance (n, n) of fitted intrinsics, by how much each view matters.

    The jackknife, for clusters: errors that the corners of a view share, such as those by the bend
    of the board, are in it, unlike where all corners are taken to err independently. The lens
    without a view is one Gauss-Newton step away from that of all views.

    Args:
        errors: (V, 2 K) [px] of the fit to all views.
        rest: (V, 2 K, n) their derivatives, of `without_poses`.
    """
    V, (H, g) = len(errors), _by_view(errors, rest)
    moved = _solve(H.sum(axis=0) - H, g)
    moved -= moved.mean(axis=0)
    return (V - 1) / V * moved.T @ moved


def _by_view(errors: Array, rest: Array) -> tuple[Array, Array]:
    """Return what each view adds to the normal equations of the intrinsics: (V, n, n), (V, n)."""
    rest_T = np.swapaxes(rest, 1, 2)
    return rest_T @ rest, (rest_T @ errors[..., None])[..., 0]


def held_out_squares(fit: LensFit) -> Array:
    """Return (V,) [px^2] the squares of each view's errors, predicted by a lens from other views.

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
