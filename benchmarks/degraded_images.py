"""Compare the spread of self-calibrated depth on bad images with that of the joint readings.

    python benchmarks/degraded_images.py [--figures 6 8 9 10 11] [--samples 40] [--seed 0]

Rendered images of the paper's figures are degraded before they are matched: contrast, blur, covered
parts, a near repeated pattern, wrong matches, eyes that expose one after the other, a lens out of
focus. The object's pixels are those of the good images. `learned` has
seen 5 s of good images before, and continues to learn from bad ones.

Printed is the standard deviation of depth over that of the joints (below 1: steadier; bar 1.05),
and for single frames the mean squared Mahalanobis distance of the cameras' relative rotation per
degree of freedom.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import tyro

from single_frames import turn_distance
from vergence.accuracy.motions import eye_angles
from vergence.arrays import Array
from vergence.geometry import se3
from vergence.geometry.camera import project, unproject
from vergence.geometry.head import HeadCalibration
from vergence.paper.comparison import before_looking
from vergence.paper.figures import FIGURES, default_duration_s
from vergence.self_calibration.filter import update
from vergence.self_calibration.frame import estimate_frame, estimate_from_matches, locate_in_frame
from vergence.self_calibration.kalman import predict
from vergence.self_calibration.prior import initial_state
from vergence.self_calibration.state import FilterState
from vergence.stereo.extrinsics import relative_camera_pose
from vergence.stereo.triangulation import triangulate_at
from vergence.twin.calibration_errors import inject_calibration_error
from vergence.twin.calibration_sequence import paper_calibration
from vergence.twin.head import Twin
from vergence.twin.profile import load_profile
from vergence.twin.sensors import with_sensors
from vergence.twin.simulated_robot import learn_by_looking
from vergence.vision.sphere import STD_PX, find_sphere

CAMERAS = ("left_wide", "right_wide")
NEAR_M, SQUARE_M = 0.6, 0.02
"""Distance and square of the near chessboard, which covers a quarter of the left view."""
FINER = 3
"""Rays along each side of a pixel that shows the near chessboard."""
APART_S = 0.005
Images = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Sample:
    """A pair of images of a figure."""

    images: Images
    """(H, W) grey."""
    later: np.ndarray
    """(H, W) the right image, APART_S later."""
    joints: Array
    """(4,) readings."""
    pixels: tuple[Array, Array]
    """(2,) of the object in both."""
    T_rcam_lcam: Array
    """The truth."""


def _low_contrast(sample: Sample) -> Images:
    """Reduce the contrast to 1/16; the noise of the sensor (one grey level) is added afterwards."""
    rng = np.random.default_rng(int(sample.joints[0] * 1e9) % 2**32)
    both = []
    for image in sample.images:
        smooth = cv2.GaussianBlur(image, (0, 0), 0.6).astype(float)
        faint = 128 + (smooth - 128) / 16 + rng.normal(0, 1.0, image.shape)
        both.append(np.clip(np.round(faint), 0, 255).astype(np.uint8))
    return both[0], both[1]


def _quarter(sample: Sample) -> Images:
    left = np.full_like(sample.images[0], 128)
    h, w = left.shape
    left[: h // 2, : w // 2] = sample.images[0][: h // 2, : w // 2]
    return left, sample.images[1]


def _motion_blur(sample: Sample) -> Images:
    left, right = (cv2.filter2D(image, -1, np.full((1, 5), 0.2)) for image in sample.images)
    return left, right


def _right(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Sample], Images]:
    """Change the right image."""
    return lambda sample: (sample.images[0], change(sample.images[1]))


def _chessboard(truth: HeadCalibration) -> Callable[[Sample], Images]:
    """Cover a quarter of the left view by a chessboard fixed to the left eye, seen by both."""
    cameras = [truth.camera(name).intrinsics for name in CAMERAS]

    def change(sample: Sample) -> Images:
        both = []
        for k, (camera, image) in enumerate(zip(cameras, sample.images, strict=True)):
            T = np.eye(4) if k == 0 else se3.inverse(sample.T_rcam_lcam)
            u, v = ((np.arange(FINER * n) + 0.5) / FINER - 0.5 for n in camera.size)
            rays = unproject(camera, np.stack(np.meshgrid(u, v), axis=-1)) @ T[:3, :3].T
            hit = T[:3, 3] + rays * ((NEAR_M - T[2, 3]) / rays[..., 2])[..., None]
            left = project(cameras[0], hit)
            inside = ((left > 0) & (left < np.array(image.shape[::-1]) / 2)).all(axis=-1)
            dark = np.floor(hit[..., :2] / SQUARE_M).astype(int).sum(axis=-1) % 2 == 0
            share, board = (
                values.reshape(image.shape[0], FINER, -1, FINER).mean(axis=(1, 3))
                for values in (inside.astype(float), inside * np.where(dark, 40.0, 210.0))
            )
            both.append(np.round(board + (1 - share) * image).astype(np.uint8))
        return both[0], both[1]

    return change


WRONG_MATCHES = "70 % wrong matches"
WAYS: dict[str, Callable[[Sample], Images]] = {
    "good": lambda sample: sample.images,
    "quarter of the view": _quarter,
    "contrast 1/16": _low_contrast,
    WRONG_MATCHES: lambda sample: sample.images,
    "one eye covered": _right(lambda image: np.full_like(image, 20)),
    "motion blur 5 px": _motion_blur,
    "5 ms apart": lambda sample: (sample.images[0], sample.later),
    "right eye out of focus": _right(lambda image: cv2.GaussianBlur(image, (0, 0), 2.0)),
}
"""All ways but the near chessboard, which depends on the head."""


def taken(twin: Twin, head: HeadCalibration, figure: int, samples: int) -> list[Sample]:
    """Take the samples of a figure."""
    truth, shown = with_sensors(twin.truth, twin.profile.joints), FIGURES[figure]
    twin.restart(figure)
    twin.place_object(np.array(shown.mean_m))

    def command(time_s: float) -> Array:
        return twin.posture(eye_angles(shown.motion, np.array(time_s - 1)))

    twin.advance(0.5, command(1.0))
    gains = np.array([j.gain for eye in ("left", "right") for j in truth.kinematics.eyes[eye]])
    result = []
    for time_s in np.round(np.linspace(0, default_duration_s(shown.motion), samples), 3):
        twin.advance(round(1 + time_s, 3), command)
        frame, angles = twin.capture(CAMERAS), twin.true_angles()[3:]
        left, right = (find_sphere(frame.images[n], head.camera(n).intrinsics) for n in CAMERAS)
        twin.advance(round(1 + time_s + APART_S, 3), command)
        images = *frame.images.values(), twin.capture(CAMERAS[1:]).images[CAMERAS[1]]
        first, second, later = (cv2.cvtColor(i, cv2.COLOR_RGB2GRAY) for i in images)
        T = relative_camera_pose(truth, angles / gains, cameras=CAMERAS)
        result.append(Sample((first, second), later, frame.eye_angles, (left, right), T))
    return result


def compare(
    samples: list[Sample],
    state: FilterState,
    learned: FilterState,
    change: Callable[[Sample], Images],
    step_s: float,
) -> tuple[float, float, float]:
    """Return depth spreads over the joints' (single, learned), and the distance."""
    depths: dict[str, list[float]] = {"joints": [], "single": [], "learned": []}
    distances = []
    for sample in samples:
        left, right = (pixels[None] for pixels in sample.pixels)
        by_joints, _ = triangulate_at(
            state.head, left=left, right=right, joints=sample.joints, cameras=CAMERAS
        )
        depths["joints"].append(by_joints[0, 0])
        for kind, now in (("single", state), ("learned", learned)):
            seen = estimate_frame(now, *change(sample), sample.joints)
            if change is WAYS[WRONG_MATCHES]:
                matches = seen.matches
                rng = np.random.default_rng(len(matches.left))
                wrong = rng.random(len(matches.left)) < 0.7
                off = wrong[:, None] * rng.uniform(-20, 20, (len(wrong), 2))
                seen = estimate_from_matches(
                    now, replace(matches, right=matches.right + off), sample.joints
                )
            at = locate_in_frame(seen, left=left, right=right, pixel_std_px=STD_PX)
            depths[kind].append(at.xyz[0, 0])
            if kind == "single":
                distances.append(turn_distance(seen, sample.T_rcam_lcam))
            else:
                learned = predict(update(now, seen), step_s)
    joints, single, after = (float(np.nanstd(each, ddof=1)) for each in depths.values())
    return single / joints, after / joints, float(np.mean(distances))


def main(figures: tuple[int, ...] = (6, 8, 9, 10, 11), samples: int = 40, seed: int = 0) -> None:
    """Print the spread of depth for each figure and each way.

    Args:
        figures: of the paper.
        samples: of each.
        seed: of the twin.
    """
    profile = load_profile("paper")
    for lens in ("2.8mm", "4.0mm"):
        numbers = [n for n in figures if FIGURES[n].lens == lens]
        if not numbers:
            continue
        with Twin(profile, seed=seed, lens=lens) as twin:
            calibrated = paper_calibration(twin, seed).head
            head = inject_calibration_error(calibrated, profile.by_hand)
            learned = learn_by_looking(twin, before_looking(head), run=100).state
            state = initial_state(head, changed="nothing")
            ways = WAYS | {"near chessboard": _chessboard(twin.truth)}
            for figure in numbers:
                shown = taken(twin, head, figure, samples)
                step_s = default_duration_s(FIGURES[figure].motion) / samples
                for name, change in ways.items():
                    single, after, distance = compare(shown, state, learned, change, step_s)
                    worse = " WORSE" if max(single, after) > 1.05 else ""
                    print(
                        f"Fig. {figure:2d} {name:24s} single {single:.3f} learned {after:.3f} "
                        f"distance {distance:.2f}{worse}",
                        flush=True,
                    )


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
