"""A camera that was bumped and a head that is not as calibrated are reported and corrected."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from bumped_camera import run
from simulated_frames import (
    JOINT_STD_RAD,
    NOISE_PX,
    begin,
    head_of,
    postures,
)
from simulated_matches import drawn_head, matches, room, squared_distance, turn_error_deg
from vergence.accuracy.motions import eye_angles
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration
from vergence.geometry.parameters import change_named
from vergence.self_calibration.filter import update
from vergence.self_calibration.frame import estimate_from_matches
from vergence.self_calibration.kalman import predict
from vergence.self_calibration.prior import DRIFT, UNCALIBRATED, tolerance_covariance
from vergence.self_calibration.state import FilterState
from vergence.twin.head_model import nominal_head


@pytest.mark.slow
@pytest.mark.parametrize(
    ("axis", "noise_px", "seen_before", "features"),
    [("rx", 0.08, 20, 300), ("ry", 0.08, 20, 300), ("rz", 0.05, 50, 1000)],
)
def test_a_bumped_camera_is_reported_and_corrected(axis, noise_px, seen_before, features):
    """Also of a head that is known so well that a linear model of the bump would be too coarse."""
    head, rng = head_of(2), np.random.default_rng(3)
    truth, state, points = head, begin(head), room(features, rng)
    reported, angles, found = [], np.zeros(4), None
    for k, angles in enumerate(postures(seen_before + 10, rng)):
        if k == seen_before:
            name = f"left_wide.T_eye_cam.{axis}"
            truth = change_named(truth, [name], np.radians([1.0]))
        readings = angles + rng.normal(0, JOINT_STD_RAD, 4)
        seen = matches(truth, angles, points, noise_px=noise_px, rng=rng)
        found = estimate_from_matches(state, seen, readings)
        state = predict(update(state, found), 0.3)
        if state.change == "camera turned":
            reported.append(k)
    assert found is not None
    assert len(reported) == 1
    assert seen_before <= reported[0] < seen_before + 3
    assert turn_error_deg(found.head, found.joints, truth, angles) < 0.1


@pytest.mark.slow
def test_a_camera_that_turns_about_a_joints_axis_is_reported_though_readings_are_noisy():
    """Each frame alone might as well have tilt readings that are wrong."""
    errors, reported, moment = run(36, 3.4, bump=True)
    assert len(reported) == 1
    assert moment <= reported[0] < moment + 3
    assert errors[moment + 10 :].max() < 0.1


def uncalibrated(seed: int) -> tuple[FilterState, HeadCalibration, np.random.Generator]:
    """Return what is known of a head by its drawing, and the head as it was built."""
    state, rng = begin(head_of(seed)), np.random.default_rng(seed)
    C = tolerance_covariance(state.head, state.names, UNCALIBRATED)
    return state, drawn_head(replace(state, covariance=C), rng), rng


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_a_head_that_is_not_as_calibrated_is_reported_and_learned(seed):
    """A drawing in place of a calibration: alone, most pairs contradict what it states."""
    state, truth, rng = uncalibrated(seed)
    points, reported, errors = room(500, rng), [], []
    for k, angles in enumerate(postures(20, rng)):
        readings = angles + rng.normal(0, JOINT_STD_RAD, 4)
        seen = matches(truth, angles, points, noise_px=NOISE_PX, rng=rng)
        found = estimate_from_matches(state, seen, readings)
        state = predict(update(state, found), 0.3)
        errors.append(turn_error_deg(found.head, found.joints, truth, angles))
        reported += [k] * (state.change == "head uncalibrated")
        assert state.change != "camera turned"
    assert len(reported) == 1
    assert reported[0] < 6
    assert max(errors) > 0.5
    assert max(errors[8:]) < 0.1
    assert squared_distance(state, truth) < chi2.isf(1e-4, len(state.names))


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "settled"), [(2, False), (0, True)])
def test_gains_beyond_what_is_stated_are_reported_and_learned(seed, settled):
    """By a tenth of a degree in a posture: few frames show no more than noise of the readings.

    Also after the first frames, which are linearised again, are over.
    """
    rng, state = np.random.default_rng(seed), begin(head_of(seed))
    gains = [k for k, name in enumerate(state.names) if name.endswith("_gain")]
    C = 0.01 * state.covariance
    C[np.ix_(gains, gains)] = 1e-3**2 * np.eye(len(gains))
    state = replace(state, covariance=C, prior_head=state.head, prior_covariance=C, settled=settled)
    truth = change_named(
        drawn_head(state, rng), [state.names[k] for k in gains], rng.choice([-0.02, 0.02], 4)
    )
    points, reported = room(500, rng), []
    for k, angles in enumerate(postures(70, rng)):
        readings = angles + rng.normal(0, JOINT_STD_RAD, 4)
        seen = matches(truth, angles, points, noise_px=NOISE_PX, rng=rng)
        state = predict(update(state, estimate_from_matches(state, seen, readings)), 0.3)
        reported += [k] * (state.change == "head uncalibrated")
    assert len(reported) == 1
    assert squared_distance(state, truth) < chi2.isf(1e-4, len(state.names))


@pytest.mark.slow
def test_slow_motion_of_a_head_with_a_wide_prior_does_not_seem_to_show_its_scale():
    """Linearised at a different head each, frames would together determine what none shows."""
    rng = np.random.default_rng(9)
    head = nominal_head("2.8mm")
    state = begin(head)
    drawing = replace(state, covariance=tolerance_covariance(head, state.names, UNCALIBRATED))
    truth, points = drawn_head(drawing, rng), room(500, rng)
    for angles in eye_angles("divergent", 0.1 * np.arange(65.0)):
        found = matches(truth, angles, points, noise_px=NOISE_PX, rng=rng)
        readings = angles + rng.normal(0, JOINT_STD_RAD, 4)
        state = predict(update(state, estimate_from_matches(state, found, readings)), 0.1)
    assert squared_distance(state, truth) < chi2.isf(1e-4, len(state.names))


def learned(frames: int, *, joint_std_deg: float, told_deg: float) -> FilterState:
    """Return what frames teach of a head that is as calibrated, whose readings are told a noise."""
    head, rng = head_of(0), np.random.default_rng(4)
    state, points = replace(begin(head), reading_std=np.radians(told_deg)), room(300, rng)
    for angles in postures(frames, rng):
        seen = matches(head, angles, points, noise_px=NOISE_PX, rng=rng)
        readings = angles + rng.normal(0, np.radians(joint_std_deg), 4)
        state = predict(update(state, estimate_from_matches(state, seen, readings)), 0.3)
        assert state.change != "camera turned"
        assert state.change != "head uncalibrated"
    return state


def test_what_may_drift_in_a_pause_is_expected_in_the_frame_after_it():
    state, rng = learned(9, joint_std_deg=0.15, told_deg=0.15), np.random.default_rng(5)
    turned = [f"right_wide.T_eye_cam.r{axis}" for axis in "xyz"]
    truth, angles = change_named(head_of(0), turned, np.radians([1.0, -1.0, 1.0])), np.zeros(4)
    seen = matches(truth, angles, room(300, rng), noise_px=NOISE_PX, rng=rng)
    statuses = []
    for hours in (0, 24):
        after = predict(state, 3600.0 * hours)
        found = estimate_from_matches(after, seen, angles)
        statuses.append(found.status)
        error = turn_error_deg(found.head, found.joints, truth, angles)
        assert (error < 0.1) == (hours > 0)
        assert update(after, found).change is None  # alone, no frame reports a change
    assert statuses == ["contradiction", "seen"]


@pytest.mark.parametrize("elapsed_s", [-0.1, np.nan, np.inf])
def test_a_time_between_frames_that_is_none_is_refused(elapsed_s):
    with pytest.raises(VergenceError, match="Frames follow each other after 0 s or more; found "):
        predict(begin(head_of(0)), elapsed_s)


@pytest.mark.slow
def test_readings_that_are_noisier_than_was_told_do_not_make_the_head_seem_better_known():
    told, wrongly = (learned(16, joint_std_deg=0.6, told_deg=deg) for deg in (0.6, 0.15))
    assert wrongly.reading_std == pytest.approx(np.radians(0.6), rel=0.3)
    variances = [np.diag(state.covariance) for state in (told, wrongly)]
    # Where the first frames count by the noise that was told, the least ratio is 0.36.
    assert (variances[1] / variances[0]).min() > 0.7


def board() -> np.ndarray:
    """Return points (300, 3) [m] of a board before the eyes, which fills a part of their views."""
    y, z = np.meshgrid(np.linspace(-0.1, 0.1, 20), np.linspace(-0.08, 0.08, 15))
    return np.stack([np.full(y.size, 0.7), y.ravel(), z.ravel()], axis=1)


def test_a_small_object_reports_no_change_however_well_it_fits_one():
    head, rng, points = head_of(0), np.random.default_rng(6), board()
    state = learned(9, joint_std_deg=0.15, told_deg=0.15)
    truth = change_named(head, ["right_wide.T_eye_cam.rx"], np.radians([2.0]))
    for angles in 0.5 * postures(4, rng):
        seen = matches(truth, angles, points, noise_px=NOISE_PX, rng=rng)
        found = estimate_from_matches(state, seen, angles)
        assert found.status == "contradiction"
        state = predict(update(state, found), 0.3)
        assert state.change != "camera turned"
        assert state.change != "head uncalibrated"


def test_in_a_pause_all_that_is_known_fades():
    state, pause_s = learned(3, joint_std_deg=0.15, told_deg=0.15), 600.0
    later = predict(state, pause_s)
    drift = tolerance_covariance(state.head, state.names, DRIFT) * pause_s / 60
    # Of where it was learned from too: else drift would look like a head that was never calibrated.
    np.testing.assert_allclose(later.covariance, state.covariance + drift)
    np.testing.assert_allclose(later.prior_covariance, state.prior_covariance + drift)
    np.testing.assert_allclose(later.revisits.ages_s, state.revisits.ages_s + pause_s)
    assert later.revisits.independent < 0.5 * state.revisits.independent
    assert later.time_s == state.time_s + pause_s
