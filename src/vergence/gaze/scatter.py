"""How much measurements of a moving point scatter, as a share of the variance that they state.

A stated covariance says how wrong a measurement is. How much measurements differ from one to the
next can be far less: a wrong calibration, or the gain of a joint, is nearly the same in all of
them, and no filter removes it. Were it taken for noise, a filter would trust its own prediction,
and lag behind the object for nothing. So the scatter is measured: how far each measurement lies
from the parabola through the three before it, which follows any smooth motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array

_MEMORY = 90
"""Measurements over which it is averaged: three seconds at 30 Hz."""
_TRUST = 5.0
"""How many measurements the first assumption is worth, that they scatter as stated."""
_PARABOLA_S = 0.2
"""Longest time over which a parabola is trusted to follow a motion."""


@dataclass(frozen=True, eq=False)
class Scatter:
    """What was found so far; the default assumes that measurements scatter as they state."""

    recent: tuple[tuple[float, Array], ...] = ()
    """The latest three measurements at most: time [s] and point (3,) [m]."""
    total: float = _TRUST
    """Sum of what measurements scattered, each as a share of its variance; old ones fade."""
    count: float = _TRUST
    """Of how many."""

    @property
    def share(self) -> float:
        """Variance of the scatter, as a share of the variance that is stated."""
        return self.total / self.count


def observe(scatter: Scatter, time_s: float, point: Array, covariance: Array) -> Scatter:
    """Return what is known of the scatter after a measurement.

    Args:
        scatter: before it.
        time_s: of the measurement, after those before it.
        point: (3,) [m].
        covariance: (3, 3) that it states [m^2].
    """
    recent = (*scatter.recent, (time_s, point))[-3:]
    if len(scatter.recent) < 3 or time_s - scatter.recent[0][0] > _PARABOLA_S:
        return Scatter(recent, scatter.total, scatter.count)
    times = np.array([time for time, _ in scatter.recent])
    apart = times[:, None] - times + np.eye(3)  # ones where a time meets itself
    ahead = np.tile(time_s - times, (3, 1)) * (1 - np.eye(3)) + np.eye(3)
    weights = np.prod(ahead / apart, axis=1)  # Lagrange's
    gap = point - weights @ np.array([past for _, past in scatter.recent])
    found = gap @ np.linalg.solve(covariance, gap) / (len(gap) * (1 + weights @ weights))
    fade = 1 - 1 / _MEMORY
    return Scatter(recent, fade * scatter.total + float(found), fade * scatter.count + 1)
