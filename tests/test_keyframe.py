"""The keyframe, from which features are tracked: which one it is, and how well it is known."""

import numpy as np
from scipy.stats import chi2

from simulated_frames import CAMERAS, JOINT_STD_RAD, NOISE_PX, begin, head_of, postures
from simulated_matches import drawn_head, matches, room
from test_changed_head import learned
from vergence.geometry.parameters import change_named
from vergence.self_calibration.filter import update
from vergence.self_calibration.frame import estimate_from_matches
from vergence.self_calibration.kalman import predict
from vergence.self_calibration.residuals import epipolar_residuals, pair_coordinates


def test_a_keyframe_stays_until_the_eyes_have_turned():
    head, rng = head_of(0), np.random.default_rng(0)
    points, state = room(400, rng), begin(head)
    kept = []
    for pan in np.radians([0.0, 3.0, 6.0, 9.0, 12.0]):
        joints = np.array([pan, 0.0, pan, 0.0])
        seen = matches(head, joints, points, noise_px=NOISE_PX, rng=rng)
        state = predict(update(state, estimate_from_matches(state, seen, joints)), 0.5)
        assert state.keyframe is not None
        kept.append(np.degrees(state.keyframe.joints[0]))
    np.testing.assert_allclose(kept, [0, 0, 0, 9, 9], atol=0.5)


def test_the_joints_of_a_keyframe_are_known_better_with_every_frame_after_it():
    """While the eyes hardly turn; how they stand to each other then, by its covariance."""
    nominal, distance, shares = head_of(1), 0.0, []
    apart = np.array([[1.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, -1.0]])
    for seed in range(10):
        rng = np.random.default_rng(seed)
        state, first, then = begin(nominal), None, np.zeros(4)
        truth, points = drawn_head(state, rng), room(300, rng)
        for angles in rng.uniform(-0.04, 0.04, (12, 4)):
            readings = angles + rng.normal(0, JOINT_STD_RAD, 4)
            seen = matches(truth, angles, points, noise_px=NOISE_PX, rng=rng)
            state = predict(update(state, estimate_from_matches(state, seen, readings)), 0.5)
            if first is None:
                first, then = state.keyframe, angles
        assert first is not None
        assert state.keyframe is not None
        np.testing.assert_array_equal(state.keyframe.readings, first.readings)
        C = apart @ state.keyframe.covariance @ apart.T
        shares.append(np.diag(C) / np.diag(apart @ first.covariance @ apart.T))
        error = apart @ (state.keyframe.joints - then)
        distance += float(error @ np.linalg.solve(C, error))
    assert np.mean(shares) < 0.5
    assert distance < chi2.isf(1e-4, 2 * 10)


def test_the_features_of_a_keyframe_fit():
    head, rng = head_of(0), np.random.default_rng(0)
    state, angles = begin(head), postures(1, rng)[0]
    seen = matches(head, angles, room(300, rng), noise_px=NOISE_PX, rng=rng, outliers=0.4)
    key = update(state, estimate_from_matches(state, seen, angles)).keyframe
    assert key is not None
    assert len(key.pixels[0]) > 50
    pair = pair_coordinates(head, state.names, angles, CAMERAS)
    off = epipolar_residuals(pair.lenses, pair.T_second_first, *key.pixels).residuals
    assert np.abs(off).max() < 6 * NOISE_PX


def test_a_frame_that_contradicts_leaves_no_keyframe():
    state, rng = learned(9, joint_std_deg=0.15, told_deg=0.15), np.random.default_rng(5)
    turned = [f"right_wide.T_eye_cam.r{axis}" for axis in "xyz"]
    truth, angles = change_named(head_of(0), turned, np.radians([1.0, -1.0, 1.0])), np.zeros(4)
    seen = matches(truth, angles, room(300, rng), noise_px=NOISE_PX, rng=rng)
    found = estimate_from_matches(state, seen, angles)
    assert found.status == "contradiction"
    assert state.keyframe is not None
    assert update(state, found).keyframe is None
