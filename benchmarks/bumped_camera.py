"""How soon a camera that is turned in mid-run is reported and corrected, and false reports.

Simulated matches of a room, divergent motion, heads drawn from the prior of a calibration without
covariance; the noise of the readings is not told. The camera turns by one degree about a random
axis, in either eye by turns. Drift turns the left camera slowly all the time.

    python benchmarks/bumped_camera.py [--seeds 20] [--rate-hz 3.4]
    python benchmarks/bumped_camera.py --rendered [--seed 1]

Rendered: the twin looks around in divergent motion, ten pairs a second; after 2.8 s, and in other
runs after 5.3 s, the images of one camera are turned by one degree. Both lenses, both eyes, about
x, y and z of the camera.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import get_args

import cv2
import numpy as np
import tyro

from simulated_matches import drawn_head, matches, room, turn_error_deg
from vergence.accuracy.motions import eye_angles
from vergence.geometry.camera import normalise, project
from vergence.geometry.head import HeadCalibration
from vergence.geometry.parameters import change_named
from vergence.paper.figures import Lens
from vergence.self_calibration.filter import update
from vergence.self_calibration.frame import estimate_frame, estimate_from_matches
from vergence.self_calibration.kalman import predict
from vergence.self_calibration.prior import initial_state
from vergence.twin.calibration_errors import inject_calibration_error
from vergence.twin.calibration_sequence import paper_calibration
from vergence.twin.head import Twin
from vergence.twin.head_model import nominal_head
from vergence.twin.profile import load_profile
from vergence.twin.simulated_robot import LOOK_STEP_S, look_around

NOISE_PX, JOINT_DEG, POINTS, DURATION_S = 0.08, 0.15, 500, 60.0
TURN = ("rx", "ry", "rz")
MOMENTS = 28, 53
"""Pair of rendered images from which a camera is turned."""


def run(seed: int, rate_hz: float, *, bump: bool, drift_deg_min: float = 0.0):
    """Return errors of the cameras' relative turn (N,) [deg], reported frames, and the bump's."""
    rng = np.random.default_rng(seed)
    state = replace(initial_state(nominal_head("2.8mm")), match_scale=1.0)
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
        found = estimate_from_matches(state, seen, readings)
        state = predict(update(state, found), 1 / rate_hz)
        errors.append(turn_error_deg(found.head, found.joints, truth, angles))
        reported += [k] * (state.change == "camera turned")
        if bump and k >= moment + 20:
            break
    return np.array(errors), reported, moment


def turned(image: np.ndarray, before: HeadCalibration, after: HeadCalibration, name: str):
    """Return the image that a camera takes after it was turned in its eye."""
    camera, height, width = before.camera(name).intrinsics, *image.shape[:2]
    v, u = np.mgrid[:height, :width].astype(float)
    rays = np.ones((height, width, 3))
    rays[..., :2] = normalise(camera, np.stack([u, v], axis=-1))
    R_before_after = before.camera(name).T_eye_cam[:3, :3].T @ after.camera(name).T_eye_cam[:3, :3]
    at = project(camera, rays @ R_before_after.T).astype(np.float32)
    return cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


def rendered_bumps(seed: int) -> None:
    """Print what became of bumps in rendered images."""
    profile, results = load_profile("paper"), []
    for lens in get_args(Lens):
        with Twin(profile, seed=seed, lens=lens) as twin:
            found = paper_calibration(twin, seed)
            head = inject_calibration_error(found.head, profile.by_hand)
            first = initial_state(head, changed="nothing")
            pair = first.cameras
            frames = [
                (f, twin.true_angles()[3:])
                for run in (100, 101)
                for f in look_around(twin, pair, run=run)
            ]
        for moment, name, axis in product(MOMENTS, pair, TURN):
            k, change = pair.index(name), [np.radians(1.0)]
            bumped = change_named(twin.truth, [f"{name}.T_eye_cam.{axis}"], np.array(change))
            state, reported, errors = first, [], list[float]()
            for n, (frame, angles) in enumerate(frames[: moment + 22]):
                truth = bumped if n >= moment else twin.truth
                images = [frame.images[each] for each in pair]
                if n >= moment:
                    images[k] = turned(images[k], twin.truth, bumped, name)
                seen = estimate_frame(state, images[0], images[1], frame.eye_angles)
                state = predict(update(state, seen), LOOK_STEP_S if n else 0.0)
                errors.append(turn_error_deg(seen.head, seen.joints, truth, angles, pair))
                reported += [n - moment] * (state.change == "camera turned")
            worst = max(errors[moment + 10 :])
            in_time = bool(reported) and 0 <= reported[0] < 3
            results.append((moment, in_time, worst < 0.1))
            seconds = moment * LOOK_STEP_S
            print(
                f"{lens}, {name}, {axis}, after {seconds:.1f} s: reported {reported}, then "
                f"{worst:.3f} deg at most"
            )
    for moment in MOMENTS:
        these = np.array([each[1:] for each in results if each[0] == moment])
        print(
            f"after {moment * LOOK_STEP_S:.1f} s: {these[:, 0].sum()} of {len(these)} reported "
            f"within 3 frames, {these[:, 1].sum()} corrected"
        )


def main(seeds: int = 20, rate_hz: float = 3.4, rendered: bool = False, seed: int = 1) -> None:
    """Print what became of bumps, of undisturbed runs, and of drift.

    Args:
        seeds: runs of each kind, of simulated matches.
        rate_hz: pairs of images a second.
        rendered: bumps in rendered images instead.
        seed: of the twin that is rendered.
    """
    if rendered:
        rendered_bumps(seed)
        return
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
