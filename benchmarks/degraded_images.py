"""How steady self-calibrated depth stays on bad images, beside that of the joint readings.

    python benchmarks/degraded_images.py [--figures 6 8 9 10 11] [--samples 40] [--seed 0]

Rendered images of the paper's figures, made worse before anything is matched: contrast, exposure
and blur, parts that are covered, a repeated pattern at a near depth, wrong matches, eyes that
expose one after the other, JPEG, dust, a lens that is out of focus. The object's pixels are those
of the good images, so that the geometry alone makes the difference. `learned` has seen 5 s of good
images before, and goes on learning from bad ones.

Printed is the standard deviation of depth over that of the joints (below 1: steadier; bar 1.05),
and of single frames the mean squared error of the cameras' turn to each other over its stated
variance (3 degrees of freedom, each counts one third).
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import tyro

from degraded import (
    CAMERAS,
    Sample,
    apart,
    blurred,
    chessboard,
    compressed,
    contrast,
    covered,
    darker,
    dusty,
    quarter,
    unfocused,
)
from vergence.accuracy.motions import eye_angles
from vergence.arrays import Array
from vergence.geometry import se3
from vergence.geometry.head import HeadCalibration
from vergence.geometry.parameters import change_named
from vergence.paper.comparison import before_looking
from vergence.paper.figures import FIGURES, default_duration_s
from vergence.self_calibration.filter import update
from vergence.self_calibration.frame import estimate_frame, estimate_from_matches, locate_in_frame
from vergence.self_calibration.kalman import predict
from vergence.self_calibration.prior import initial_state
from vergence.self_calibration.state import FilterState, FrameEstimate
from vergence.stereo.extrinsics import T_rcam_lcam
from vergence.stereo.triangulation import triangulate_at
from vergence.twin.calibration_errors import inject_calibration_error
from vergence.twin.calibration_sequence import paper_calibration, straight_neck
from vergence.twin.head import Twin
from vergence.twin.looking_around import LOOK_S, learn_by_looking
from vergence.twin.profile import load_profile
from vergence.twin.sensors import with_sensors
from vergence.vision.sphere import STD_PX, find_sphere

APART_S = 0.005


def mismatched(state: FilterState, sample: Sample) -> FrameEstimate:
    """Estimate from matches of which seven in ten are wrong."""
    good = estimate_frame(state, *sample.images, sample.joints).matches
    rng = np.random.default_rng(len(good.left))
    wrong = rng.random(len(good.left)) < 0.7
    right = good.right.copy()
    right[wrong] += rng.uniform(-20, 20, (int(wrong.sum()), 2))
    return estimate_from_matches(state, replace(good, right=right), sample.joints)


def taken(twin: Twin, head: HeadCalibration, truth: HeadCalibration, figure: int, samples: int):
    """Return the samples of a figure."""
    shown = FIGURES[figure]
    twin.restart(figure)
    twin.place_object(np.array(shown.mean_m))

    def command(time_s: float) -> Array:
        return straight_neck(eye_angles(shown.motion, np.array(time_s - 1)))

    twin.advance(0.5, command(1.0))
    gains = np.array([j.gain for eye in ("left", "right") for j in truth.kinematics.eyes[eye]])
    found = []
    for time_s in np.round(np.linspace(0, default_duration_s(shown.motion), samples), 3):
        twin.advance(round(1 + time_s, 3), command)
        frame, angles = twin.capture(CAMERAS), twin.true_angles()[3:]
        pixels = [find_sphere(frame.images[n], head.camera(n).intrinsics) for n in CAMERAS]
        twin.advance(round(1 + time_s + APART_S, 3), command)
        later = twin.capture(CAMERAS[1:]).images[CAMERAS[1]]
        grey = [
            cv2.cvtColor(i, cv2.COLOR_RGB2GRAY)
            for i in (*(frame.images[n] for n in CAMERAS), later)
        ]
        T = T_rcam_lcam(truth, angles / gains, cameras=CAMERAS)
        found.append(
            Sample((grey[0], grey[1]), grey[2], frame.eye_angles, (pixels[0], pixels[1]), T)
        )
    return found


def turn_distance(seen: FrameEstimate, T_true: Array) -> float:
    """Return the squared Mahalanobis distance of the cameras' turn to each other, per degree."""
    T, P, step = T_rcam_lcam(seen.head, seen.joints), len(seen.names), 1e-6
    by = np.zeros((3, len(seen.covariance)))
    for k in range(by.shape[1]):
        head, joints = seen.head, seen.joints.copy()
        if k < P:
            head = change_named(head, [seen.names[k]], np.array([step]))
        else:
            joints[k - P] += step
        by[:, k] = se3.boxminus(T_rcam_lcam(head, joints), T)[:3] / step
    error = se3.boxminus(T_true, T)[:3]
    return float(error @ np.linalg.solve(by @ seen.covariance @ by.T, error)) / 3


def compare(
    samples: list[Sample], state: FilterState, learned: FilterState, change, step_s: float
) -> tuple[float, float, float, float]:
    """Return depth spreads over the joints' (single, learned), share seen, and the distance."""
    depths, distances, seen_share = {"joints": [], "single": [], "learned": []}, [], []
    for sample in samples:
        left, right = (pixels[None] for pixels in sample.pixels)
        by_joints, _ = triangulate_at(
            state.head, left=left, right=right, joints=sample.joints, cameras=CAMERAS
        )
        depths["joints"].append(by_joints[0, 0])
        for name, now in (("single", state), ("learned", learned)):
            if change is mismatched:
                seen = mismatched(now, sample)
            else:
                seen = estimate_frame(now, *change(sample), sample.joints)
            at = locate_in_frame(seen, left=left, right=right, pixel_std_px=STD_PX)
            depths[name].append(at.xyz[0, 0])
            if name == "single":
                distances.append(turn_distance(seen, sample.T_rcam_lcam))
                seen_share.append(seen.status == "seen")
            else:
                learned = predict(update(now, seen), step_s)
    joints, single, after = (float(np.nanstd(each, ddof=1)) for each in depths.values())
    return single / joints, after / joints, float(np.mean(seen_share)), float(np.mean(distances))


def report(
    head: HeadCalibration,
    truth: HeadCalibration,
    figure: int,
    samples: list[Sample],
    learned: FilterState,
    chosen: tuple[str, ...],
) -> None:
    """Print a line for each of the chosen ways in which images are bad; none chosen: for all."""
    ways = {
        "good": lambda s: s.images,
        "quarter of the view": quarter,
        "contrast 1/8": contrast(1 / 8),
        "contrast 1/16": contrast(1 / 16),
        "70 % wrong matches": mismatched,
        "near chessboard": chessboard(truth),
        "one eye covered": covered,
        "right eye 0.6 as bright": darker,
        "motion blur 5 px": blurred,
        "5 ms apart": apart,
        "JPEG of quality 50": compressed,
        "dust": dusty,
        "right eye out of focus": unfocused,
    }
    step_s = default_duration_s(FIGURES[figure].motion) / len(samples)
    for name in chosen or ways:
        change = ways[name]
        single, after, share, distance = compare(
            samples, initial_state(head, changed="nothing"), learned, change, step_s
        )
        worse = " WORSE" if max(single, after) > 1.05 else ""
        print(
            f"Fig. {figure:2d} {name:24s} single {single:.3f} learned {after:.3f} "
            f"seen {share:.2f} distance {distance:.2f}{worse}",
            flush=True,
        )


def main(
    figures: tuple[int, ...] = (6, 8, 9, 10, 11),
    samples: int = 40,
    seed: int = 0,
    ways: tuple[str, ...] = (),
) -> None:
    """Print how steady depth stays.

    Args:
        figures: of the paper.
        samples: of each.
        seed: of the twin.
        ways: names, as printed, of those in which images are bad; none: all.
    """
    profile = load_profile("paper")
    for lens in ("2.8mm", "4.0mm"):
        numbers = [n for n in figures if FIGURES[n].lens == lens]
        if not numbers:
            continue
        with Twin(profile, seed=seed, lens=lens) as twin:
            found = paper_calibration(twin, seed)
            head = inject_calibration_error(found.head, profile.by_hand, lens)
            learned = learn_by_looking(twin, before_looking(head), run=100).state
            print(f"{lens}: {LOOK_S:.0f} s of good images seen")
            truth = with_sensors(twin.truth, twin.profile.joints)
            for figure in numbers:
                taken_now = taken(twin, head, truth, figure, samples)
                report(head, truth, figure, taken_now, learned, ways)


if __name__ == "__main__":
    tyro.cli(main)
