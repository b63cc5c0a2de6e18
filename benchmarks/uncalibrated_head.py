"""How soon self-calibration learns a head of which only the drawing is known.

Divergent motion, ten pairs a second. Simulated matches of a room: true heads are drawn by the
tolerances of a drawing (`tolerances.UNCALIBRATED`); the noise of the readings is not given.
Rendered: the twin as it was built, with the errors of a profile, looks around for 10 s.

    python benchmarks/uncalibrated_head.py [--heads 20]
    python benchmarks/uncalibrated_head.py --rendered-images [--heads 4] [--profile paper]
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import tyro

from simulated_matches import drawn_head, matches, room, squared_distance, turn_error_deg
from vergence.accuracy.motions import eye_angles
from vergence.geometry.head import HeadCalibration
from vergence.self_calibration.filter import update
from vergence.self_calibration.frame import estimate_frame, estimate_from_matches
from vergence.self_calibration.kalman import predict
from vergence.self_calibration.prior import UNCALIBRATED, initial_state, tolerance_covariance
from vergence.self_calibration.state import FilterState, FrameEstimate
from vergence.twin.head import Twin
from vergence.twin.looking_around import LOOK_STEP_S, look_around
from vergence.twin.model import nominal_head
from vergence.twin.profile import load_profile

NOISE_PX, JOINT_DEG, POINTS, PAIRS = 0.08, 0.15, 500, 100
LENS = "2.8mm"
SHOWN = 0, 3, 5, 10, 20, 50, 99
"""Pairs of which errors are printed."""
Step = tuple[FrameEstimate, FilterState, float]
"""A pair, the state after it, and how wrong the cameras' relative turn is by the pair [deg]."""


def simulated(seed: int, pairs: int = PAIRS) -> tuple[list[Step], HeadCalibration]:
    """Return what became of a drawn head, and this head."""
    rng = np.random.default_rng(seed)
    head = nominal_head(LENS)
    state = replace(initial_state(head), match_scale=1.0)
    drawing = replace(state, covariance=tolerance_covariance(head, state.names, UNCALIBRATED))
    truth, points = drawn_head(drawing, rng), room(POINTS, rng)
    steps = []
    for angles in eye_angles("divergent", LOOK_STEP_S * np.arange(float(pairs))):
        found = matches(truth, angles, points, noise_px=NOISE_PX, rng=rng)
        readings = angles + rng.normal(0, np.radians(JOINT_DEG), 4)
        seen = estimate_from_matches(state, found, readings)
        state = predict(update(state, seen), LOOK_STEP_S)
        steps.append((seen, state, turn_error_deg(seen.head, seen.joints, truth, angles)))
    return steps, truth


def rendered(seed: int, profile: str) -> Iterator[Step]:
    """Yield what became of the twin's drawing."""
    with Twin(load_profile(profile), seed=seed, lens=LENS) as twin:
        state = initial_state(twin.nominal)
        for run in (0, 1):
            for frame in look_around(twin, state.cameras, run=run):
                left, right = (frame.images[name] for name in state.cameras)
                seen = estimate_frame(state, left, right, frame.eye_angles)
                state = predict(update(state, seen), LOOK_STEP_S)
                angles = twin.true_angles()[3:]
                yield seen, state, turn_error_deg(seen.head, seen.joints, twin.truth, angles)


def main(heads: int = 20, rendered_images: bool = False, profile: str = "paper") -> None:
    """Print when each head was reported to be another than its drawing, and errors.

    Args:
        heads: how many; their seeds are 0, 1, ...
        rendered_images: of the twin, in place of simulated matches.
        profile: errors with which the twin was built.
    """
    worst, distances, names = [], [], []
    for seed in range(heads):
        steps, truth = (list(rendered(seed, profile)), None) if rendered_images else simulated(seed)
        reported = [
            k for k, (_, state, _) in enumerate(steps) if state.change == "head uncalibrated"
        ]
        bumped = [k for k, (_, state, _) in enumerate(steps) if state.change == "camera turned"]
        errors = [error for _, _, error in steps]
        worst.append(errors)
        print(
            f"head {seed}: reported {reported}, as a camera that turned {bumped}; wrong by "
            + ", ".join(f"{errors[k]:.3f}" for k in SHOWN)
            + " deg"
        )
        if truth is not None:
            final = steps[-1][1]
            distances.append(squared_distance(final, truth))
            names = final.names
    print(
        "worst of the heads after pairs", *SHOWN, ":", np.max(worst, axis=0)[list(SHOWN)].round(3)
    )
    if distances:
        print(
            f"squared Mahalanobis distance of {len(names)} parameters after the last pair: "
            f"{np.mean(distances):.1f} in the mean, {max(distances):.0f} at most"
        )


if __name__ == "__main__":
    tyro.cli(main)
