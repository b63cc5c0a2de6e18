"""How much measurements scatter is found from them alone, whatever errors they share."""

import numpy as np
import pytest

from vergence.gaze.kalman import begin, predict, update
from vergence.gaze.scatter import Scatter, observe

STEP_S = 1 / 30
SETTINGS = {"std": 1.0, "jerk": 1.0}
R = np.array([[4e-5, 1e-5, 0], [1e-5, 6e-6, 0], [0, 0, 1e-6]])


def after(points: np.ndarray, times: np.ndarray) -> Scatter:
    scatter = Scatter()
    for time_s, point in zip(times, points, strict=True):
        scatter = observe(scatter, float(time_s), point, R)
    return scatter


def moving(times: np.ndarray) -> np.ndarray:
    """Return a smooth path (N, 3): 0.2 m/s on a circle of 8 cm."""
    return np.stack([0.6 + 0 * times, 0.08 * np.sin(2.5 * times), 0.08 * np.cos(2.5 * times)], -1)


@pytest.mark.parametrize("share", [0.01, 0.3, 1.0, 4.0])
def test_the_share_is_found_while_the_object_moves(share: float):
    rng = np.random.default_rng(1)
    times = np.cumsum(rng.choice([STEP_S, 2 * STEP_S], 400, p=[0.8, 0.2]))  # some frames are lost
    noise = rng.multivariate_normal(np.zeros(3), share * R, len(times))
    shared = np.array([0.01, -0.004, 0.002])  # an error that all have in common
    found = after(moving(times) + shared + noise, times).share
    assert found == pytest.approx(share, rel=0.35)


def test_the_first_assumption_is_that_measurements_scatter_as_they_state():
    times = STEP_S * np.arange(3)
    assert after(moving(times), times).share == 1.0


def test_a_gap_is_not_taken_for_scatter():
    times = np.concatenate([STEP_S * np.arange(30), 3 + STEP_S * np.arange(30)])
    points = moving(times) + np.where(times[:, None] > 2, 0.2, 0.0)
    assert after(points, times).share < 0.1


def test_a_filter_that_weighs_by_scatter_beats_single_measurements_that_share_an_error():
    """As with a wrong calibration: what is stated is far more than what scatters."""
    rng = np.random.default_rng(3)
    times = STEP_S * np.arange(900)
    truth = moving(times)
    shared = np.array([5e-4, 2e-4, -1e-4]) * (1 + 3 * (truth[:, 1:2] + truth[:, 2:3]))
    points = truth + shared + rng.multivariate_normal(np.zeros(3), 0.005 * R, len(times))
    squared: dict[bool, float] = {}
    for weighs in (False, True):
        scatter, track, fused = Scatter(), None, []
        for time_s, point in zip(times, points, strict=True):
            scatter = observe(scatter, float(time_s), point, R)
            if track is None:
                track = begin(
                    0.0, point, R, speed_std_m_s=0.3, acceleration_std_m_s2=SETTINGS["std"]
                )
            track = predict(track, float(time_s), jerk_density=SETTINGS["jerk"])
            track = update(track, point, R * (scatter.share if weighs else 1.0))
            fused.append(track.position)
        squared[weighs] = float(np.mean((np.array(fused) - truth)[30:] ** 2))
    single = float(np.mean((points - truth)[30:] ** 2))
    assert squared[True] < single < squared[False]
