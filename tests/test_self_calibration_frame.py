"""One frame of self-calibration that shows little: how far it is believed, and what is left."""

import numpy as np
import pytest

from simulated_frames import JOINT_STD_RAD, NOISE_PX, begin, head_of, postures
from simulated_matches import matches, room, turn_error_deg
from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration
from vergence.self_calibration.frame import estimate_from_matches
from vergence.self_calibration.state import FilterState, FrameEstimate
from vergence.vision.matching.scene_features import Matches


def seen_at_random(
    seed: int, outliers: float = 0.0
) -> tuple[HeadCalibration, Array, Array, Matches]:
    """Return a head, its angles and readings (4,), and about 2000 matches."""
    head, rng = head_of(seed), np.random.default_rng(seed)
    angles = postures(1, rng)[0]
    readings = angles + rng.normal(0, JOINT_STD_RAD, 4)
    seen = matches(head, angles, room(3000, rng), noise_px=NOISE_PX, rng=rng, outliers=outliers)
    return head, angles, readings, seen


def some(seen: Matches, which: slice | np.ndarray) -> Matches:
    return Matches(seen.left[which], seen.right[which], seen.covariance[which])


def left_open(state: FilterState, found: FrameEstimate) -> Array:
    """Return by how much less uncertain readings (4,) are than they were: 1 is not at all."""
    return np.sqrt(np.diag(found.covariance))[len(state.names) :] / state.reading_std


def test_a_geometry_that_a_seventh_of_the_matches_fits_is_believed():
    """And is seldom another than the true one."""
    errors_deg = []
    for seed in range(6):
        head, angles, readings, seen = seen_at_random(seed, outliers=0.86)
        found = estimate_from_matches(begin(head), seen, readings)
        assert found.status == "seen"
        errors_deg.append(turn_error_deg(found.head, found.joints, head, angles))
    assert np.median(errors_deg) < 0.04  # by readings alone: 0.27


@pytest.mark.parametrize("seed", range(3))
def test_a_geometry_that_one_of_twenty_matches_fits_is_not_believed(seed: int):
    """Hundred matches fit, by chance or not; head, readings and their covariance stay."""
    head, _, readings, seen = seen_at_random(seed, outliers=0.95)
    state = begin(head)
    found = estimate_from_matches(state, seen, readings)
    assert (found.status, found.evidence) == ("little seen", None)
    assert found.head is head
    np.testing.assert_array_equal(found.joints, readings)
    np.testing.assert_allclose(left_open(state, found), 1)


def test_the_fewer_matches_there_are_the_nearer_are_readings_to_the_prior():
    """Down to twelve; fewer would fit whatever they show."""
    head, _, readings, seen = seen_at_random(0)
    state, open_before = begin(head), np.zeros(4)
    for count in (1000, 100, 25, 12, 11):
        found = estimate_from_matches(state, some(seen, slice(count)), readings)
        now_open = left_open(state, found)
        assert (now_open > open_before).all()
        assert (found.status == "seen") == (count >= 12)
        open_before = now_open
    np.testing.assert_allclose(open_before, 1)
    np.testing.assert_array_equal(found.joints, readings)
