"""The whole estimate: unknowns, levels of noise and what is observable, until they agree."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle.observability import Observability, observe, whole_basis
from vergence.calibration.bundle.problem import (
    Problem,
    State,
    calibration_size,
    corner_errors,
    followed,
)
from vergence.calibration.bundle.solver import (
    OUTLIER,
    Linear,
    Noise,
    Weights,
    along,
    corner_distances,
    inliers,
    linearise,
    minimise,
    robust_weights,
    same,
)
from vergence.calibration.bundle.systematic_errors import shared_errors
from vergence.calibration.bundle.variance_components import (
    Components,
    estimate_noise,
    image_levels,
    image_spreads,
    redundancy,
)
from vergence.errors import VergenceError

GENEROUS_JOINT = 0.01
"""First guess of the joint noise [rad or m]: large, so that good readings are not taken for
outliers before the level is known."""
USUAL_JOINT = 0.002
"""Assumed where the data cannot tell the joint noise [rad or m]: 0.1 degrees."""
WELL_READ = 2.0
"""Joint noise, as a multiple of what one image tells, up to which readings lead the eyes' course
in time. At it they hold the latent angles to a fifth, and offsets of 0.1 s still settle."""
ROUNDS = 40
RELEASES = 2
"""How often what was held may be let go again."""
WEIGHINGS = 2
"""How often images are weighed by how much their corners scatter, once all else has settled."""


@dataclass(frozen=True, eq=False)
class Adjusted:
    """The result of an adjustment."""

    state: State
    components: Components
    observability: Observability
    """Its covariance allows for the levels of noise being estimates themselves, and for errors of
    corners that images share."""
    weights: Weights
    """1 for inliers, 0 for outliers and what was not seen."""
    assumed: np.ndarray
    """(groups,) whether a joint noise is USUAL_JOINT, for want of data."""
    told: np.ndarray
    """(groups,) whether a joint noise was given."""
    spare: Array
    """(groups,) how many readings a generous noise would leave over: what a level rests on."""
    converged: bool
    shared_px: tuple[float, ...]
    """By camera: errors of corners that all its images share, rms of one coordinate [px]."""


def adjust(
    problem: Problem,
    start: State,
    group: np.ndarray,
    *,
    pixel_std_px: float | None = None,
    joint_std: Array | None = None,
    outlier: float = OUTLIER,
) -> Adjusted:
    """Return the maximum a posteriori, its levels of noise, and what the data determine.

    Args:
        problem: the data.
        start: where to start, within the reach of Gauss-Newton.
        group: (n,) group of joint noise of each latent unknown.
        pixel_std_px: of one coordinate of a corner; None: estimated.
        joint_std: (groups,) of the readings; None: estimated.
        outlier: standard deviations beyond which a residual loses weight; infinite: plain least
            squares, in which all images count alike.

    Raises:
        VergenceError: there are more unknowns than data.
    """
    groups = int(group.max()) + 1
    told = np.array([pixel_std_px is not None] + [joint_std is not None] * groups)
    first = Noise(
        max(_median_level(problem, start), 0.1) if pixel_std_px is None else pixel_std_px,
        np.full(groups, GENEROUS_JOINT) if joint_std is None else joint_std,
        group,
        outlier,
    )
    basis, linear = whole_basis(problem, start), _linear(problem, start, first)
    left = redundancy(along(linear, basis), first)
    if left[0] < 1:
        raise VergenceError(
            f"There are {linear.count:.0f} corner coordinates for more unknowns than that; "
            "record more views of the board."
        )
    assumed = ~told[1:] & (left[1:] < 1)
    told[1:] |= assumed
    noise = replace(first, joint=np.where(assumed, USUAL_JOINT, first.joint))
    state, components, seen = start, Components(noise, np.zeros(1 + groups), left), None
    agreed, converged, restarted, releases = False, False, False, 0
    weighings = 0 if np.isfinite(outlier) else WEIGHINGS
    for _ in range(ROUNDS):
        state, converged, linear = minimise(problem, state, noise, basis)
        problem = followed(problem, state)
        # Inliers choose the level and the level the inliers: keep half of the corners among them.
        least = 0.0 if told[0] else 0.8 * _median_level(problem, state)
        noise = replace(noise, pixel_px=max(noise.pixel_px, least))
        linear = _linear(problem, state, noise, known=linear)
        components = estimate_noise(along(linear, basis), noise, told)
        change = np.abs(np.log(_levels(components.noise) / _levels(noise))).max()
        well = components.noise.joint < WELL_READ * image_levels(linear, noise)
        problem = replace(problem, read_well=problem.read_well | well[noise.group])
        noise, before = components.noise, 0 if seen is None else len(seen.held)
        linear = _linear(problem, state, noise, known=linear)
        found = observe(problem, state, linear, noise)
        # While the noise settles good readings may pass for outliers, and what they determine for
        # unobservable: it is released then. Not for ever: taking turns would never end.
        releases += restarted and len(found.held) < before
        if seen is None or len(found.held) >= before or releases <= RELEASES:
            seen, basis = found, found.basis
        agreed = change < 1e-3 and len(seen.held) == before
        if len(seen.held) > before:
            state, restarted = start, True  # what turns out to be unobservable has wandered
        if agreed:
            if weighings == WEIGHINGS:
                break
            problem, weighings = _weighed(problem, state, noise, components), weighings + 1
    assert seen is not None
    weights, c = inliers(robust_weights(problem, state, noise)), calibration_size(problem)
    shared = shared_errors(problem, state, linear, weights, noise, seen.basis)
    certain = observe(problem, state, linear, _allowing_for_estimation(components))
    return Adjusted(
        state,
        components,
        replace(seen, covariance=certain.covariance + shared.covariance[:c, :c]),
        weights,
        assumed,
        np.full(groups, joint_std is not None),
        left[1:],
        converged and agreed,
        shared.rms_px,
    )


def _linear(problem: Problem, state: State, noise: Noise, *, known: Linear | None = None) -> Linear:
    """Return the problem linearised with inliers only: the known one, if that is what it is."""
    weights = inliers(robust_weights(problem, state, noise))
    if known is not None and same(weights, known):
        return known
    return linearise(problem, state, weights)


def _weighed(problem: Problem, state: State, noise: Noise, components: Components) -> Problem:
    """Return the problem with what is known now of how much the corners of each image scatter."""
    kept = inliers(robust_weights(problem, state, noise)).corner
    squares = (kept[..., None] * corner_errors(problem, state) ** 2).sum(axis=(1, 2))
    left = components.redundancy[0] / max(2 * kept.sum(), 1)  # of each, what the fit has not taken
    return replace(problem, spread=image_spreads(squares, 2 * left * kept.sum(axis=1)))


def _median_level(problem: Problem, state: State) -> float:
    """Return the pixel noise by the median, which half of the corners cannot spoil."""
    lengths = corner_distances(problem, state)[problem.seen]
    return float(np.nanmedian(lengths)) / np.sqrt(2 * np.log(2))


def _levels(noise: Noise) -> Array:
    return np.array([noise.pixel_px, *noise.joint])


def _allowing_for_estimation(components: Components) -> Noise:
    """Return levels that are larger by what is not known about them.

    For a level that is well known the variance grows by the factor 1 + Var(log sigma^2), which
    for nu degrees of freedom is nu / (nu - 2) to first order: Student's t has that variance. For
    one that is indistinguishable from zero it grows by the standard deviation of sigma^2.
    """
    v = components.log_variance
    factor = np.sqrt(1 + v / (1 + np.sqrt(v)))
    noise = components.noise
    return replace(noise, pixel_px=noise.pixel_px * factor[0], joint=noise.joint * factor[1:])
