"""The Monte Carlo of whole heads, in small: what is stated of simulated heads is true."""

import numpy as np
import pytest

import whole_head_monte_carlo as monte_carlo

TRIALS = 3


@pytest.fixture(scope="module")
def trials(slow_setup: None) -> list[monte_carlo.Trial]:
    return [monte_carlo.run(0, number) for number in range(TRIALS)]


def test_no_calibration_fails_and_no_error_is_far_beyond_what_is_stated(trials):
    assert not any(trial.failure for trial in trials)
    assert max(trial.largest for trial in trials) < 4.5


def test_regions_of_whole_heads_hold_the_truth(trials):
    p = np.array([p for trial in trials for p in trial.probability.values()])
    assert len(p) == TRIALS * 11  # four lenses, four mountings, the bases, the axes of two eyes
    assert np.mean(p < 0.95) > 0.85
    assert 0.3 < np.mean(p) < 0.7
    kinds = {monte_carlo.kind(name) for trial in trials for name in trial.probability}
    assert kinds == set(monte_carlo.KINDS)


@pytest.mark.slow
def test_what_passes_for_unobservable_before_the_noise_has_settled_is_released():
    """Exact readings are outliers at first here, and with them all that tells a gain of 2.5 %."""
    trial = monte_carlo.run(0, 450)
    assert trial.joint_deg == 0
    assert trial.largest < 4.5
    assert trial.point_mm < 2


def test_errors_of_located_points_are_as_large_as_predicted(trials):
    assert monte_carlo.ratio([trial.point for trial in trials]) == pytest.approx(1, abs=0.3)
    assert f"| all | {TRIALS} |" in monte_carlo.table(trials)
