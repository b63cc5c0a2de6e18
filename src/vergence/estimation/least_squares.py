"""Levenberg-Marquardt over shared and latent unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.estimation.linear import Linear, eliminate, linearise
from vergence.estimation.residual import (
    UNIT,
    Levels,
    Residual,
    Residuals,
    robust_weights,
)
from vergence.estimation.variables import Variables

TOLERANCE = 1e-8
"""Predicted decrease of the cost at which a fit has converged: the square of a ten-thousandth of a
standard deviation."""
MAX_DAMPING = 1e8
"""Damping, relative to the diagonal, beyond which no step decreases the cost."""
SMALLEST_LEVEL = 1e-6
"""Least value of a concentrated noise level [px]; keeps exact data from dividing by zero."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the cost is least."""

    x: Variables
    residuals: Sequence[Residual]
    """As they follow the solution."""
    errors: Sequence[Array]
    """(M, k) of each residual."""
    levels: Levels
    converged: bool
    linear: Linear
    """At the solution, with robust weights."""


def least_squares(
    residuals: Residuals,
    start: Variables,
    *,
    levels: Levels | None = None,
    outlier: float = np.inf,
    basis: Array | None = None,
    iterations: int = 60,
    tolerance: float = TOLERANCE,
) -> Solution:
    """Minimise the robust sum of squares of residuals.

    Without shared unknowns the latent elements are independent problems, each with its own damping.

    Args:
        residuals: what was measured, and priors.
        start: of all unknowns.
        levels: noise levels by name; None: the residuals share one level, which is concentrated
            out of the likelihood: its estimate is the root mean square error at every step.
        outlier: standard deviations beyond which the loss is Cauchy's; infinite: plain squares.
        basis: (G, F) directions in which the shared unknowns may move; None: all that are free.
        iterations: at most.
        tolerance: predicted decrease of the cost at which it has converged.

    Raises:
        ValueError: the start has no finite cost.
    """
    basis = start.scaled_basis() if basis is None else basis
    model = _Model(levels, outlier, independent=not start.size)
    now = model.followed(model.at(residuals, start))
    if not np.isfinite(now.costs).all():
        raise ValueError("the start of a fit has no finite cost")
    damping = np.full(len(now.costs), 1e-6)
    while True:
        linear = model.linearised(now)
        free, accepted = linear.at(now.levels).onto(basis), None
        while accepted is None:
            reduced = eliminate(free, {}, damping)
            shared, latent = reduced.step()
            gain = (latent * reduced.right[1]).sum(axis=1)
            if not model.independent:
                gain = np.atleast_1d(shared @ reduced.right[0] + gain.sum())
            active = (gain >= tolerance) & (damping <= MAX_DAMPING)
            if iterations == 0 or not active.any():
                converged = bool((gain < tolerance).all())
                return Solution(now.x, now.residuals, now.errors, now.levels, converged, linear)
            accepted, better = model.step(now, basis @ shared, latent, active)
            damping = np.where(active & ~better, damping * 10, damping)
            damping = np.where(better, np.maximum(damping / 10, 1e-15), damping)
        now, iterations = model.followed(accepted), iterations - 1


@dataclass(frozen=True, eq=False)
class _Point:
    """The unknowns at one step, and how well they fit."""

    x: Variables
    residuals: Sequence[Residual]
    errors: Sequence[Array]
    levels: Levels
    costs: Array
    """(1,) or, of independent problems, (B,)."""


@dataclass(frozen=True)
class _Model:
    """How residuals are weighed: the arguments of least_squares."""

    levels: Levels | None
    outlier: float
    independent: bool

    def at(self, residuals: Residuals, x: Variables, known: _Point | None = None) -> _Point:
        """Evaluate residuals, but for those of a known point at the same unknowns.

        ValueError if an unknown has an impossible value.
        """
        same = {} if known is None else {id(r): k for k, r in enumerate(known.residuals)}
        errors = [
            known.errors[same[id(r)]] if known is not None and id(r) in same else r.error(x)
            for r in residuals
        ]
        pairs = list(zip(residuals, errors, strict=True))
        levels, cost = self.levels, 0.0
        if levels is None:
            measured = [(r, e) for r, e in pairs if r.level != UNIT]
            pairs = [(r, e) for r, e in pairs if r.level == UNIT]
            count = sum(_coordinates(r, e) for r, e in measured)
            squares = sum(float((e**2).sum()) for _, e in measured)
            level = np.sqrt(max(squares / count, SMALLEST_LEVEL**2))
            levels = {str(r.level): level for r, _ in measured}
            cost = squares / level**2 + 2 * count * np.log(level)
            cost = cost if np.isfinite(cost) else np.inf
        rows = [r.costs(e, levels, self.outlier) for r, e in pairs]
        if not self.independent:
            costs = np.array([cost + sum(float(each.sum()) for each in rows)])
            return _Point(x, residuals, errors, levels, costs)
        costs = np.zeros(len(x.latent.value))
        for (residual, _), each in zip(pairs, rows, strict=True):
            costs += np.bincount(residual.element, each, len(costs))
        return _Point(x, residuals, errors, levels, costs)

    def followed(self, point: _Point) -> _Point:
        """Update a point with residuals that follow the estimate."""
        residuals = [residual.follow(point.x) for residual in point.residuals]
        if all(new is old for new, old in zip(residuals, point.residuals, strict=True)):
            return point
        return self.at(residuals, point.x, known=point)

    def linearised(self, point: _Point) -> Linear:
        weights = [
            robust_weights(residual, errors, point.levels, self.outlier)
            for residual, errors in zip(point.residuals, point.errors, strict=True)
        ]
        return linearise(point.residuals, point.x, point.errors, weights)

    def step(
        self, now: _Point, shared: Array, latent: Array, active: np.ndarray
    ) -> tuple[_Point | None, np.ndarray]:
        """Take the point after a step, and (1,) or (B,) where it did not raise the cost.

        Independent problems move only where it did not; None: nowhere.
        """
        try:
            trial = self.at(now.residuals, now.x.retract(shared, latent * active[:, None]))
        except ValueError:  # such as a negative focal length
            return None, np.zeros(len(active), bool)
        better = active & (trial.costs <= now.costs + 1e-12 * np.abs(now.costs))
        if not better.any():
            return None, better
        if (better | ~active).all():
            return trial, better
        return self.at(now.residuals, now.x.retract(shared, latent * better[:, None])), better


def _coordinates(residual: Residual, errors: Array) -> int:
    """Count the coordinates that were measured."""
    if residual.seen is None:
        return errors.size
    return residual.together * int(np.count_nonzero(residual.seen))
