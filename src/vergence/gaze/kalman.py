"""Track a moving point by a Kalman filter of position, velocity and acceleration.

All quantities are in one fixed frame. Between measurements the acceleration changes by white noise
in the jerk.

A stated covariance describes the total error of a measurement. An error of the calibration is
nearly the same in all frames; if it were taken for noise, the filter would lag behind the point.
`InnovationRatio` estimates the ratio of the observed to the stated variance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vergence.arrays import Array

_PRIOR_COUNT = 5.0
"""Weight of the prior ratio 1 [measurements]."""


@dataclass(frozen=True)
class MotionModel:
    """Prior of the motion of a tracked point."""

    jerk_density: float = 1.0
    """Spectral density of the jerk [m^2/s^5]. By default the acceleration changes by 1 m/s^2 in a
    second, enough for a point at 0.3 m/s to turn round in 0.6 s."""
    speed_std_m_s: float = 0.3
    """Prior standard deviation of each component of the velocity."""
    acceleration_std_m_s2: float = 1.0
    """Prior standard deviation of each component of the acceleration."""


@dataclass(frozen=True, eq=False)
class InnovationRatio:
    """Running estimate of the ratio of observed to stated variance; 1 before any measurement."""

    recent: tuple[tuple[float, Array], ...] = ()
    """Times [s] and points (3,) [m] of up to three latest measurements."""
    total: float = _PRIOR_COUNT
    """Fading sum of the squared deviations, each relative to its stated variance."""
    count: float = _PRIOR_COUNT
    """Fading number of measurements in the sum."""

    @property
    def value(self) -> float:
        """Observed variance from frame to frame over the stated variance."""
        return self.total / self.count


@dataclass(frozen=True, eq=False)
class Track:
    """The state of a moving point at one time."""

    time_s: float
    mean: Array
    """(9,) position [m], velocity [m/s], acceleration [m/s^2]."""
    covariance: Array
    """(9, 9) of the mean."""
    ratio: InnovationRatio = InnovationRatio()
    """Of the measurements."""

    @property
    def position(self) -> Array:
        """(3,) [m]."""
        return self.mean[:3]

    @property
    def velocity(self) -> Array:
        """(3,) [m/s]."""
        return self.mean[3:6]


def begin(time_s: float, point: Array, covariance: Array, motion: MotionModel) -> Track:
    """Start a track from its first measurement, (3,) [m] with covariance (3, 3) [m^2]."""
    prior = [0.0, motion.speed_std_m_s**2, motion.acceleration_std_m_s2**2]
    P = np.diag(np.repeat(prior, 3))
    P[:3, :3] = covariance
    return Track(time_s, np.concatenate([point, np.zeros(6)]), P)


def predict(track: Track, time_s: float, *, jerk_density: float) -> Track:
    """Predict a track to a later time, for a jerk of this spectral density [m^2/s^5]."""
    dt = time_s - track.time_s
    motion = np.array([[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]])
    growth = jerk_density * np.array(
        [
            [dt**5 / 20, dt**4 / 8, dt**3 / 6],
            [dt**4 / 8, dt**3 / 3, dt**2 / 2],
            [dt**3 / 6, dt**2 / 2, dt],
        ]
    )
    F, Q = (np.kron(M, np.eye(3)) for M in (motion, growth))  # x, y and z move independently
    P = F @ track.covariance @ F.T + Q
    return replace(track, time_s=time_s, mean=F @ track.mean, covariance=P)


def nis(track: Track, point: Array, covariance: Array) -> float:
    """Compute the normalised innovation squared of a measurement (3,) [m], covariance (3, 3)."""
    innovation = point - track.position
    return float(innovation @ np.linalg.solve(track.covariance[:3, :3] + covariance, innovation))


def update(track: Track, point: Array, covariance: Array) -> Track:
    """Update a track by a measurement (3,) [m], covariance (3, 3) [m^2], at its time."""
    P = track.covariance
    gain = np.linalg.solve(P[:3, :3] + covariance, P[:3]).T  # P H^T S^-1, with S symmetric
    keep = np.eye(9)
    keep[:, :3] -= gain
    # Joseph's form stays symmetric and positive where the short one loses digits.
    P = keep @ P @ keep.T + gain @ covariance @ gain.T
    return replace(track, mean=track.mean + gain @ (point - track.position), covariance=P)


def fuse(
    track: Track | None,
    time_s: float,
    point: Array,
    covariance: Array,
    *,
    motion: MotionModel,
    gate_chi2: float = 60.0,
) -> Track:
    """Predict and update a track; start a new one without a track, or if the gate rejects.

    The measurement is a point (3,) [m] with the covariance (3, 3) [m^2] of its total error. The
    gate limits the normalised innovation squared, whose mean is 3 by this covariance; the update
    uses the covariance times the innovation ratio.
    """
    known = InnovationRatio() if track is None else track.ratio
    ratio = update_ratio(known, time_s, point, covariance)
    if track is not None:
        track = predict(track, time_s, jerk_density=motion.jerk_density)
        if nis(track, point, covariance) <= gate_chi2:
            return replace(update(track, point, ratio.value * covariance), ratio=ratio)
    return replace(begin(time_s, point, covariance, motion), ratio=ratio)


def update_ratio(
    ratio: InnovationRatio, time_s: float, point: Array, covariance: Array
) -> InnovationRatio:
    """Update the innovation ratio by a measurement (3,) [m], covariance (3, 3) [m^2]."""
    recent = (*ratio.recent, (time_s, point))[-3:]
    # A parabola follows a motion over 0.2 s.
    if len(ratio.recent) < 3 or time_s - ratio.recent[0][0] > 0.2:
        return replace(ratio, recent=recent)
    times = np.array([time for time, _ in ratio.recent])
    gaps_s = times[:, None] - times + np.eye(3)  # the diagonal must not be zero
    ahead = np.tile(time_s - times, (3, 1)) * (1 - np.eye(3)) + np.eye(3)
    weights = np.prod(ahead / gaps_s, axis=1)  # Lagrange's, to extrapolate the parabola
    gap = point - weights @ np.array([past for _, past in ratio.recent])
    found = gap @ np.linalg.solve(covariance, gap) / (len(gap) * (1 + weights @ weights))
    fade = 1 - 1 / 90  # over 90 measurements, 3 s at 30 Hz
    return InnovationRatio(recent, fade * ratio.total + float(found), fade * ratio.count + 1)
