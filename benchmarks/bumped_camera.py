"""How soon a camera that is turned in mid-run is reported and corrected, and false reports.

Simulated matches of a room, divergent motion, heads drawn from the prior of a calibration without
covariance; the noise of the readings is not told. The camera turns by one degree about a random
axis, in either eye by turns. Drift turns the left camera slowly all the time.

    python benchmarks/bumped_camera.py [--seeds 20] [--rate-hz 3.4]
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import tyro

from simulated_matches import drawn_head, matches, room
from vergence.accuracy.motions import eye_angles
from vergence.geometry import se3
from vergence.geometry.parameters import change_named
from vergence.geometry.projection import T_rcam_lcam
from vergence.self_calibration.frame import from_matches, start
from vergence.self_calibration.learning import learn
from vergence.twin.model import nominal_head

NOISE_PX, JOINT_DEG, POINTS, DURATION_S = 0.08, 0.15, 500, 60.0
TURN = ("rx", "ry", "rz")


def run(seed: int, rate_hz: float, *, bump: bool, drift_deg_min: float = 0.0):
    """Return errors of the cameras' relative turn (N,) [deg], reported frames, and the bump's."""
    rng = np.random.default_rng(seed)
    state = replace(start(nominal_head("2.8mm")), match_scale=1.0)
    truth, points = drawn_head(state, rng), room(POINTS, rng)
    frames = round(DURATION_S * rate_hz)
    axis = rng.normal(size=3)
    axis *= np.radians(1.0) / np.linalg.norm(axis)
    eye, moment = ("left", "right")[seed % 2], frames // 2
    errors, reported = [], []
    for k, angles in enumerate(eye_angles("divergent", np.arange(frames) / rate_hz)):
        if bump and k == moment:
            truth = change_named(truth, [f"{eye}_wide.T_eye_cam.{name}" for name in TURN], axis)
        step = np.radians(drift_deg_min) / 60 / rate_hz
        truth = change_named(truth, ["left_wide.T_eye_cam.rz"], np.array([step]))
        readings = angles + rng.normal(0, np.radians(JOINT_DEG), 4)
        seen = matches(truth, angles, points, noise_px=NOISE_PX, rng=rng)
        found = from_matches(state, seen, readings)
        state = learn(state, found, 1 / rate_hz)
        T, T_true = T_rcam_lcam(found.head, found.joints), T_rcam_lcam(truth, angles)
        errors.append(np.degrees(np.linalg.norm(se3.boxminus(T, T_true)[:3])))
        reported += [k] * state.bumped
        if bump and k >= moment + 20:
            break
    return np.array(errors), reported, moment


def main(seeds: int = 20, rate_hz: float = 3.4) -> None:
    """Print what became of bumps, of undisturbed runs, and of drift.

    Args:
        seeds: runs of each kind.
        rate_hz: pairs of images a second.
    """
    in_time, corrected, once = 0, 0, 0
    for seed in range(seeds):
        errors, reported, moment = run(seed, rate_hz, bump=True)
        later = [k - moment for k in reported]
        in_time += bool(later) and 0 <= later[0] < 3
        once += len(later) == 1
        corrected += bool((errors[moment + 10 :] < 0.1).all())
        print(f"bump, seed {seed}: reported {later}, error after 10: {errors[moment + 10]:.4f} deg")
    print(f"{in_time} of {seeds} reported within 3 frames, {once} once, {corrected} corrected")
    for name, drift in (("undisturbed", 0.0), ("0.1 degrees a minute", 0.1)):
        runs = [run(seed, rate_hz, bump=False, drift_deg_min=drift) for seed in range(seeds)]
        worst = np.mean([np.sqrt(np.mean(errors[-30:] ** 2)) for errors, _, _ in runs])
        count = sum(len(reported) for _, reported, _ in runs)
        print(f"{name}: {count} reports in {seeds} runs, last 30 frames {worst:.4f} deg rms")


if __name__ == "__main__":
    tyro.cli(main)
