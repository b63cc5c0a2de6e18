"""Estimates with unknown noise: unknowns, noise levels and observability, in turn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.estimation.least_squares import least_squares
from vergence.estimation.linear import Linear, covariance_with, linearise
from vergence.estimation.noise import (
    Level,
    determined_by_others,
    estimate_noise,
    redundancy,
    row_noise_scales,
)
from vergence.estimation.observability import Observability, observe
from vergence.estimation.residual import (
    OUTLIER,
    Levels,
    Posterior,
    Residual,
    Residuals,
    coordinate_levels,
    inlier_weights,
    relative_sizes,
)
from vergence.estimation.variables import Variables

FEW_LEFT = 6
"""Redundancy of a level at the start, below which it is computed again after a few steps."""
ROUGH_STEPS = 5
"""Steps of the minimiser before the redundancy is computed again, away from a poor start."""
ROUNDS = 40
"""Rounds of unknowns, noise and observability, before an estimate has not converged."""
FAILURES = 6
"""Rounds without a minimum, after which an estimate has not converged. In 111 of 114 calibrations
of the tests there was none, in the other three one, one and four."""
RELEASES = 2
"""How often fixed directions may be released again."""
WEIGHINGS = 3
"""How often the noise scale of each row is estimated, and residuals judge the estimate, once all
else has settled."""
FIRST_LEVEL_SHARE = 0.8
"""Least level of the first kind of data, relative to its median error: keeps half of them among
the inliers."""


@dataclass(frozen=True, eq=False)
class Adjustment:
    """The maximum a posteriori, its noise levels, and what the data determine."""

    x: Variables
    residuals: Sequence[Residual]
    errors: Sequence[Array]
    """(M, k) of each residual."""
    levels: Levels
    linear: Linear
    """At x, with inlier weights."""
    observability: Observability
    """Its covariance allows for the noise levels being estimates."""
    assumed: Mapping[str, bool]
    """By level: whether it has its usual value, for want of data."""
    redundancy: Mapping[str, float]
    """By level: residuals in excess of what the fit takes, at a generous noise."""
    converged: bool


def adjust(
    residuals: Residuals, start: Variables, levels: Sequence[Level], *, outlier: float = OUTLIER
) -> Adjustment:
    """Estimate unknowns and noise levels.

    Args:
        residuals: what was measured, and priors.
        start: within the reach of Gauss-Newton.
        levels: that of the first residual, which has the most data, first.
        outlier: standard deviations beyond which a residual loses weight; infinite: plain least
            squares, in which all rows of a residual count alike.

    Raises:
        VergenceError: there are more unknowns than data.
    """
    first, fixed, assumed, left = _first_levels(residuals, start, levels, outlier)
    x, noise, basis = start, first, start.scaled_basis()
    seen: Observability | None = None
    linear: Linear | None = None
    log_variance = np.zeros(len(levels))
    agreed, converged, restarted, releases, failures = False, False, False, 0, 0
    weighings = WEIGHINGS - 1 if fixed.all() else 0  # at known noise one is enough
    for _ in range(ROUNDS):
        found = least_squares(residuals, x, levels=noise, outlier=outlier, basis=basis)
        x, residuals, converged, linear = found.x, found.residuals, found.converged, found.linear
        failures += not converged
        # The level depends on the inliers and they on it: keep half of the data among them.
        least = 0.0 if fixed[0] else FIRST_LEVEL_SHARE * _median_level(residuals, x, levels[0].name)
        noise = {**noise, levels[0].name: max(noise[levels[0].name], least)}
        linear = _inliers(residuals, x, noise, outlier, linear)
        estimated = estimate_noise(linear.onto(basis), levels, noise, fixed)
        change = max(abs(np.log(estimated.levels[each.name] / noise[each.name])) for each in levels)
        noise, log_variance = estimated.levels, estimated.log_variance
        determined = determined_by_others(linear, levels, noise)
        residuals = [residual.trust(noise, determined) for residual in residuals]
        before = 0 if seen is None else len(seen.fixed)
        linear = _inliers(residuals, x, noise, outlier, linear)
        now = observe(x, linear, noise)
        # While the noise settles good data may pass for outliers, and what they determine for
        # unobservable: it is released then, but not for ever, since that might never end.
        releases += restarted and len(now.fixed) < before
        if seen is None or len(now.fixed) >= before or releases <= RELEASES:
            seen, basis = now, now.basis
        agreed = change < 1e-3 and len(seen.fixed) == before
        if len(seen.fixed) > before:
            x, restarted = start, True  # unobservable directions have drifted
        if agreed:
            if weighings == WEIGHINGS:
                break
            share = estimated.redundancy[0] / max(linear.count[0], 1)
            if np.isfinite(outlier):
                residuals = [
                    _weighed(residual, x, weight, share, levels[0].floor)
                    for residual, weight in zip(residuals, linear.weights, strict=True)
                ]
            posterior = _posterior(x, linear, noise, basis)
            residuals = [residual.judge(x, posterior) for residual in residuals]
            weighings += 1
        if failures == FAILURES:
            break
    assert seen is not None
    assert linear is not None
    # Levels that are larger by their own uncertainty. For one that is well known the variance grows
    # by the factor 1 + Var(log sigma^2), which for nu degrees of freedom is nu / (nu - 2) to first
    # order: Student's t has that variance. For one that is indistinguishable from zero it grows by
    # the standard deviation of sigma^2.
    factor = np.sqrt(1 + log_variance / (1 + np.sqrt(log_variance)))
    larger = {each.name: noise[each.name] * f for each, f in zip(levels, factor, strict=True)}
    return Adjustment(
        x=x,
        residuals=residuals,
        errors=[residual.error(x) for residual in residuals],
        levels=noise,
        linear=linear,
        observability=replace(seen, covariance=observe(x, linear, larger).covariance),
        assumed=dict(zip([each.name for each in levels], assumed.tolist(), strict=True)),
        redundancy=dict(zip([each.name for each in levels], left.tolist(), strict=True)),
        converged=converged and agreed,
    )


def _first_levels(
    residuals: Residuals, start: Variables, levels: Sequence[Level], outlier: float
) -> tuple[dict[str, float], np.ndarray, np.ndarray, Array]:
    """Choose the first levels; which (Q,) stay, which of these are assumed, redundancies (Q,)."""
    main, basis = levels[0], start.scaled_basis()
    noise = {level.name: level.start for level in levels}
    fixed = np.array([level.given for level in levels])
    # At a noise below the errors of the start, all data would pass for outliers.
    noise[main.name] = max(main.start, _median_level(residuals, start, main.name))
    linear = _inliers(residuals, start, noise, outlier)
    left = redundancy(linear.onto(basis), noise)
    if not fixed.any() and (left[1:] < FEW_LEFT).any():
        # Closer to the optimum the first data determine more of what the others measure.
        rough = least_squares(
            residuals, start, levels=noise, outlier=outlier, basis=basis, iterations=ROUGH_STEPS
        )
        level = _median_level(residuals, rough.x, main.name)
        noise[main.name] = min(noise[main.name], max(level, main.start))
        left = redundancy(rough.linear.onto(basis), noise)
    if left[0] < 1:
        raise VergenceError(
            f"There are {linear.count[0]:.0f} coordinates of measurements for more unknowns than "
            "that; record more views of the board."
        )
    assumed = ~fixed & (left < 1) & np.array([level.usual is not None for level in levels])
    for level, is_assumed in zip(levels, assumed, strict=True):
        if is_assumed and level.usual is not None:
            noise[level.name] = level.usual
    if main.given:
        noise[main.name] = main.start
    return noise, fixed | assumed, assumed, left


def _inliers(
    residuals: Residuals,
    x: Variables,
    levels: Levels,
    outlier: float,
    known: Linear | None = None,
) -> Linear:
    """Linearise with inliers only; the known equations, if they are these."""
    errors = [residual.error(x) for residual in residuals]
    weights = [
        inlier_weights(residual, error, levels, outlier)
        for residual, error in zip(residuals, errors, strict=True)
    ]
    if known is not None and all(map(np.array_equal, weights, known.weights)):
        return known
    return linearise(residuals, x, errors, weights)


def _posterior(x: Variables, linear: Linear, levels: Levels, basis: Array) -> Posterior:
    def covariance(name: str) -> Array:
        columns = x.columns(name)
        return covariance_with(linear, levels, basis, columns)[columns]

    return covariance


def _weighed(
    residual: Residual, x: Variables, weights: Array, share: float, floor: float
) -> Residual:
    """Estimate the noise scale of each row; the fit has left this share of the residuals."""
    if not residual.weighs_rows:
        return residual
    kept = np.repeat(weights > 0.5, residual.together, axis=1)
    squares = (kept * residual.error(x) ** 2).sum(axis=1)
    scales = row_noise_scales(squares, share * kept.sum(axis=1), floor)
    return replace(cast(Any, residual), noise_scale=scales)


def _median_level(residuals: Residuals, x: Variables, name: str) -> float:
    """Estimate a level by the median size of errors, which half of the data cannot spoil."""
    sizes, together = [], 1
    for residual in residuals:
        errors = residual.error(x)
        mine = np.array(coordinate_levels(residual, errors.shape[1])) == name
        if mine.any():
            seen = True if residual.seen is None else residual.seen
            together = residual.together
            kept = np.broadcast_to(seen & mine[::together], (len(errors), len(mine[::together])))
            sizes.append(relative_sizes(residual, errors, {})[kept])
    return float(np.nanmedian(np.concatenate(sizes))) / _CHI_MEDIAN[together]


_CHI_MEDIAN = {1: 0.6744897501960817, 2: np.sqrt(2 * np.log(2))}
"""Median of the size of a standard normal vector, by its dimension."""
