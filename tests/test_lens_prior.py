"""What is assumed of a lens before any image is seen."""

from dataclasses import replace

import numpy as np
import pytest

from test_intrinsics import FISHEYE, LENSES, POINTS, SIZE, boards
from vergence.arrays import Array
from vergence.calibration.intrinsics import calibrate_camera
from vergence.calibration.priors import EQUIDISTANT, LensPrior, lens_block
from vergence.estimation.linear import linearise
from vergence.estimation.variables import Variables
from vergence.geometry.camera import Camera, pinhole, project
from vergence.geometry.se3 import transform


def linearised(lens: Camera) -> tuple[float, Array, Array]:
    """Return -2 log of the prior density of a lens, half its gradient, and half its curvature."""
    prior = LensPrior()
    x = Variables({"lens": lens_block(lens, np.arange(4, 4 + len(lens.distortion)))})
    error = prior.error(x)
    linear = linearise([prior], x, [error], [np.ones_like(error)])
    return float(prior.costs(error, {}, np.inf)[0]), -linear.g[0], np.diag(linear.gg[0])


def test_the_prior_of_a_rational_lens_is_largest_at_the_equidistant_one_and_forbids_poles():
    lens = pinhole(640, 480, 300.0, (0, 0, 0, 0, 0, *EQUIDISTANT), model="rational")
    cost, half_gradient, _ = linearised(lens)
    assert cost == 0
    np.testing.assert_array_equal(half_gradient, 0)
    pole = pinhole(640, 480, 300.0, (0, 0, 0, 0, 0, -0.5, 0.1, 0.1), model="rational")
    assert linearised(pole)[0] == np.inf


@pytest.mark.parametrize("there", [LENSES["rational"], LENSES["fisheye"]])
def test_the_prior_has_the_derivatives_that_it_states(there: Camera):
    last = len(there.distortion) - 1
    step = 1e-6 * np.eye(last + 1)[last]
    ends = [linearised(replace(there, distortion=there.distortion + s * step)) for s in (1, -1)]
    _, half_gradient, information = linearised(there)
    assert half_gradient[-1] == pytest.approx((ends[0][0] - ends[1][0]) / 4e-6, rel=1e-5)
    assert information[-1] == pytest.approx((ends[0][1][-1] - ends[1][1][-1]) / 2e-6, rel=1e-5)


def test_a_fisheye_lens_of_which_boards_show_the_middle_is_none_that_nobody_builds():
    """The last coefficients are open: without a prior they were up to 90."""
    rng = np.random.default_rng(0)
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
