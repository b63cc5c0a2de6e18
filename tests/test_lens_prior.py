"""What is assumed of a lens before any image is seen."""

from dataclasses import replace

import numpy as np
import pytest

from test_intrinsics import FISHEYE, LENSES, POINTS, SIZE, boards
from vergence.calibration.sequential.intrinsics import calibrate_camera
from vergence.calibration.sequential.lens_prior import EQUIDISTANT, lens_prior
from vergence.geometry.camera import pinhole, project
from vergence.geometry.se3 import transform


def test_the_prior_of_a_rational_lens_is_largest_at_the_equidistant_one_and_forbids_poles():
    lens = pinhole(640, 480, 300.0, (0, 0, 0, 0, 0, *EQUIDISTANT), model="rational")
    cost, half_gradient, _ = lens_prior(lens)
    assert cost == 0
    np.testing.assert_array_equal(half_gradient, 0)
    pole = pinhole(640, 480, 300.0, (0, 0, 0, 0, 0, -0.5, 0.1, 0.1), model="rational")
    assert lens_prior(pole)[0] == np.inf
    step, there = 1e-6 * np.eye(8)[5], LENSES["rational"]
    ends = [lens_prior(replace(there, distortion=there.distortion + s * step)) for s in (1, -1)]
    _, half_gradient, information = lens_prior(there)
    assert half_gradient[9] == pytest.approx((ends[0][0] - ends[1][0]) / 4e-6, rel=1e-6)
    assert information[9] == pytest.approx((ends[0][1][9] - ends[1][1][9]) / 2e-6, rel=1e-6)


def test_the_prior_of_a_fisheye_lens_has_the_derivatives_that_it_states():
    step, there = 1e-6 * np.eye(4)[2], pinhole(640, 480, 300.0, FISHEYE, model="fisheye")
    ends = [lens_prior(replace(there, distortion=there.distortion + s * step)) for s in (1, -1)]
    _, half_gradient, information = lens_prior(there)
    assert half_gradient[6] == pytest.approx((ends[0][0] - ends[1][0]) / 4e-6, rel=1e-5)
    assert information[6] == pytest.approx((ends[0][1][6] - ends[1][1][6]) / 2e-6, rel=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_a_fisheye_lens_of_which_boards_show_the_middle_is_none_that_nobody_builds(seed: int):
    """The last coefficients are open: without a prior they were up to 90."""
    rng = np.random.default_rng(seed)
    T = boards(8, rng)
    T[:, :2, 3] *= 0.3
    T[:, 2, 3] += 0.3
    corners = project(
        pinhole(640, 480, 300.0, FISHEYE, model="fisheye"), transform(T[:, None], POINTS)
    )
    corners += rng.normal(0, 0.3, corners.shape)
    found = calibrate_camera(corners, POINTS, size=SIZE, lens_model="fisheye").camera
    assert np.abs(found.distortion).max() < 1


def test_the_denominator_that_is_assumed_is_an_equidistant_lens():
    r = np.tan(np.radians(np.linspace(1, 65, 20)))
    powers = r[:, None] ** [2, 4, 6]
    numerator = 1 + powers @ (50 / 39, 283 / 715, 256 / 15015)
    np.testing.assert_allclose(r * numerator / (1 + powers @ EQUIDISTANT), np.arctan(r), atol=0.006)
