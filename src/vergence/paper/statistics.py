"""Mean and standard deviation of a figure's estimates, as the paper states them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array


@dataclass(frozen=True, eq=False)
class Statistics:
    """Statistics of one figure's estimates, in the left eye's base frame (x forward = depth)."""

    mean_m: Array
    """(3,) mean."""
    std_m: Array
    """(3,) standard deviation, with N - 1 in the denominator."""
    samples: int
    """Samples that were located."""
    dropped: int
    """Samples in which the object was not found, or its rays did not meet."""


def describe(points: Array) -> Statistics:
    """Return the statistics of points (N, 3) [m]; rows with NaN count as dropped samples."""
    good = points[np.isfinite(points).all(axis=1)]
    mean, std = np.full((2, 3), np.nan)
    if len(good) >= 2:
        mean, std = good.mean(0), good.std(0, ddof=1)
    return Statistics(mean, std, len(good), len(points) - len(good))
