"""How the eyes move: Eqs. 22-23, with t in seconds."""

import numpy as np
import pytest

from vergence.accuracy.motions import PERIOD_S, eye_angles
from vergence.paper.figures import FIGURES, default_duration_s

TIMES = np.linspace(0, 200, 1001)


def test_parallel_motion_is_equation_22_in_both_eyes():
    angles = eye_angles("parallel", TIMES)
    np.testing.assert_allclose(angles[:, 0], 0.25 * np.cos(TIMES))
    np.testing.assert_allclose(angles[:, 1], 0.25 * np.cos(TIMES / 1.5))
    np.testing.assert_array_equal(angles[:, 2:], angles[:, :2])


def test_divergent_motion_is_equation_22_in_the_left_and_23_in_the_right_eye():
    angles = eye_angles("divergent", TIMES)
    np.testing.assert_array_equal(angles[:, :2], eye_angles("parallel", TIMES)[:, :2])
    np.testing.assert_allclose(angles[:, 2], 0.25 * np.cos(TIMES / 2))
    np.testing.assert_allclose(angles[:, 3], 0.25 * np.cos(TIMES / 2.5))


@pytest.mark.parametrize("motion", ["parallel", "divergent"])
def test_the_period_is_the_shortest_after_which_all_joints_repeat(motion):
    period, start = PERIOD_S[motion], eye_angles(motion, TIMES)
    np.testing.assert_allclose(eye_angles(motion, TIMES + period), start, atol=1e-12)
    for part in (2, 3, 5):
        assert np.abs(eye_angles(motion, TIMES + period / part) - start).max() > 0.1


def test_a_replay_lasts_whole_periods_and_at_least_a_minute():
    assert default_duration_s("parallel") == pytest.approx(24 * np.pi)  # 75 s
    assert default_duration_s("divergent") == pytest.approx(60 * np.pi)  # 188.5 s


def test_the_printed_depths_vary_more_in_divergent_than_in_parallel_motion():
    """Sec. IV: by factors of 1.5 to 2, and depth more than the other axes in every figure."""
    assert list(FIGURES) == [6, 7, 8, 9, 10, 11]
    for figure in FIGURES.values():
        assert figure.std_m[0] >= 2 * max(figure.std_m[1:])
    for parallel, divergent in ((6, 7), (8, 9), (10, 11)):
        assert (FIGURES[parallel].motion, FIGURES[divergent].motion) == ("parallel", "divergent")
        ratio = FIGURES[divergent].std_m[0] / FIGURES[parallel].std_m[0]
        assert 1.5 < ratio <= 2.0
