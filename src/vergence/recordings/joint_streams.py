"""The joints' readings around the moving frames of a recording, at their own rate."""

from __future__ import annotations

import numpy as np

from vergence.data.description import Description
from vergence.data.table import MAX_ROWS
from vergence.data.timing import JointStream
from vergence.recordings.moments import between_images, joint_track, readings_at
from vergence.recordings.recording_map import RecordingMap
from vergence.recordings.scan import Scan

AROUND_S = 1.0
"""Time before and after a moving frame [s]: the window of its polynomial, and usual latencies."""


def joint_stream(
    scanned: Scan, mapped: RecordingMap, description: Description, moving_ns: np.ndarray
) -> JointStream | None:
    """Collect the eyes' readings around moving frames (M,) [ns], increasing.

    At all times at which a joint was read; those of the others are interpolated. None: there are no
    such frames, or no readings that go `between_images`.
    """
    names = description.head_kinematics.readings
    if len(moving_ns) < 2 or not between_images(mapped, description):
        return None
    tracks = [joint_track(scanned, description.sources[name].column) for name in names]
    stamp_ns = np.unique(np.concatenate([track.stamp_ns for track in tracks]))
    after = np.searchsorted(moving_ns, stamp_ns)
    nearest = [moving_ns[np.clip(after - k, 0, len(moving_ns) - 1)] for k in (0, 1)]
    stamp_ns = stamp_ns[np.abs(np.array(nearest) - stamp_ns).min(axis=0) <= AROUND_S * 1e9]
    if len(stamp_ns) < 2 or np.median(np.diff(stamp_ns)) >= np.median(np.diff(moving_ns)):
        return None  # the frames have all of them
    stamp_ns = stamp_ns[:: -(-len(stamp_ns) // MAX_ROWS)]
    read = readings_at(scanned, mapped, description, stamp_ns)
    readings = np.stack([read[name] for name in names], axis=-1)
    known = np.isfinite(readings).all(axis=1)
    return JointStream(stamp_ns[known] * 1e-9, readings[known])
