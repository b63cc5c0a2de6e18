"""Joint readings at the moments of images: interpolated, never extrapolated."""

from __future__ import annotations

import numpy as np

from vergence.arrays import Array
from vergence.recordings.scan import JointTrack


def interpolate(track: JointTrack, at_ns: np.ndarray, *, max_gap_s: float) -> Array:
    """Interpolate readings (N,) at times (N,) [ns]; NaN outside of the track and in its gaps.

    Times are subtracted as whole numbers: seconds since 1970 as floats are exact to 0.2 us only.
    """
    order = np.argsort(track.stamp_ns, kind="stable")
    stamps, first = np.unique(track.stamp_ns[order], return_index=True)
    values = track.values[order][first]
    after = np.clip(np.searchsorted(stamps, at_ns, side="left"), 1, max(1, len(stamps) - 1))
    found = np.full(len(at_ns), np.nan)
    if len(stamps) < 2:
        return found
    gap_ns = stamps[after] - stamps[after - 1]
    part = (at_ns - stamps[after - 1]) / gap_ns
    inside = (part >= 0) & (part <= 1)
    inside &= (gap_ns <= max_gap_s * 1e9) | (part == 0) | (part == 1)
    both = values[after - 1] + part * (values[after] - values[after - 1])
    return np.where(inside, both, found)
