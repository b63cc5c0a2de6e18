"""Joint readings at the moments of images: interpolated, never extrapolated.

Times are subtracted as whole numbers: seconds since 1970 as floats are exact to 0.2 us only.
"""

from __future__ import annotations

import numpy as np

from vergence.arrays import Array
from vergence.recordings.scan import JointTrack


def interpolate(track: JointTrack, at_ns: np.ndarray, *, max_gap_s: float) -> Array:
    """Interpolate readings (N,) at times (N,) [ns]; NaN outside of the track and in its gaps."""
    known = np.isfinite(track.values)
    if not known.any():
        return np.full(len(at_ns), np.nan)
    stamps, first = np.unique(track.stamp_ns[known], return_index=True)  # the first of equal ones
    values = track.values[known][first]
    after, part = between(stamps, at_ns, max_gap_s=max_gap_s)
    return values[after - 1] + part * (values[after] - values[after - 1])


def between(stamps: np.ndarray, at_ns: np.ndarray, *, max_gap_s: float) -> tuple[np.ndarray, Array]:
    """Find the later of the two stamps (S,), increasing, around each of N times [ns].

    Also returns which part (N,) of the time between both has passed; NaN where one is missing, or
    they are too far apart and the time is not that of one of them.
    """
    after = np.clip(np.searchsorted(stamps, at_ns, side="left"), min(1, len(stamps) - 1), None)
    after = np.minimum(after, len(stamps) - 1)
    gap_ns = np.maximum(stamps[after] - stamps[after - 1], 1)
    part = (at_ns - stamps[after - 1]) / gap_ns
    inside = (part >= 0) & (part <= 1) & (len(stamps) > 1)
    inside &= (gap_ns <= max_gap_s * 1e9) | (part == 0) | (part == 1)
    return after, np.where(inside, part, np.nan)
