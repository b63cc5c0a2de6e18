"""Processor time of self-calibrating a pair of images, step by step, beside one call of a tracker.

    python benchmarks/self_calibration_time.py [--pairs 40] [--scene room] [--seed 0]

Divergent motion. "tracking" is learning in a frame in which the features of the keyframe are found
again. The reference is one call of OpenCV's pyramidal Lucas-Kanade tracker on the same
images, with the features that were matched and windows of 11 px. Times are those of the thread, so
that other programs hardly count.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import tyro

from vergence.accuracy.motions import eye_angles
from vergence.self_calibration.filter import update
from vergence.self_calibration.frame import estimate_from_matches
from vergence.self_calibration.kalman import predict
from vergence.self_calibration.prior import initial_state
from vergence.stereo.extrinsics import relative_camera_pose
from vergence.twin.calibration_errors import inject_calibration_error
from vergence.twin.calibration_sequence import paper_calibration
from vergence.twin.head import Twin
from vergence.twin.profile import load_profile
from vergence.twin.scene import Scene
from vergence.vision.matching.scene_features import match_scene

STEP_S = 0.1


def main(pairs: int = 40, scene: Scene = "room", seed: int = 0) -> None:
    """Print the median of each step, in milliseconds and as a multiple of the reference.

    Args:
        pairs: of images.
        scene: what the head looks at.
        seed: of the twin.
    """
    cv2.setNumThreads(1)
    spent: dict[str, list[float]] = {}

    def timed(name: str, step: Callable[[], Any]) -> Any:
        begin = time.thread_time()
        result = step()
        spent.setdefault(name, []).append(1e3 * (time.thread_time() - begin))
        return result

    profile, lens = load_profile("paper"), "2.8mm"
    with Twin(profile, seed=seed, lens=lens, scene=scene) as twin:
        head = paper_calibration(twin, seed).head
        state = initial_state(inject_calibration_error(head, profile.by_hand))
        twin.restart(0)
        cameras = [state.head.camera(name).intrinsics for name in state.cameras]
        for k in range(pairs):
            angles = twin.posture(eye_angles("divergent", np.array(k * STEP_S)))
            twin.advance((k + 1) * STEP_S, lambda _, target=angles: target)
            frame = twin.capture(state.cameras)
            images = [frame.images[name] for name in state.cameras]
            T = relative_camera_pose(state.head, frame.eye_angles, cameras=state.cameras)
            found = timed(
                "matching",
                lambda images=images, T=T: match_scene(
                    images[0],
                    images[1],
                    left_camera=cameras[0],
                    right_camera=cameras[1],
                    T_rcam_lcam=T,
                ),
            )
            now, joints = state, frame.eye_angles
            seen = timed(
                "estimate",
                lambda now=now, found=found, j=joints, both=(images[0], images[1]): (
                    estimate_from_matches(now, found, j, images=both)
                ),
            )
            state = timed("learning", lambda now=now, seen=seen: predict(update(now, seen), STEP_S))
            before, after = now.keyframe, state.keyframe
            if before is not None and after is not None and after.images is not before.images:
                spent.setdefault("tracking", []).append(spent["learning"].pop())
            grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in images]
            at = found.left.astype(np.float32)
            timed(
                "one tracking",
                lambda grey=grey, at=at: cv2.calcOpticalFlowPyrLK(
                    grey[0], grey[1], at, at.copy(), winSize=(11, 11), maxLevel=3
                ),
            )
    medians = {name: float(np.median(times)) for name, times in spent.items()}
    reference = medians.pop("one tracking")
    print(f"one tracking: {reference:.1f} ms of processor time")
    for name, each in medians.items():
        print(f"{name:9s} {each:5.1f} ms, {each / reference:5.1f} trackings")
    pair = medians["matching"] + medians["estimate"]
    learning = spent["learning"] + spent.get("tracking", [])
    print(
        f"a pair {pair:.1f} ms, with learning {pair + float(np.median(learning)):.1f} ms in the "
        f"median and {pair + float(np.mean(learning)):.1f} ms in the mean; bars 25 and 33 ms"
    )


if __name__ == "__main__":
    tyro.cli(main)
