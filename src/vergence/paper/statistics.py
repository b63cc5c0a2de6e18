"""What the paper states of each figure: mean and standard deviation of the estimates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array


@dataclass(frozen=True, eq=False)
class Statistics:
    """Of one figure's estimates, from the left eye's rotation centre (x forward = depth)."""

    mean_m: Array
    """(3,)."""
    std_m: Array
    """(3,), with N - 1 in the denominator."""
    samples: int
    """Samples that were located."""
    dropped: int
    """Samples in which the object was not found, or its rays did not meet."""


def describe(points: Array) -> Statistics:
    """Return the statistics of points (N, 3), leaving out those with NaN."""
    good = points[np.isfinite(points).all(axis=1)]
    if len(good) < 2:
        return Statistics(
            np.full(3, np.nan), np.full(3, np.nan), len(good), len(points) - len(good)
        )
    return Statistics(good.mean(0), good.std(0, ddof=1), len(good), len(points) - len(good))
