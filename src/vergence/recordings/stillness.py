"""Find the moments of a recording at which joints, or images, stand still.

What counts as still follows from the recording itself: it moves no more than in its quietest part.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import studentized_range

from vergence.arrays import Array, nearest_rotation
from vergence.geometry.se3 import boxminus, known_poses, pose
from vergence.recordings.moments import Moments

WINDOW_NS = 200_000_000
"""Time before and after a moment in which all stands still [ns]: the largest latency of readings,
so that a reading of an eye at rest is of the same posture as the image."""
QUIETEST, RARELY = 0.1, 1e-3
"""Share of all moments at which a recording is assumed to rest at least, whose quantile gives its
noise; and share of those at rest at which noise of readings may pass for motion."""
BRIGHTER = 2.0
"""Factor up to which the noise of images differs between dark parts of a scene and bright ones."""
UNSEEN_RAD, NOISIEST_RAD = 6e-4, 0.042
"""Range of a reading within a window [rad], or of a position [m], that hardly moves an image (by
0.3 px at a focal length of 500 px); and largest one by noise, that of servos with 0.4 degrees."""
STILL_PX = 0.3
"""Motion of images within scan.LAG_NS [px] that does not matter: at 1.5 px/s none is blurred, and a
hand holds a board still."""


def joint_motion(moments: Moments) -> Array:
    """Compute the range of each reading around each moment (N, s), relative to that of noise.

    Eyes come first, then the neck's joints. NaN near moments without a reading.
    """
    eyes = eye_readings(moments)
    least, most, count = _extremes(
        moments.time_ns,
        np.concatenate([eyes, moments.neck_angles], axis=1),
        moments.time_ns - WINDOW_NS,
        moments.time_ns + WINDOW_NS,
    )
    ranges, s = most - least, eyes.shape[1]
    if moments.T_base_eye is not None:  # the noise of a turn may lie along any axis
        turns_and_shifts = np.linalg.norm(ranges[:, :s].reshape(len(ranges), -1, 3), axis=2)
        ranges = np.concatenate([turns_and_shifts, ranges[:, s:]], axis=1)
    usual, largest = studentized_range.ppf([QUIETEST, 1 - RARELY], max(count, 2), np.inf)
    noise = np.minimum(_level(ranges) * largest / usual, NOISIEST_RAD)
    return ranges / np.hypot(noise, UNSEEN_RAD)


def image_motion(moments: Moments) -> Array:
    """Compute the motion of each camera's images around each moment (N, c), relative to noise.

    NaN where a camera has no two images.
    """
    motion = np.full((len(moments), len(moments.change)), np.nan)
    for c, (name, image) in enumerate(moments.images.items()):
        rows = np.flatnonzero(image >= 0)
        if len(rows) < 2:
            continue
        # A change is that of the time before its image: those of the window end after its middle.
        change = np.nan_to_num(moments.change[name][rows, None])
        at_ns = moments.time_ns
        motion[:, c] = _extremes(at_ns[rows], change, at_ns, at_ns + WINDOW_NS)[1][:, 0]
    return motion / np.hypot(BRIGHTER * _level(motion), STILL_PX)


def joints_still(moments: Moments) -> np.ndarray:
    """Find at which moments (N,) eyes and neck stand still by their readings."""
    return np.asarray((joint_motion(moments) <= 1).all(axis=1))


def eye_readings(moments: Moments) -> Array:
    """Return the readings of the eyes (N, s) [rad]; of poses their increments of a mean pose."""
    if moments.T_base_eye is None:
        return moments.eye_angles
    away = np.full((len(moments), 2, 6), np.nan)
    for e, T in enumerate(np.moveaxis(moments.T_base_eye, 1, 0)):
        known = known_poses(T)
        mean = pose(nearest_rotation(T[known, :3, :3].sum(axis=0)), T[known, :3, 3].mean(axis=0))
        away[known, e] = boxminus(T[known], mean)
    return away.reshape(len(moments), -1)


def _extremes(
    times_ns: np.ndarray, values: Array, begin_ns: np.ndarray, end_ns: np.ndarray
) -> tuple[Array, Array, int]:
    """Compute the least and largest values (N, s) from the last before to the first after spans.

    Returns also how many values a span has usually.
    """
    first = np.maximum(np.searchsorted(times_ns, begin_ns, side="right") - 1, 0)
    last = np.minimum(np.searchsorted(times_ns, end_ns), len(times_ns) - 1)
    ends = np.stack([first, last + 1], axis=1).ravel()
    padded = np.concatenate([values, values[-1:]])
    least, most = (each.reduceat(padded, ends, axis=0)[::2] for each in (np.minimum, np.maximum))
    return least, most, int(np.median(last + 1 - first))


def _level(values: Array) -> Array:
    """Take the low quantile of each column (s,) of values (N, s), 0 for one without any."""
    known = [column[np.isfinite(column)] for column in values.T]
    return np.array([np.quantile(each, QUIETEST) if len(each) else 0.0 for each in known])
