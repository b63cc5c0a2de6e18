"""A moving point, fused over time: a Kalman filter of position, velocity and acceleration.

All are in one fixed frame; each measurement brings its own covariance (see
`uncertainty.locate_with_covariance`), which in stereo is long along the line of sight. Between
measurements the motion changes as white noise in the jerk, or in the acceleration, would change
it. With neither jerk nor a first acceleration it is the filter of constant velocity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vergence.arrays import Array

_SAME_AXIS = np.tile(np.eye(3), (3, 3))  # x, y and z move each for itself, and alike


@dataclass(frozen=True, eq=False)
class Track:
    """What is known of a point at one time."""

    time_s: float
    mean: Array
    """(9,) position [m], velocity [m/s], acceleration [m/s^2]."""
    covariance: Array
    """(9, 9)."""

    @property
    def position(self) -> Array:
        """(3,) [m]."""
        return self.mean[:3]

    @property
    def velocity(self) -> Array:
        """(3,) [m/s]."""
        return self.mean[3:6]


def begin(
    time_s: float,
    point: Array,
    covariance: Array,
    *,
    speed_std_m_s: float,
    acceleration_std_m_s2: float = 0.0,
) -> Track:
    """Return a track of one measurement, of whose motion nothing is known but its usual size.

    Args:
        time_s: of the measurement.
        point: (3,) [m].
        covariance: (3, 3) of the point [m^2].
        speed_std_m_s: of each component of the velocity.
        acceleration_std_m_s2: of each component of the acceleration.
    """
    P = np.diag(np.repeat([0.0, speed_std_m_s**2, acceleration_std_m_s2**2], 3))
    P[:3, :3] = covariance
    return Track(time_s, np.concatenate([point, np.zeros(6)]), P)


def predict(
    track: Track, time_s: float, *, acceleration_density: float = 0.0, jerk_density: float = 0.0
) -> Track:
    """Return the track at a later time.

    Args:
        track: as it was.
        time_s: not before the track's.
        acceleration_density: spectral density of white noise in the acceleration [m^2/s^3]: the
            variance that each component of the velocity gains by it in a second.
        jerk_density: the same of the jerk [m^2/s^5] and the acceleration.
    """
    dt = time_s - track.time_s
    motion = np.array([[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]])
    by_jerk = np.array(
        [
            [dt**5 / 20, dt**4 / 8, dt**3 / 6],
            [dt**4 / 8, dt**3 / 3, dt**2 / 2],
            [dt**3 / 6, dt**2 / 2, dt],
        ]
    )
    by_acceleration = np.array([[dt**3 / 3, dt**2 / 2, 0], [dt**2 / 2, dt, 0], [0, 0, 0]])
    growth = jerk_density * by_jerk + acceleration_density * by_acceleration
    F, Q = (M.repeat(3, axis=0).repeat(3, axis=1) * _SAME_AXIS for M in (motion, growth))
    return Track(time_s, F @ track.mean, F @ track.covariance @ F.T + Q)


def surprise(track: Track, point: Array, covariance: Array) -> float:
    """Return the squared Mahalanobis distance of a measurement; 3 in the mean if all is right.

    Args:
        track: at the time of the measurement.
        point: (3,) [m].
        covariance: (3, 3) of the point [m^2].
    """
    gap = point - track.position
    return float(gap @ np.linalg.solve(track.covariance[:3, :3] + covariance, gap))


def update(track: Track, point: Array, covariance: Array) -> Track:
    """Return the track after a measurement at its own time.

    Args:
        track: at the time of the measurement.
        point: (3,) [m].
        covariance: (3, 3) of the point [m^2].
    """
    P = track.covariance
    gain = np.linalg.solve(P[:3, :3] + covariance, P[:3]).T  # P H^T S^-1, with S symmetric
    keep = np.eye(9)
    keep[:, :3] -= gain
    # Joseph's form stays symmetric and positive where the short one loses digits.
    P = keep @ P @ keep.T + gain @ covariance @ gain.T
    return replace(track, mean=track.mean + gain @ (point - track.position), covariance=P)
