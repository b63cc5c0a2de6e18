"""Check the covariance of single frames: the cameras' relative rotation, over many heads.

    python benchmarks/single_frames.py [--lens 2.8mm] [--heads 12] [--factors 0.5 0.75 1 1.5]

Every head is built, and calibrated on rendered images by the paper's method; seven pairs in
parallel and seven in divergent motion are corrected each by itself. Printed is the mean squared
Mahalanobis distance of the rotation per degree of freedom (1 is right), with the prior of the
lenses as it is and inflated by factors: the inflation of what lens fits state was chosen by this.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import tyro

from vergence.accuracy.motions import eye_angles
from vergence.arrays import Array
from vergence.geometry import se3
from vergence.geometry.head import HeadCalibration
from vergence.geometry.parameters import change_named
from vergence.paper.figures import Lens
from vergence.self_calibration.frame import estimate_frame, estimate_from_matches
from vergence.self_calibration.prior import initial_state
from vergence.self_calibration.state import FilterState, FrameEstimate
from vergence.stereo.extrinsics import relative_camera_pose
from vergence.twin.calibration_errors import inject_calibration_error
from vergence.twin.calibration_sequence import paper_calibration
from vergence.twin.head import Twin
from vergence.twin.profile import load_profile

PAIRS = 7
POSTURE_S, STEP_S = 2.3, 1.7
"""From posture to posture in the motion, and on the clock of the twin."""


def less_certain(head: HeadCalibration, factor: float) -> HeadCalibration:
    """Return a calibration whose lenses are so many times as uncertain."""
    assert head.accuracy is not None
    lenses = {
        name: replace(
            fit,
            focal=factor * fit.focal,
            centre_px=factor * fit.centre_px,
            distortion_px=factor * fit.distortion_px,
        )
        for name, fit in head.accuracy.lenses.items()
    }
    return replace(head, accuracy=replace(head.accuracy, lenses=lenses))


def turn_distance(seen: FrameEstimate, T_true: Array) -> float:
    """Return the squared Mahalanobis distance of the cameras' relative rotation, over three."""
    T, P, step = relative_camera_pose(seen.head, seen.joints), len(seen.names), 1e-6
    by = np.zeros((3, len(seen.covariance)))
    for k in range(by.shape[1]):
        head, joints = seen.head, seen.joints.copy()
        if k < P:
            head = change_named(head, [seen.names[k]], np.array([step]))
        else:
            joints[k - P] += step
        by[:, k] = se3.boxminus(relative_camera_pose(head, joints), T)[:3] / step
    error = se3.boxminus(T_true, T)[:3]
    return float(error @ np.linalg.solve(by @ seen.covariance @ by.T, error)) / 3


def distances(twin: Twin, states: list[FilterState]) -> np.ndarray:
    """Return the mean distances (n,) of single frames by what is known before them."""
    cameras, found, time_s = states[0].cameras, [], 0.0
    twin.restart(0)
    for motion in ("parallel", "divergent"):
        for k in range(PAIRS):
            time_s += STEP_S
            posture = twin.posture(eye_angles(motion, np.array(1.0 + k * POSTURE_S)))
            twin.advance(time_s, lambda _, posture=posture: posture)
            frame = twin.capture(cameras)
            T_true = relative_camera_pose(twin.truth, twin.true_angles()[3:], cameras=cameras)
            left, right = (frame.images[name] for name in cameras)
            matches = estimate_frame(states[0], left, right, frame.eye_angles).matches
            seen = [estimate_from_matches(state, matches, frame.eye_angles) for state in states]
            found.append([turn_distance(each, T_true) for each in seen])
    return np.mean(found, axis=0)


def main(
    lens: Lens = "2.8mm", heads: int = 12, factors: tuple[float, ...] = (0.5, 0.75, 1.0, 1.5)
) -> None:
    """Print the mean distances of each head, and of all.

    Args:
        lens: of the wide cameras.
        heads: seeds from 0.
        factors: on the standard deviations of the lenses.
    """
    cv2.setNumThreads(1)
    profile, found = load_profile("paper"), []
    print("factor", *factors)
    for seed in range(heads):
        with Twin(profile, seed=seed, lens=lens) as twin:
            calibrated = paper_calibration(twin, seed).head
            head = inject_calibration_error(calibrated, profile.by_hand)
            priors = [less_certain(head, each) for each in factors]
            states = [initial_state(each, changed="nothing") for each in priors]
            found.append(distances(twin, states))
        print(f"head {seed}:", *np.round(found[-1], 2), flush=True)
    error = np.std(found, axis=0) / np.sqrt(heads)
    print("mean:", *np.round(np.mean(found, axis=0), 2), "+-", *np.round(error, 2))


if __name__ == "__main__":
    tyro.cli(main)
