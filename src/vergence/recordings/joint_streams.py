"""Write the joints' readings around the moving frames of a recording, at their own rate."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from vergence.data.dataset import MAX_GAP_S
from vergence.data.description import STREAM, TIME, Description
from vergence.recordings.interpolation import interpolate
from vergence.recordings.moments import joint_track
from vergence.recordings.scan import Scan

AROUND_NS = 10**9
"""Time before and after a moving frame [ns]: the window of its polynomial, and usual latencies."""
APART_NS = 1000
"""Least time between rows [ns]; seconds since 1970 as floats are exact to 240 ns."""


def write_stream(
    folder: Path, scanned: Scan, description: Description, moving_ns: np.ndarray
) -> None:
    """Write joints.csv of a dataset, around two or more moving frames (M,) [ns], increasing.

    A row is a time at which a joint was read; readings of the others are interpolated.
    """
    columns = [description.sources[n].column for n in description.head_kinematics.readings]
    tracks = [joint_track(scanned, column) for column in columns]
    stamp_ns = np.unique(np.concatenate([track.stamp_ns for track in tracks]))
    stamp_ns = stamp_ns[np.diff(stamp_ns, prepend=stamp_ns[0] - APART_NS) >= APART_NS]
    begin, end = (np.searchsorted(moving_ns, stamp_ns + d) for d in (-AROUND_NS, AROUND_NS))
    stamp_ns = stamp_ns[end > begin]
    if len(stamp_ns) < 2 or np.median(np.diff(stamp_ns)) >= np.median(np.diff(moving_ns)):
        return  # the frames have all of them
    read = [interpolate(track, stamp_ns, max_gap_s=MAX_GAP_S) for track in tracks]
    table = np.column_stack([stamp_ns * 1e-9, *read])
    with (folder / STREAM).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([TIME, *columns])
        writer.writerows(table[np.isfinite(table).all(axis=1)].tolist())
