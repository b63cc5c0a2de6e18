"""Bundle adjustment with estimated noise: unknowns, noise levels and observability, in turn."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle.observability import Observability, observe, whole_basis
from vergence.calibration.bundle.problem import (
    BundleProblem,
    BundleState,
    corner_errors,
    head_size,
    reading_residuals,
    refit_trajectory,
)
from vergence.calibration.bundle.solver import (
    OUTLIER,
    LinearProblem,
    NoiseLevels,
    corner_distances,
    errors_of,
    inlier_weights,
    linearise,
    minimise,
    project_onto,
)
from vergence.calibration.bundle.systematic_errors import systematic_errors
from vergence.calibration.bundle.variance_components import (
    estimate_noise,
    image_levels,
    image_noise_scales,
    redundancy,
    restricted_cost,
)
from vergence.errors import VergenceError

GENEROUS_JOINT = 0.01
"""First guess of the joint noise [rad or m]: large, so that good readings do not pass for
outliers before the level is known."""
USUAL_JOINT = 0.002
"""Assumed where the data do not determine the joint noise [rad or m]: 0.1 degrees."""
TRUST_ENCODER = 2.0
"""Joint noise, as a multiple of how well one image determines the joints, up to which the readings
give the eyes' trajectory in time. At it they hold the latent angles to a fifth, and offsets of
0.1 s still settle."""
FEW_LEFT = 6
"""Redundancy of the readings at the start, below which it is computed again after a few steps."""
ROUGH_STEPS = 5
"""Steps of the minimiser before the redundancy is computed again, away from a poor start."""
ROUNDS = 40
"""Rounds of unknowns, noise and observability in turn, before an estimate has not converged."""
FAILURES = 6
"""Rounds without a minimum, after which the estimate has not converged. In 111 of 114 calibrations
of the tests there was none, in the other three one, one and four; where the data do not fit the
description, forty took minutes."""
RELEASES = 2
"""How often fixed directions may be released again."""
WEIGHINGS = 2
"""How often the noise scale of each image is estimated, once all else has settled."""


@dataclass(frozen=True, eq=False)
class Adjusted:
    """The result of an adjustment."""

    state: BundleState
    noise: NoiseLevels
    observability: Observability
    """Its covariance allows for the levels of noise being estimates themselves, and for errors of
    corners that images share."""
    outliers: Array
    """(M,) how many corners of each image of a board lost their weight."""
    lost_readings: Array
    """(B, n) by how much latent unknowns differ from readings without weight; 0: the others."""
    assumed: np.ndarray
    """(groups,) whether a joint noise is USUAL_JOINT, for want of data."""
    given: np.ndarray
    """(groups,) whether a joint noise was given."""
    redundancy: Array
    """(groups,) how many more readings there are than the fit takes, for a generous noise."""
    converged: bool
    camera_px: tuple[float, ...]
    """By camera: noise of one coordinate of a corner, rms over its images [px]."""
    systematic_px: tuple[float, ...]
    """By camera: systematic errors of corners, rms of one coordinate [px]."""
    cost: float
    """-2 log of the restricted likelihood, but for a constant."""


def adjust(
    problem: BundleProblem,
    start: BundleState,
    group: np.ndarray,
    *,
    pixel_std_px: float | None = None,
    joint_std: Array | None = None,
    outlier: float = OUTLIER,
) -> Adjusted:
    """Return the maximum a posteriori, its levels of noise, and what the data determine.

    Args:
        problem: the data.
        start: within the reach of Gauss-Newton.
        group: (n,) group of joint noise of each latent unknown.
        pixel_std_px: of one coordinate of a corner; None: estimated.
        joint_std: (groups,) of the readings; None: estimated.
        outlier: standard deviations beyond which a residual loses weight; infinite: plain least
            squares, in which all images count alike.

    Raises:
        VergenceError: there are more unknowns than data.
    """
    groups = int(group.max()) + 1
    basis = whole_basis(problem, start)
    first = _first_noise(problem, start, basis, group, pixel_std_px, joint_std, outlier)
    noise, linear = first.noise, first.linear
    state, seen, log_variance = start, None, np.zeros(1 + groups)
    agreed, converged, restarted, releases, failures = False, False, False, 0, 0
    weighings = 0 if np.isfinite(outlier) else WEIGHINGS
    for _ in range(ROUNDS):
        state, converged, linear = minimise(problem, state, noise, basis)
        failures += not converged
        problem = refit_trajectory(problem, state)
        # The level depends on the inliers and they on it: keep half of the corners among them.
        least = 0.0 if first.fixed[0] else 0.8 * _median_level(problem, state)
        noise = replace(noise, levels=np.maximum(noise.levels, [least] + [0.0] * groups))
        linear = _linear(problem, state, noise, known=linear)
        estimated, log_variance, rest = estimate_noise(
            project_onto(linear, basis), noise, first.fixed
        )
        change = np.abs(np.log(estimated.levels / noise.levels)).max()
        well = estimated.joint < TRUST_ENCODER * image_levels(linear, estimated)[group]
        problem = replace(problem, trust_encoder=problem.trust_encoder | well)
        noise, before = estimated, 0 if seen is None else len(seen.fixed)
        linear = _linear(problem, state, noise, known=linear)
        found = observe(problem, state, linear, noise)
        # While the noise settles good readings may pass for outliers, and what they determine for
        # unobservable: it is released then, but not for ever, since that might never end.
        releases += restarted and len(found.fixed) < before
        if seen is None or len(found.fixed) >= before or releases <= RELEASES:
            seen, basis = found, found.basis
        agreed = change < 1e-3 and len(seen.fixed) == before
        if len(seen.fixed) > before:
            state, restarted = start, True  # unobservable directions have drifted
        if agreed:
            if weighings == WEIGHINGS:
                break
            problem, weighings = _weighed(problem, state, linear, rest[0]), weighings + 1
        if failures == FAILURES:
            break
    assert seen is not None
    return _adjusted(
        problem,
        state,
        linear,
        noise,
        seen,
        log_variance,
        first,
        given=joint_std is not None,
        converged=converged and agreed,
    )


class _FirstNoise(NamedTuple):
    """The noise with which an adjustment begins."""

    noise: NoiseLevels
    linear: LinearProblem
    """The problem linearised near the start."""
    fixed: np.ndarray
    """(1 + groups,) which levels are given or assumed, and are not estimated."""
    assumed: np.ndarray
    """(groups,) as Adjusted has it."""
    redundancy: Array
    """(groups,) as Adjusted has it."""


def _first_noise(
    problem: BundleProblem,
    start: BundleState,
    basis: Array,
    group: np.ndarray,
    pixel_std_px: float | None,
    joint_std: Array | None,
    outlier: float,
) -> _FirstNoise:
    """Return first levels of noise, and which of them the data cannot determine.

    The basis (G, F) has the free directions of the shared unknowns. Other arguments and errors are
    those of `adjust`.
    """
    groups = int(group.max()) + 1
    fixed = np.array([pixel_std_px is not None] + [joint_std is not None] * groups)
    # At a noise below what the start is off by, all corners would pass for outliers.
    pixel = max(_median_level(problem, start), 0.1 if pixel_std_px is None else pixel_std_px)
    turned = _turned_by(problem, start, group)
    joint = GENEROUS_JOINT / turned if joint_std is None else joint_std
    noise = NoiseLevels(np.array([pixel, *joint]), group, outlier)
    linear = _linear(problem, start, noise)
    left = redundancy(project_onto(linear, basis), noise)
    if pixel_std_px is None and joint_std is None and (left[1:] < FEW_LEFT).any():
        # The corners are better than the start, and then say more of the readings.
        rough, _, linear = minimise(problem, start, noise, basis, iterations=ROUGH_STEPS)
        pixel = min(pixel, max(_median_level(problem, rough), 0.1))
        noise = replace(noise, levels=np.array([pixel, *joint]))
        left = redundancy(project_onto(linear, basis), noise)
    if left[0] < 1:
        raise VergenceError(
            f"There are {linear.count:.0f} corner coordinates for more unknowns than that; "
            "record more views of the board."
        )
    assumed = ~fixed[1:] & (left[1:] < 1)
    fixed[1:] |= assumed
    pixel = pixel if pixel_std_px is None else pixel_std_px
    levels = np.array([pixel, *np.where(assumed, USUAL_JOINT / turned, joint)])
    return _FirstNoise(replace(noise, levels=levels), linear, fixed, assumed, left[1:])


def _adjusted(
    problem: BundleProblem,
    state: BundleState,
    linear: LinearProblem,
    noise: NoiseLevels,
    seen: Observability,
    log_variance: Array,
    first: _FirstNoise,
    *,
    given: bool,
    converged: bool,
) -> Adjusted:
    """Return the result of an adjustment, with what its covariance has to allow for.

    Args:
        problem: the data.
        state: the estimate.
        linear: the problem linearised there.
        noise: its levels.
        seen: what the data determine at these levels.
        log_variance: (1 + groups,) of the logarithms of the squares of the levels.
        first: with what the adjustment began.
        given: whether the joint noise was.
        converged: whether the estimate is settled.
    """
    systematic_px, systematic = systematic_errors(problem, state, linear, noise, seen.basis)
    # Levels that are larger by their own uncertainty. For one that is well known the variance grows
    # by the factor 1 + Var(log sigma^2), which for nu degrees of freedom is nu / (nu - 2) to first
    # order: Student's t has that variance. For one that is indistinguishable from zero it grows by
    # the standard deviation of sigma^2.
    factor = np.sqrt(1 + log_variance / (1 + np.sqrt(log_variance)))
    certain = observe(problem, state, linear, replace(noise, levels=noise.levels * factor))
    c = head_size(problem)
    return Adjusted(
        state=state,
        noise=noise,
        observability=replace(seen, covariance=certain.covariance + systematic[:c, :c]),
        outliers=problem.seen.sum(axis=1) - linear.weights[0].sum(axis=1),
        lost_readings=np.where(linear.weights[1] > 0, 0.0, reading_residuals(problem, state)),
        assumed=first.assumed,
        given=np.full(len(first.assumed), given),
        redundancy=first.redundancy,
        converged=converged,
        camera_px=tuple(
            noise.pixel_px * float(np.sqrt(np.mean(own**2))) if len(own) else noise.pixel_px
            for own in (problem.noise_scale[problem.camera == c] for c in range(len(problem.eye)))
        ),
        systematic_px=systematic_px,
        cost=restricted_cost(project_onto(linear, seen.basis), noise),
    )


def _turned_by(problem: BundleProblem, start: BundleState, group: np.ndarray) -> Array:
    """Return (groups,) by how much the readings of each group turn a joint: see `factors`."""
    groups = int(group.max()) + 1
    if problem.T_base_eye_read is not None:
        return np.ones(groups)
    turned = start.head.kinematics.factors[problem.block_columns[0]]
    return np.array([turned[group == k].max() for k in range(groups)])


def _linear(
    problem: BundleProblem,
    state: BundleState,
    noise: NoiseLevels,
    *,
    known: LinearProblem | None = None,
) -> LinearProblem:
    """Return the problem linearised with inliers only: the known one, if that is what it is."""
    errors = errors_of(problem, state)
    weights = inlier_weights(problem, errors, noise)
    if known is not None and all(map(np.array_equal, weights, known.weights)):
        return known
    return linearise(problem, state, errors, weights)


def _weighed(
    problem: BundleProblem, state: BundleState, linear: LinearProblem, redundancy: float
) -> BundleProblem:
    """Return the problem with the noise scale of each image, as the residuals have it now."""
    kept = linear.weights[0]
    squares = (kept[..., None] * corner_errors(problem, state) ** 2).sum(axis=(1, 2))
    left = redundancy / max(linear.count, 1)  # the part of each that the fit has left
    return replace(problem, noise_scale=image_noise_scales(squares, 2 * left * kept.sum(axis=1)))


def _median_level(problem: BundleProblem, state: BundleState) -> float:
    """Return the pixel noise by the median, which half of the corners cannot spoil."""
    lengths = corner_distances(problem, errors_of(problem, state))[problem.seen]
    return float(np.nanmedian(lengths)) / np.sqrt(2 * np.log(2))
