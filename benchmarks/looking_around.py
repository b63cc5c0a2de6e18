"""What five seconds of looking around teach, by how fast the eyes move, and if something is late.

Simulated matches of a room, divergent motion, ten pairs a second; heads drawn from the prior of a
calibration without covariance, the noise of the readings not given. In some runs the right eye sees
later than the left one and the readings, in others the readings are older than both images. Printed
is how wrong the learned head has the turn of the cameras to each other, at postures all over the
motion, given the true angles there.

    python benchmarks/looking_around.py [--heads 12]
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import tyro

from simulated_matches import drawn_head, matches, room, squared_distance, turn_error_deg
from vergence.accuracy.motions import PERIOD_S, eye_angles
from vergence.self_calibration.filter import update
from vergence.self_calibration.frame import estimate_from_matches
from vergence.self_calibration.kalman import predict
from vergence.self_calibration.prior import initial_state
from vergence.twin.looking_around import FASTER, LOOK_STEP_S, look_times
from vergence.twin.model import nominal_head

NOISE_PX, JOINT_DEG, POINTS, POSTURES = 0.08, 0.15, 500, 40
SPEEDS = 1.0, 2.0, FASTER
LATE_MS = (0.0, 0.0), (5.0, 0.0), (15.0, 0.0), (0.0, 5.0), (0.0, 20.0)
"""By how much the right image is later, and the readings are older."""


def learned(seed: int, speed: float, late_s: float, old_s: float) -> tuple[float, float]:
    """Return the error [deg], rms, and the squared Mahalanobis distance by parameter."""
    rng = np.random.default_rng(seed)
    first = initial_state(nominal_head("2.8mm"), changed="nothing")
    state = replace(first, match_scale=1.0)
    truth, points = drawn_head(state, rng), room(POINTS, rng)
    for time_s in look_times():
        moments = speed * (time_s + np.array([0.0, late_s, -old_s]))
        angles, later, before = eye_angles("divergent", moments)
        seen_at = np.concatenate([angles[:2], later[2:]])
        found = matches(truth, seen_at, points, noise_px=NOISE_PX, rng=rng)
        readings = before + rng.normal(0, np.radians(JOINT_DEG), 4)
        state = predict(update(state, estimate_from_matches(state, found, readings)), LOOK_STEP_S)
    postures = eye_angles("divergent", rng.uniform(0, PERIOD_S["divergent"], POSTURES))
    errors = [turn_error_deg(state.head, each, truth, each) for each in postures]
    distance = squared_distance(state, truth) / len(state.names)
    return float(np.sqrt(np.mean(np.square(errors)))), distance


def main(heads: int = 12) -> None:
    """Print the means of some heads.

    Args:
        heads: how many; their seeds are 0, 1, ...
    """
    for (late_ms, old_ms), speed in product(LATE_MS, SPEEDS):
        late = 1e-3 * late_ms, 1e-3 * old_ms
        found = np.array([learned(seed, speed, *late) for seed in range(heads)])
        error, distance = found.mean(axis=0)
        print(
            f"{speed:.1f} times as fast, the right eye {late_ms:.0f} ms late, readings {old_ms:.0f}"
            f" ms old: turn wrong by {error:.3f} deg, squared Mahalanobis distance {distance:.2f} "
            "by parameter",
            flush=True,
        )


if __name__ == "__main__":
    tyro.cli(main)
