"""A camera that was bumped and a head that is not as calibrated are reported and corrected."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from simulated_frames import (
    JOINT_STD_RAD,
    NOISE_PX,
    begin,
    head_of,
    postures,
)
from simulated_matches import drawn_head, matches, room, squared_distance, turn_error_deg
from uncalibrated_head import simulated
from vergence.geometry.head import HeadCalibration
from vergence.geometry.parameters import change_named
from vergence.self_calibration.frame import from_matches
from vergence.self_calibration.learning import learn
from vergence.self_calibration.prior import UNCALIBRATED, tolerance_covariance
from vergence.self_calibration.state import SelfCalibration
from vergence.self_calibration.update import evidence_about


@pytest.mark.slow
@pytest.mark.parametrize(
    ("axis", "noise_px", "seen_before", "features"),
    [("rx", 0.08, 40, 500), ("ry", 0.08, 40, 500), ("rz", 0.08, 40, 500), ("rz", 0.05, 80, 1500)],
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
        found = from_matches(state, seen, readings)
        state = learn(state, found, 0.3)
        if state.bumped:
            reported.append(k)
    assert found is not None
    assert len(reported) == 1
    assert seen_before <= reported[0] < seen_before + 3
    assert turn_error_deg(found.head, found.joints, truth, angles) < 0.1


def uncalibrated(seed: int) -> tuple[SelfCalibration, HeadCalibration, np.random.Generator]:
    """Return what is known of a head by its drawing, and the head as it was built."""
    state, rng = begin(head_of(seed)), np.random.default_rng(seed)
    C = tolerance_covariance(state.head, state.names, UNCALIBRATED)
    return state, drawn_head(replace(state, covariance=C), rng), rng


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_head_that_is_not_as_calibrated_is_reported_and_learned(seed):
    """A drawing in place of a calibration: alone, most pairs contradict what it states."""
    state, truth, rng = uncalibrated(seed)
    points, reported, errors = room(500, rng), [], []
    for k, angles in enumerate(postures(20, rng)):
        readings = angles + rng.normal(0, JOINT_STD_RAD, 4)
        seen = matches(truth, angles, points, noise_px=NOISE_PX, rng=rng)
        found = from_matches(state, seen, readings)
        state = learn(state, found, 0.3)
        errors.append(turn_error_deg(found.head, found.joints, truth, angles))
        reported += [k] * state.uncalibrated
        assert not state.bumped
    assert len(reported) == 1
    assert reported[0] < 6
    assert max(errors) > 0.5
    assert max(errors[8:]) < 0.1
    assert squared_distance(state, truth) < chi2.isf(1e-4, len(state.names))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [14])
def test_slow_motion_of_a_head_that_is_hardly_known_does_not_seem_to_show_its_scale(seed):
    """Linearised at a different head each, frames would together determine what none shows."""
    steps, truth = simulated(seed, pairs=65)
    _, state, _ = steps[-1]
    assert squared_distance(state, truth) < chi2.isf(1e-4, len(state.names))


def test_evidence_about_another_head_says_the_same():
    head, rng = head_of(0), np.random.default_rng(0)
    state, angles = begin(head), postures(1, rng)[0]
    seen = matches(head, angles, room(300, rng), noise_px=NOISE_PX, rng=rng)
    says = from_matches(state, seen, angles).evidence
    assert says is not None
    change = np.zeros(len(says.vector))
    change[: len(state.names)] = 1e-5 * rng.normal(size=len(state.names))
    moved = replace(state, head=change_named(head, state.names, change[: len(state.names)]))
    other = evidence_about(moved, says, head)
    # The same change fits best, from where the head is now, and as well.
    expected = says.information @ change
    np.testing.assert_allclose(
        says.vector - other.vector, expected, atol=1e-3 * np.abs(expected).max()
    )
    rest = [
        e.misfit - e.vector @ np.linalg.pinv(says.information) @ e.vector for e in (says, other)
    ]
    assert rest[1] == pytest.approx(rest[0], rel=1e-3)
