"""The experiments without images: the table of sensitivities, and facts that need no fit."""

from dataclasses import replace

import numpy as np
import pytest

from simulated_head import plain_head
from simulated_twin import observe_points
from vergence.accuracy.motions import PERIOD_S, eye_angles
from vergence.geometry.head import HeadCalibration, camera_pose_in_base
from vergence.geometry.se3 import inverse
from vergence.paper import replay
from vergence.paper.figures import FIGURES, Figure
from vergence.paper.replay import estimate
from vergence.twin.calibration_errors import inject_calibration_error
from vergence.twin.profile import ByHand, ErrorProfile, Joints

FOCAL_PX = {"2.8mm": 280.0, "4.0mm": 400.0}
SAMPLES = 3000
"""At so many, the spreads of white noise are sampled to 1.3 %."""
PERFECT = ErrorProfile()


def table_head(figure: Figure) -> HeadCalibration:
    """Return the head for which the table was computed."""
    return plain_head(
        0.075,
        FOCAL_PX[figure.lens],
        camera_m=((0.004, 0.001, 0.010), (0.003, -0.0015, 0.0105)),
        mounting_deg=((0.8, -0.5, 0.7), (-0.6, 0.9, -0.5)),
    )


@pytest.fixture
def _up(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the table's version of Eqs. 22-23, positive tilt looks up."""
    monkeypatch.setattr(
        replay, "eye_angles", lambda motion, t: eye_angles(motion, t) * [1, -1, 1, -1]
    )


def run(figure: Figure, profile: ErrorProfile = PERFECT, pixel_noise: float = 0.0) -> replay.Replay:
    """Replay a figure over its full combined period; by-hand errors go into the calibration."""
    truth = table_head(figure)
    times = np.arange(SAMPLES) * PERIOD_S[figure.motion] / SAMPLES
    measurements = observe_points(
        truth, profile, figure, times, pixel_noise=pixel_noise, rng=np.random.default_rng(6)
    )
    believed = inject_calibration_error(truth, profile.by_hand)
    return estimate(believed, figure, measurements)


def spread_mm(
    figure: Figure, profile: ErrorProfile = PERFECT, pixel_noise: float = 0.0
) -> np.ndarray:
    """Return the standard deviations (3,) of the estimates [mm]."""
    statistics = run(figure, profile, pixel_noise).statistics
    assert statistics.dropped == 0
    return 1e3 * statistics.std_m


def joints(**kwargs: object) -> ErrorProfile:
    return ErrorProfile(joints=Joints.model_validate(kwargs))


def by_hand(**kwargs: float) -> ErrorProfile:
    return ErrorProfile(by_hand=ByHand(**kwargs))


SOURCES = {
    "joint noise 0.1 deg": (joints(noise_deg=0.1), 0.0),
    "matching noise 5.6 um": (PERFECT, 0.56),  # of a sensor with 10 um pixels: 6.4 mm for 640
    "readings 10 ms old": (joints(delay_ms=10), 0.0),
    "pan gain 1 %": (joints(gain_percent=(1, 0, 1, 0)), 0.0),
    "mounting roll 1 deg": (by_hand(roll_deg=1), 0.0),
    "mounting 5 mm along the axis": (by_hand(axial_mm=5), 0.0),
    "focal length 1 %": (by_hand(focal_percent_28=1), 0.0),
}
TABLE_MM = {
    "joint noise 0.1 deg": "5.8/0.6/1.3 5.7/0.7/1.4 39/2.4/1.4 39/2.4/1.4 15/4.8/1.3 15/4.8/1.3",
    "matching noise 5.6 um": "6.2/0.6/1.5 6.1/0.8/1.5 42/2.6/1.5 43/2.6/1.5 10/3.4/0.9 10/3.4/0.9",
    "readings 10 ms old": "0.1/0.8/0.5 4.6/0.4/1.1 0.2/2.0/1.3 31/2.4/0.8 0.7/1.0/0.7 11/4.2/0.9",
    "pan gain 1 %": "0.1/0.8/0.0 5.7/0.7/1.3 0.2/2.0/0.0 39/2.4/0.3 0.7/1.0/0.0 15/4.9/1.0",
    "mounting roll 1 deg": "14/0.5/3.0 9.8/1.2/2.5 94/4.6/0.6 68/4.1/2.4 35/12/2.5 25/8.4/2.2",
    "mounting 5 mm along the axis": (
        "0.1/0.9/0.9 6.6/0.8/1.7 0.1/0.9/0.9 18/1.1/0.6 0.1/0.9/0.9 10/3.4/0.9"
    ),
    "focal length 1 %": "0.3/0.7/0.7 5.2/0.7/1.3 0.7/1.8/1.9 37/2.3/1.4 0/0/0 0/0/0",
}
"""Spread x/y/z per unit of each source, Figs. 6 to 11."""


@pytest.mark.usefixtures("_up")
@pytest.mark.parametrize("source", SOURCES)
def test_the_table_of_sensitivities_is_met_within_ten_percent(source: str):
    """Eqs. 3-4, 10-12, 22-23 together, with each error source alone; entries of 1 mm and more."""
    expected = np.array([[float(x) for x in c.split("/")] for c in TABLE_MM[source].split()])
    found = np.array([spread_mm(figure, *SOURCES[source]) for figure in FIGURES.values()])
    large = expected >= 1
    np.testing.assert_allclose(found[large], expected[large], rtol=0.1)
    assert (found[~large] < 1.1).all()


@pytest.mark.parametrize("number", FIGURES)
def test_without_an_error_every_sample_is_exact(number: int):
    points = run(FIGURES[number]).points
    expected = np.tile(FIGURES[number].mean_m, (SAMPLES, 1))
    np.testing.assert_allclose(points, expected, atol=1e-9)


def test_by_hand_errors_leave_straight_gaze_exact():
    """Eq. 10 is computed again from the wrong values: theta = 0 stays as it was calibrated."""
    truth = table_head(FIGURES[6])
    wrong = inject_calibration_error(truth, ByHand(roll_deg=1, axial_mm=5))

    def stereo(head: HeadCalibration) -> np.ndarray:
        left, right = (
            camera_pose_in_base(head, f"{eye}_wide", np.zeros(4)) for eye in ("left", "right")
        )
        return inverse(right) @ head.T_rbase_lbase @ left

    np.testing.assert_allclose(stereo(wrong), stereo(truth), atol=1e-14)
    assert np.abs(wrong.T_rbase_lbase - truth.T_rbase_lbase).max() > 1e-3


# Facts without a fit

NOISES = {"joints": (joints(noise_deg=0.1), 0.0), "pixels": (PERFECT, 0.3)}


def ahead(depth_m: float) -> Figure:
    """Return a parallel experiment with the object straight ahead between the eyes."""
    return replace(FIGURES[6], mean_m=(depth_m, -0.0375, 0.0))


@pytest.mark.parametrize("noise", NOISES)
def test_parallel_depth_spread_grows_as_the_square_of_depth(noise: str):
    """Eq. 20: between the depths of Figs. 6 and 8, within 10 %."""
    near, far = (spread_mm(ahead(z), *NOISES[noise])[0] for z in (0.426, 1.106))
    assert far / near == pytest.approx((1.106 / 0.426) ** 2, rel=0.1)


SHARED = {name: SOURCES[name] for name in ("readings 10 ms old", "pan gain 1 %")}
"""Errors that both eyes have in common."""


@pytest.mark.parametrize("source", SHARED)
@pytest.mark.parametrize("parallel", [6, 8, 10])
def test_errors_that_both_eyes_share_vanish_from_parallel_depth(source: str, parallel: int):
    along = spread_mm(FIGURES[parallel], *SHARED[source])[0]
    across = spread_mm(FIGURES[parallel + 1], *SHARED[source])[0]
    assert along < 1
    assert across > 4
    assert across > 10 * along


def test_samples_in_which_the_object_was_not_found_are_dropped_and_counted():
    figure = FIGURES[6]
    truth = table_head(figure)
    seen = observe_points(truth, PERFECT, figure, np.arange(10.0), rng=np.random.default_rng(0))
    seen.pixels_l[[2, 5]] = np.nan
    statistics = estimate(truth, figure, seen).statistics
    assert (statistics.samples, statistics.dropped) == (8, 2)
    np.testing.assert_allclose(statistics.mean_m, figure.mean_m, atol=1e-12)
    seen.pixels_r[:] = np.nan
    statistics = estimate(truth, figure, seen).statistics
    assert (statistics.samples, statistics.dropped) == (0, 10)
    assert np.isnan(statistics.mean_m).all()
