"""The joint sensors: readings of true joint angles."""

from __future__ import annotations

import numpy as np

from vergence.arrays import Array
from vergence.twin.profile import Joints


def play(angles: Array, width: float, start: Array | None = None) -> Array:
    """Return the angles (T, J) [rad] on the sensor's side of a mechanical play (backlash).

    The sensor follows when the eye reaches either end of the play; after a reversal the eye crosses
    the whole width before the sensor follows.

    Args:
        angles: (T, J) true angles of the eye in order of time [rad].
        width: full width of the play [rad].
        start: (J,) angle on the sensor's side before the first; None: the middle of the play.
    """
    sensed = np.empty_like(angles)
    last = angles[0] if start is None else start
    for k, angle in enumerate(angles):
        last = np.clip(last, angle - width / 2, angle + width / 2)
        sensed[k] = last
    return sensed


def read(sensed: Array, joints: Joints, rng: np.random.Generator) -> Array:
    """Return readings (N, 4) [rad], as EYE_JOINTS, of angles (N, 4) [rad] on the sensor's side."""
    noise = rng.normal(0.0, np.radians(joints.noise_deg), sensed.shape)
    gain = 1 + np.array(joints.gain_percent) / 100
    reading = gain * sensed + np.radians(joints.offset_deg) + noise
    if joints.counts_per_turn:
        step = 2 * np.pi / joints.counts_per_turn
        reading = np.round(reading / step) * step
    return reading
