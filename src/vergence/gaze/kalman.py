"""A moving point, fused over time: a Kalman filter of position, velocity and acceleration.

All quantities are in one fixed frame, and each measurement brings its own covariance (see
`uncertainty.locate`), which in stereo is long along the line of sight. Between
measurements the acceleration changes by white noise in the jerk.

A stated covariance describes the total error of a measurement. The part that differs from frame to
frame can be far smaller: an error of the calibration, or of a joint's gain, is nearly the same in
all frames, and no filter removes it. If it were taken for noise, the filter would trust its own
prediction too much and lag behind the point. The ratio of the observed to the stated variance is
therefore estimated from the measurements themselves (`InnovationRatio`): each is compared with
the parabola through the three before it, which follows any smooth motion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vergence.arrays import Array

GATE_CHI2 = 60.0
"""Normalised innovation squared from which a measurement begins a new track; its mean is 3."""
_MEMORY = 90
"""Measurements over which the innovation ratio is averaged: three seconds at 30 Hz."""
_PRIOR_COUNT = 5.0
"""Weight of the prior that the ratio is 1, in measurements."""
_PARABOLA_S = 0.2
"""Longest time over which a parabola is trusted to follow a motion."""


@dataclass(frozen=True)
class MotionModel:
    """How a point that is tracked usually moves."""

    jerk_density: float = 1.0
    """Spectral density of the jerk [m^2/s^5]: in a second the acceleration changes by the root of
    it. By 1 m/s^2 a point that moves at 0.3 m/s turns round in 0.6 s; less would lag behind."""
    speed_std_m_s: float = 0.3
    """Prior standard deviation of each component of the velocity."""
    acceleration_std_m_s2: float = 1.0
    """Prior standard deviation of each component of the acceleration."""


@dataclass(frozen=True, eq=False)
class Track:
    """The state of a moving point at one time."""

    time_s: float
    mean: Array
    """(9,) position [m], velocity [m/s], acceleration [m/s^2]."""
    covariance: Array
    """(9, 9) of the mean."""

    @property
    def position(self) -> Array:
        """(3,) [m]."""
        return self.mean[:3]

    @property
    def velocity(self) -> Array:
        """(3,) [m/s]."""
        return self.mean[3:6]


def begin(time_s: float, point: Array, covariance: Array, motion: MotionModel) -> Track:
    """Return a track from its first measurement, (3,) [m] with covariance (3, 3) [m^2]."""
    prior = [0.0, motion.speed_std_m_s**2, motion.acceleration_std_m_s2**2]
    P = np.diag(np.repeat(prior, 3))
    P[:3, :3] = covariance
    return Track(time_s, np.concatenate([point, np.zeros(6)]), P)


def predict(track: Track, time_s: float, *, jerk_density: float) -> Track:
    """Return the track at a later time, for a jerk of this spectral density [m^2/s^5]."""
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
    return Track(time_s, F @ track.mean, F @ track.covariance @ F.T + Q)


def nis(track: Track, point: Array, covariance: Array) -> float:
    """Return the normalised innovation squared of a measurement at the track's time.

    The measurement is (3,) [m] with covariance (3, 3) [m^2]; the result is chi-squared, mean 3.
    """
    innovation = point - track.position
    return float(innovation @ np.linalg.solve(track.covariance[:3, :3] + covariance, innovation))


def update(track: Track, point: Array, covariance: Array) -> Track:
    """Return the track after a measurement (3,) [m], covariance (3, 3) [m^2], at its time."""
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
    gate_chi2: float = GATE_CHI2,
    innovation_ratio: float = 1.0,
) -> Track:
    """Return the track after a measurement; a new one where the measurement fails the gate.

    Args:
        track: at an earlier time; None: there is none yet.
        time_s: time of the measurement.
        point: (3,) [m].
        covariance: (3, 3) [m^2], of its total error: the gate uses it as it is.
        motion: of the point.
        gate_chi2: greatest normalised innovation squared of a measurement of this track.
        innovation_ratio: share of the covariance by which the measurement is weighed.
    """
    if track is not None:
        track = predict(track, time_s, jerk_density=motion.jerk_density)
        if nis(track, point, covariance) <= gate_chi2:
            return update(track, point, innovation_ratio * covariance)
    return begin(time_s, point, covariance, motion)


@dataclass(frozen=True, eq=False)
class InnovationRatio:
    """Running estimate of the ratio of observed to stated variance; 1 before any measurement."""

    recent: tuple[tuple[float, Array], ...] = ()
    """Up to three latest measurements: time [s] and point (3,) [m]."""
    total: float = _PRIOR_COUNT
    """Sum of the squared deviations, each relative to its stated variance, fading with age."""
    count: float = _PRIOR_COUNT
    """Number of measurements in the sum, fading with age too."""

    @property
    def value(self) -> float:
        """Observed variance from frame to frame, relative to the stated variance."""
        return self.total / self.count


def update_ratio(
    ratio: InnovationRatio, time_s: float, point: Array, covariance: Array
) -> InnovationRatio:
    """Return the innovation ratio after a later measurement (3,) [m], covariance (3, 3) [m^2]."""
    recent = (*ratio.recent, (time_s, point))[-3:]
    if len(ratio.recent) < 3 or time_s - ratio.recent[0][0] > _PARABOLA_S:
        return replace(ratio, recent=recent)
    times = np.array([time for time, _ in ratio.recent])
    apart = times[:, None] - times + np.eye(3)  # the diagonal must not be zero
    ahead = np.tile(time_s - times, (3, 1)) * (1 - np.eye(3)) + np.eye(3)
    weights = np.prod(ahead / apart, axis=1)  # Lagrange's, to extrapolate the parabola
    gap = point - weights @ np.array([past for _, past in ratio.recent])
    found = gap @ np.linalg.solve(covariance, gap) / (len(gap) * (1 + weights @ weights))
    fade = 1 - 1 / _MEMORY
    return InnovationRatio(recent, fade * ratio.total + float(found), fade * ratio.count + 1)
