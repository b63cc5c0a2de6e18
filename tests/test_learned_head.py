"""What self-calibration has learned is a calibration, with its accuracy, of all cameras."""

from dataclasses import replace

import numpy as np
import pytest

from drawn_head import four_cameras
from simulated_frames import (
    NOISE_PX,
    begin,
    head_of,
    postures,
)
from simulated_matches import matches, room
from vergence.findings import void
from vergence.geometry.head import load_head, parameter_names, save_head, wide_pose_in_narrow
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.lens import PINHOLE
from vergence.geometry.se3 import boxminus, pose, rotation
from vergence.self_calibration.filter import learned_head, update
from vergence.self_calibration.frame import estimate_from_matches
from vergence.self_calibration.kalman import predict
from vergence.self_calibration.prior import initial_state
from vergence.stereo.extrinsics import rebase, relative_camera_pose


def test_a_learned_head_is_a_calibration_with_its_accuracy(tmp_path):
    head, rng = head_of(0), np.random.default_rng(0)
    state = begin(head)
    for angles in postures(3, rng):
        seen = matches(head, angles, room(300, rng), noise_px=NOISE_PX, rng=rng)
        state = predict(update(state, estimate_from_matches(state, seen, angles)), 0.3)
    save_head(learned_head(state), tmp_path / "learned.json")
    again = load_head(tmp_path / "learned.json")
    assert again.accuracy is not None
    assert again.accuracy.method == "self-calibration"
    np.testing.assert_allclose(again.accuracy.covariance, state.covariance, rtol=1e-9)
    assert initial_state(again).names == state.names


@pytest.mark.parametrize("stated", [True, False])
def test_other_cameras_follow_the_main_one_of_their_eye(stated):
    """They are screwed to it: what was wrong with its mounting is wrong with theirs."""
    truth, rng, straight = four_cameras(), np.random.default_rng(0), np.zeros(4)
    wrong = pose(rotation(np.radians([0.0, 0.0, 0.6])))
    cameras = {
        name: replace(each, T_eye_cam=wrong @ each.T_eye_cam) if each.eye == "left" else each
        for name, each in truth.cameras.items()
    }
    head = replace(truth, cameras=cameras)
    head = rebase(head, relative_camera_pose(truth, straight), joints=straight)
    if stated:
        names = parameter_names(head)
        C = np.diag(np.array([1.0 if name[-2:] in PINHOLE else 1e-6 for name in names]))
        for axis in ("rx", "ry", "rz"):
            both = [names.index(f"left_{lens}.T_eye_cam.{axis}") for lens in ("wide", "narrow")]
            C[np.ix_(both, both)] += 1e-4
            C[[names.index(f"T_rbase_lbase.{axis}")], [names.index(f"T_rbase_lbase.{axis}")]] = 1e-4
        head = replace(head, accuracy=Accuracy("bundle", names, np.asarray(C, float)))
    state = begin(head)
    for angles in postures(6, rng):
        seen = matches(truth, angles, room(200, rng), noise_px=NOISE_PX, rng=rng)
        state = predict(update(state, estimate_from_matches(state, seen, angles)), 0.3)
    learned = learned_head(state)
    for name in ("left_wide", "left_narrow"):
        mountings = (each.camera(name).T_eye_cam for each in (learned, truth))
        assert np.linalg.norm(boxminus(*mountings)[:3]) < np.radians(0.15)
    apart = (wide_pose_in_narrow(each, "left") for each in (learned, truth))
    assert np.linalg.norm(boxminus(*apart)[:3]) < np.radians(0.05)


def test_what_is_learned_from_a_void_calibration_is_void():
    reason = void("views-contradict", "Readings contradict.")
    start = replace(head_of(0), accuracy=Accuracy("bundle", findings=(reason,)))
    learned = learned_head(begin(start))
    assert learned.accuracy is not None
    assert learned.accuracy.void == (reason,)
