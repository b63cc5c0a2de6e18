"""Find the moments of a recording at which joints, or images, stand still.

What counts as still follows from the recording itself: it moves no more than in its quietest part.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from vergence.arrays import Array, nearest_rotation
from vergence.geometry.se3 import boxminus, known_poses, pose
from vergence.recordings.moments import Moments

WINDOW_S = 0.2
"""Time before and after a moment in which all stands still [s]: the largest latency of readings, so
that a reading of an eye at rest is of the same posture as the image."""
QUIETEST = 0.1
"""Share of all moments at which a recording is assumed to rest at least: the quantile from which
its noise is taken."""
RARELY = 1e-3
"""Share of resting moments at which noise of readings may pass for motion."""
BRIGHTER = 2.0
"""Factor up to which the noise of images differs between dark parts of a scene and bright ones."""
UNSEEN_RAD = 2e-4
"""Deviation of a joint within a window [rad], or of a position [m], that no image shows: 0.1 px at
a focal length of 500 px."""
NOISIEST_RAD = 0.007
"""Largest noise of readings [rad]: that of hobby servos, 0.4 degrees."""
STILL_PX = 0.3
"""Motion of images within LAG_NS [px] that does not matter: at 1.5 px/s none is blurred, and a hand
holds a board still."""


def joints_still(moments: Moments) -> np.ndarray:
    """Find at which moments (N,) eyes and neck stand still by their readings."""
    spread, limits = reading_spread(moments)
    return np.asarray((spread <= limits).all(axis=1))


def images_still(moments: Moments) -> np.ndarray:
    """Find at which moments (N,) the images of all cameras stand still."""
    motion, limits = image_motion(moments)
    return np.asarray((np.isnan(motion) | (motion <= limits)).all(axis=1))


def reading_spread(moments: Moments) -> tuple[Array, Array]:
    """Compute the deviation of each reading around each moment (N, s), and the largest of noise.

    NaN near moments without a reading.
    """
    values = _readings(moments)
    first, last = _around(moments.time_ns, moments.time_ns)
    # Sums up to each moment; those of squares about the mean, so that they do not cancel.
    known = np.isfinite(values).all(axis=1)
    away = np.where(known[:, None], values - values[known].mean(axis=0), 0.0) if known.any() else 0
    sums = [_sums(each) for each in (np.ones_like(values), away, away * away, ~known[:, None])]
    count, total, squares, lost = (each[last + 1] - each[first] for each in sums)
    variance = np.maximum(squares / count - (total / count) ** 2, 0.0)
    if moments.T_base_eye is not None:  # the noise of a turn may lie along any axis
        joints = moments.neck_angles.shape[1]
        parts = np.split(variance, [variance.shape[1] - joints], axis=1)
        turns_and_shifts = parts[0].reshape(len(moments), -1, 3).sum(axis=2)
        variance = np.concatenate([turns_and_shifts, parts[1]], axis=1)
    spread = np.where(lost > 0, np.nan, np.sqrt(variance))
    free = max(float(np.median(last - first)), 1.0)
    level = _level(spread) / np.sqrt(chi2.ppf(QUIETEST, free) / free)
    most = np.sqrt(chi2.isf(RARELY, free) / free)
    return spread, np.hypot(most * np.minimum(level, NOISIEST_RAD), UNSEEN_RAD)


def image_motion(moments: Moments) -> tuple[Array, Array]:
    """Compute the largest motion around each moment in each camera's images (N, c), and the limits.

    Motions are from image to image [px], NaN where a camera has none; limits are (c,), up to which
    images stand still.
    """
    motion = np.full((len(moments), len(moments.change)), np.nan)
    for c, (name, image) in enumerate(moments.images.items()):
        rows = np.flatnonzero(image >= 0)
        if len(rows) < 2:
            continue
        # A change is that of the time before its image: those of the window end after its middle.
        times_ns = moments.time_ns[rows]
        first = np.searchsorted(times_ns, moments.time_ns)
        last = np.searchsorted(times_ns, moments.time_ns + round(WINDOW_S * 1e9))
        first, last = (np.minimum(each, len(rows) - 1) for each in (first, last))
        change = np.nan_to_num(moments.change[name][rows])
        ends = np.stack([first, last + 1], axis=1).ravel()
        motion[:, c] = np.maximum.reduceat(np.append(change, 0.0), ends)[::2]
    return motion, np.hypot(BRIGHTER * _level(motion), STILL_PX)


def is_stream(moments: Moments) -> bool:
    """Check whether images come so often that they show whether something moves."""
    return len(moments) > 1 and bool(np.median(np.diff(moments.time_ns)) <= WINDOW_S * 1e9)


def stretches(wanted: np.ndarray) -> list[np.ndarray]:
    """List the indices of each run of moments (N,) that are wanted."""
    rows = np.flatnonzero(wanted)
    return np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if len(rows) else []


def _readings(moments: Moments) -> Array:
    """Stack all that says how head and eyes stand: (N, s) [rad], or [m] of positions."""
    return np.concatenate([eye_readings(moments), moments.neck_angles], axis=1)


def eye_readings(moments: Moments) -> Array:
    """Return the readings of the eyes (N, s) [rad]; of poses their increments of a mean pose."""
    if moments.T_base_eye is None:
        return moments.eye_angles
    parts = []
    for T in np.moveaxis(moments.T_base_eye, 1, 0):
        known = known_poses(T)
        away = np.full((len(T), 6), np.nan)
        if known.any():
            mean = pose(
                nearest_rotation(T[known, :3, :3].sum(axis=0)), T[known, :3, 3].mean(axis=0)
            )
            away[known] = boxminus(T[known], mean)
        parts.append(away)
    return np.concatenate(parts, axis=1)


def _around(times_ns: np.ndarray, at_ns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the first and the last of some times that bound the window around each moment."""
    half = round(WINDOW_S * 1e9)
    first = np.searchsorted(times_ns, at_ns - half, side="right") - 1
    last = np.searchsorted(times_ns, at_ns + half, side="left")
    return np.maximum(first, 0), np.minimum(last, len(times_ns) - 1)


def _sums(values: Array) -> Array:
    return np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])


def _level(values: Array) -> Array:
    """Take the low quantile of each column (n,) of values (N, n), 0 for one without any."""
    known = [column[np.isfinite(column)] for column in values.T]
    return np.array([np.quantile(each, QUIETEST) if len(each) else 0.0 for each in known])
