"""How matches err: in common with their neighbours, and with the frames before."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from simulated_frames import CAMERAS, JOINT_STD_RAD, NOISE_PX, begin, head_of, postures
from simulated_matches import matches, room, squared_distance
from vergence.geometry.head_accuracy import Accuracy
from vergence.self_calibration.filter import update
from vergence.self_calibration.frame import estimate_from_matches
from vergence.self_calibration.kalman import predict
from vergence.self_calibration.match_noise import (
    RevisitCorrelation,
    no_revisits,
)
from vergence.vision.matching.scene_features import Matches


def block_errors(seen: Matches, rng: np.random.Generator) -> Matches:
    """Return matches whose errors are half their own, half those of all in a block of 64 px."""
    column, row = (seen.left // 64).astype(int).T
    shared = rng.normal(0, NOISE_PX, (100, 2))[10 * row + column]
    return replace(seen, right=seen.right + shared)


def test_a_covariance_counts_errors_that_neighbouring_matches_share():
    head, points = head_of(0), room(900, np.random.default_rng(0))
    state = replace(begin(head), reading_std=np.radians(0.5))
    state = replace(state, covariance=1e-12 * state.covariance)
    names, stds, squares = state.names, [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        angles = postures(1, rng)[0]
        seen = matches(head, angles, points, noise_px=NOISE_PX, rng=rng)
        readings = angles + rng.normal(0, state.reading_std, 4)
        found = estimate_from_matches(state, block_errors(seen, rng), readings)
        error = (found.joints - angles)[[0, 2]] @ [1, -1]
        own = found.covariance[len(names) :, len(names) :][np.ix_([0, 2], [0, 2])]
        stds.append(np.sqrt([1, -1] @ own @ [1, -1]))
        squares.append((error / stds[-1]) ** 2)
        assert found.evidence is not None
        assert found.evidence.design_effect > 1.5
    low, high = chi2.interval(0.999, len(squares))
    assert low < sum(squares) < high


def bent(pixels: np.ndarray) -> np.ndarray:
    """Return what a lens (N, 2) [px] departs from its model by: 0.2 px, smooth over the image."""
    x, y = pixels[:, 0] / 320 - 1, pixels[:, 1] / 240 - 1
    return 0.4 * np.column_stack([np.cos(4 * x) * y, np.sin(3 * y) * np.cos(2 * x)])


def test_a_lens_that_departs_from_its_model_as_stated_makes_nothing_too_certain():
    rng, distances = np.random.default_rng(5), []
    head, points = head_of(3), room(500, rng)
    for stated in ({}, {CAMERAS[0]: 0.2}):
        accuracy = Accuracy("paper", systematic_px=stated)
        state = begin(replace(head, accuracy=accuracy))
        for angles in postures(24, rng):
            readings = angles + rng.normal(0, JOINT_STD_RAD, 4)
            seen = matches(head, angles, points, noise_px=NOISE_PX, rng=rng)
            seen = replace(seen, left=seen.left + bent(seen.left))
            state = predict(update(state, estimate_from_matches(state, seen, readings)), 0.3)
        distances.append(squared_distance(state, head))
    assert distances[0] > chi2.isf(1e-9, len(state.names))
    assert distances[1] < len(state.names)


def inflation_at(before: RevisitCorrelation, posture: np.ndarray) -> float:
    return before.inflation(before.novelty(posture))


def test_a_frame_counts_by_what_its_posture_adds():
    """At one posture n frames tell as much as n / (1 + c (n - 1)) independent ones."""
    posture, revisits, told, c, far = np.zeros(4), no_revisits(4), 0.0, 0.25, 0.005
    c = c * (1 - far) + far  # the first is of what frames at any posture do not share
    for n in range(1, 6):
        told += 1 / inflation_at(revisits, posture)
        assert told == pytest.approx(n / (1 + c * (n - 1)))
        revisits = revisits.update(posture, revisits.novelty(posture), 0.0)
    assert 1 < inflation_at(revisits, posture + np.radians(60)) < 1.2
    assert inflation_at(revisits.predict(7200.0), posture) == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("systematic", [0.0, 0.3])
def test_no_number_of_frames_tells_more_than_what_they_have_in_common_allows(systematic):
    told, revisits, rng = 0.0, no_revisits(4), np.random.default_rng(0)
    far = systematic + (1 - systematic) * 0.005
    for posture in rng.uniform(-100, 100, (1000, 4)):  # without a common neighbour
        told += 1 / inflation_at(revisits, posture)
        revisits = revisits.update(posture, revisits.novelty(posture), systematic)
    assert told == pytest.approx(1000 / (1 + far * 999), rel=1e-6)


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 100), apart_deg=st.floats(0.01, 60))
def test_no_frame_tells_more_than_one_that_shares_no_errors(seed, n, apart_deg):
    rng = np.random.default_rng(seed)
    postures = np.radians(apart_deg) * rng.normal(size=(n + 1, 4))
    revisits = RevisitCorrelation(postures[1:], rng.uniform(0, 1200, n))
    assert inflation_at(revisits.predict(rng.uniform(0, 10)), postures[0]) >= 1 - 1e-9


def test_how_much_matches_err_is_learned():
    """Their noise, here twice what is told, and what neighbouring ones share of it."""
    head, rng = head_of(0), np.random.default_rng(0)
    points, states = room(500, rng), []
    for shared in (False, True):
        state = begin(head)
        for angles in postures(30, rng):
            seen = matches(head, angles, points, noise_px=2 * NOISE_PX, rng=rng)
            seen = replace(seen, covariance=seen.covariance / 4)
            seen = block_errors(seen, rng) if shared else seen
            readings = angles + rng.normal(0, JOINT_STD_RAD, 4)
            state = predict(update(state, estimate_from_matches(state, seen, readings)), 0.3)
        states.append(state)
    own, common = states
    assert own.match_scale == pytest.approx(2.0, rel=0.1)
    assert own.design_effect < 1.4
    assert common.design_effect > 1.5
