"""Move joint readings of moving eyes to the moments of the images.

An image shows the joints some tens of milliseconds before or after they were read. Readings are
moved along a polynomial through their neighbours: along a tangent, an offset of 40 ms would look
like 3 % of gain in a motion of 1 Hz.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.geometry.se3 import boxminus, boxplus

WINDOW_S = 0.3
"""Half width of the window of the polynomial [s]. At 30 Hz and moved by 40 ms its error is 0.0014 %
of the amplitude at 1 Hz and 0.3 % at 2 Hz; a shorter window passes more noise."""
LEAST_ROWS = 7
"""Fewest samples of the window, for slower recordings."""
TRAJECTORY_DEGREE = 7
"""Degree of the polynomial with enough neighbours; gives the errors stated for WINDOW_S."""
TAKEN_UP = 1 - 1e-6
"""Share from which play counts as taken up, for rounding."""
_SLACK_S = 1e-6  # so that rounding of time stamps drops no row


@dataclass(frozen=True, eq=False)
class JointStream:
    """S samples of the joints, at a rate of their own."""

    time_s: Array
    """(S,) increasing, on the clock of the views' readings."""
    readings: Array
    """(S, r) [rad] in the order of the views' readings."""


@dataclass(frozen=True, eq=False)
class Timing:
    """When V views were taken."""

    time_s: Array
    """(V,) of the joint readings; of no meaning where the eyes stood still."""
    run: np.ndarray
    """(V,) of int: views of one motion share a number from 1; 0 where the eyes stood still."""
    stream: JointStream | None = None
    """All samples around the motions; None: the readings of the views are all there are."""

    def take(self, rows: np.ndarray) -> Timing:
        """Select views by index or by a mask."""
        return Timing(self.time_s[rows], self.run[rows], self.stream)


@dataclass(frozen=True, eq=False)
class Stencil:
    """Polynomials around each of N samples, as weights of its W neighbours."""

    neighbours: np.ndarray
    """(N, W) indices of samples."""
    weights: Array
    """(N, W, TRAJECTORY_DEGREE): times the neighbours' values they are the coefficients of s, s^2,
    ... in the change after s seconds; 0 at rest."""


def stencil(time_s: Array, run: np.ndarray, wanted: np.ndarray | None = None) -> Stencil:
    """Fit polynomials around N samples at times (N,) of runs (N,), 0 at rest.

    `wanted` (N,) of bool selects samples; the polynomials of others are zero. None: all.
    """
    N = len(time_s)
    found: list[tuple[int, np.ndarray, Array]] = []
    for number in np.unique(run[run > 0]):
        rows = np.flatnonzero(run == number)
        rows = rows[np.argsort(time_s[rows], kind="stable")]
        t = time_s[rows]
        for row, now in zip(rows, t, strict=True):
            if wanted is not None and not wanted[row]:
                continue
            # At an end of the motion the neighbours are all on one side, but as many.
            begin = np.clip(now - WINDOW_S, t[0], max(t[0], t[-1] - 2 * WINDOW_S))
            near = np.searchsorted(t, [begin - _SLACK_S, begin + 2 * WINDOW_S + _SLACK_S])
            if near[1] - near[0] < LEAST_ROWS:
                first = np.searchsorted(t, now) - LEAST_ROWS // 2
                near[0] = max(0, min(first, len(t) - LEAST_ROWS))
                near[1] = min(near[0] + LEAST_ROWS, len(t))
            window = slice(*near)
            degree = min(TRAJECTORY_DEGREE, (near[1] - near[0] + 2) // 3)
            s = (t[window] - now) / WINDOW_S
            fit = np.linalg.pinv(s[:, None] ** np.arange(degree + 1))[1:]
            fit = fit / WINDOW_S ** np.arange(1, degree + 1)[:, None]
            found.append((row, rows[window], fit.T))
    W = max((len(rows) for _, rows, _ in found), default=1)
    # Places that are not needed are of the sample itself: another may be NaN, and 0 x NaN is NaN.
    neighbours = np.tile(np.arange(N, dtype=np.intp)[:, None], W)
    weights = np.zeros((N, W, TRAJECTORY_DEGREE))
    for row, rows, fit in found:
        neighbours[row, : len(rows)] = rows
        weights[row, : len(rows), : fit.shape[1]] = fit
    return Stencil(neighbours, weights)


def taken_up(angles: Array, play: Array) -> Array:
    """Compute how far play (r,) is taken up (V, r), row after row, in the sense of the last motion.

    It goes from -1 to 1 while an angle (V, r) turns by the width of the play, and back. Before it
    has turned as far for the first time, and where it is NaN, it is 0.
    """
    found = np.zeros_like(angles)
    middle, certain = np.full(angles.shape[1], np.nan), np.zeros(angles.shape[1], bool)
    for row, state in zip(angles, found, strict=True):
        known = np.isfinite(row)
        middle = np.where(np.isnan(middle), row, middle)
        middle = np.where(known, np.clip(middle, row - play / 2, row + play / 2), middle)
        away = np.where(known, row - middle, 0.0) / (play / 2)
        certain |= np.abs(away) >= TAKEN_UP
        state[:] = np.where(certain, away, 0.0)
    return found


def coefficients(around: Stencil, values: Array) -> Array:
    """Compute the coefficients (N, n, TRAJECTORY_DEGREE) of polynomials through values (N, n)."""
    return np.einsum("nwk,nwj->njk", around.weights, values[around.neighbours], optimize=True)


def course(timing: Timing, readings: Array) -> Array:
    """Compute the coefficients (V, r, TRAJECTORY_DEGREE) of polynomials around each view.

    They go through the readings (V, r) of the views, and the samples of the stream if there is one.
    """
    time_s, run, V = timing.time_s, timing.run, len(readings)
    if timing.stream is not None:
        time_s = np.concatenate([time_s, timing.stream.time_s])
        readings = np.concatenate([readings, timing.stream.readings])
        run = np.concatenate([run > 0, np.ones(len(timing.stream.time_s), bool)])
    around = stencil(time_s, run, np.arange(len(time_s)) < V)
    return coefficients(Stencil(around.neighbours[:V], around.weights[:V]), readings)


def change(coefficients: Array, seconds: float) -> Array:
    """Evaluate the change (N, n) of values after a time."""
    return coefficients @ seconds ** np.arange(1.0, TRAJECTORY_DEGREE + 1)


def rate(coefficients: Array, seconds: float) -> Array:
    """Evaluate the rate of change (N, n) of values after a time [1/s]."""
    powers = np.arange(1.0, TRAJECTORY_DEGREE + 1)
    return coefficients @ (powers * seconds ** (powers - 1))


def pose_coefficients(around: Stencil, T: Array) -> Array:
    """Compute coefficients (N, 6, TRAJECTORY_DEGREE) of increments along poses (N, 4, 4)."""
    away = boxminus(T[around.neighbours], T[:, None])
    return np.einsum("nwk,nwj->njk", around.weights, away, optimize=True)


def moved_readings(readings: Array, timing: Timing, seconds: float) -> Array:
    """Move readings (V, J), or eye poses (V, 2, 4, 4), in time by some seconds."""
    if readings.ndim == 2:
        return readings + change(course(timing, readings), seconds)
    around = stencil(timing.time_s, timing.run)
    later = [
        boxplus(T, change(pose_coefficients(around, T), seconds))
        for T in np.moveaxis(readings, 1, 0)
    ]
    return np.stack(later, axis=1)
