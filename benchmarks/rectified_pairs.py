"""How well rectified pairs align while the eyes move, and how right dense depth is.

    python benchmarks/rectified_pairs.py [--scene room] [--profile paper] [--seed 0] [--pairs 20]

Over the paper's divergent motion, by the joints, by the geometry that both eyes see (after the same
5 s of looking around as in `vergence depth`), and by the true one. Rows are compared by matches of
the rectified images, which no geometry was made of: corners by Shi and Tomasi, tracked from left to
right and back (Lucas and Kanade). Matches farther than 1 px from their row are mismatches where the
geometry is seen or the true one, and are counted apart; by the joints all stay in. Dense depth is
that of `vergence depth`. Last comes the processor time of `rectify`.
"""

# pyright: reportAttributeAccessIssue=false
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import tyro

from vergence.accuracy.motions import eye_angles
from vergence.arrays import Array
from vergence.cli import depth
from vergence.demos.depth import STEP_S
from vergence.demos.experiment import LOOKING
from vergence.geometry.head import HeadCalibration
from vergence.self_calibration.calibrator import initial_visual_geometry, update_geometry
from vergence.stereo.rectification import rectified_image, rectify
from vergence.twin.calibration_sequence import straight_neck
from vergence.twin.head import Twin
from vergence.twin.looking_around import learn_by_looking
from vergence.twin.profile import load_profile
from vergence.twin.simulated_robot import calibrate_twin

CORNERS = 400
BACK_PX = 0.3
"""Largest distance between a corner and its track to the right image and back."""
MISMATCH_PX = 1.0


def row_errors(head: HeadCalibration, joints: Array, left: np.ndarray, right: np.ndarray) -> Array:
    """Return by how much the rows of matches (N,) [px] differ in a rectified pair."""
    pair = rectify(head, joints)
    images = [
        cv2.cvtColor(rectified_image(view, image), cv2.COLOR_RGB2GRAY)
        for view, image in ((pair.left, left), (pair.right, right))
    ]
    inside = cv2.erode(pair.left.seen.astype(np.uint8), np.ones((25, 25), np.uint8))
    corners = cv2.goodFeaturesToTrack(images[0], CORNERS, 0.01, 7, mask=inside)
    follow = partial(cv2.calcOpticalFlowPyrLK, winSize=(15, 15), maxLevel=4)
    there, found, _ = follow(images[0], images[1], corners, corners.copy())
    back, again, _ = follow(images[1], images[0], there, corners.copy())
    good = (found.ravel() > 0) & (again.ravel() > 0)
    good &= np.linalg.norm((back - corners).reshape(-1, 2), axis=1) < BACK_PX
    both = [each.reshape(-1, 2) for each in (corners, there)]
    good &= both[0][:, 0] - both[1][:, 0] > -MISMATCH_PX  # nothing is farther than infinity
    return (both[0] - both[1])[good, 1].astype(float)


def main(
    scene: Literal["room", "sparse", "moving"] = "room",
    profile: str = "paper",
    seed: int = 0,
    pairs: int = 20,
) -> None:
    """Print the rows' errors by the joints and by the true geometry, and those of dense depth."""
    errors: dict[str, list[Array]] = {"joints": [], "seen": [], "truth": []}
    times: list[float] = []
    with Twin(load_profile(profile), seed=seed, scene=scene) as twin:
        head = calibrate_twin(twin, seed).calibration
        geometry = learn_by_looking(twin, initial_visual_geometry(head), run=LOOKING)
        twin.restart(1)
        for k in range(pairs):
            posture = straight_neck(eye_angles("divergent", np.array(STEP_S * k)))
            twin.advance(twin.time_s + 0.5, posture)
            true = twin.true_angles()[3:]
            frame = twin.capture(("left_wide", "right_wide"))
            images = frame.images["left_wide"], frame.images["right_wide"]
            errors["joints"].append(row_errors(head, frame.eye_angles, *images))
            errors["truth"].append(row_errors(twin.truth, true, *images))
            geometry = update_geometry(geometry, frame)
            assert geometry.latest is not None
            now = geometry.latest.head, geometry.latest.joints
            errors["seen"].append(row_errors(*now, *images))
            began = time.thread_time()
            rectify(*now)
            times.append(time.thread_time() - began)
    for name, found in errors.items():
        rows = np.concatenate(found)
        mismatched = np.abs(rows) > (np.inf if name == "joints" else MISMATCH_PX)
        rms, typical = np.sqrt(np.mean(rows[~mismatched] ** 2)), 1.4826 * np.median(np.abs(rows))
        print(f"{name}: {len(rows)} matches, rows rms {rms:.3f} px, by the median {typical:.3f} px")
        print(f"  left out: {100 * mismatched.mean():.1f} %")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        done = depth(
            out=out,
            twin=True,
            profile=profile,
            scene=scene,
            seed=seed,
            pairs=pairs,
            geometry="seen",
        ).data
    every = ("joints", done.joints), ("seen", done.seen), ("truth", done.true_geometry)
    for name, found in every:
        assert found is not None
        print(
            f"{name}: dense depth, median error {100 * found.median_relative:.2f} %, "
            f"wrong by a fifth {100 * found.wrong:.1f} %, of the others "
            f"{100 * found.within_two_std:.0f} % within two std, rows by the true scene "
            f"{found.vertical_rms_px:.3f} px"
        )
    print(f"rectify: {1e3 * np.median(times):.1f} ms a pair in the median")


if __name__ == "__main__":
    tyro.cli(main)
