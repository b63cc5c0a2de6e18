"""Held-out errors: exact where all is exact, as large as stated where noise is as stated."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from simulated_head import plain_head, random_head
from simulated_recording import BOARD, EXACT, Noise, Recording, record
from test_parameters import stated
from texts import texts
from vergence.arrays import Array
from vergence.calibration.calibrate import calibrate
from vergence.calibration.cross_validation import (
    PartCalibration,
    calibrate_folds,
    folds,
    held_out,
    jackknife_ratio,
)
from vergence.calibration.observations import Observations
from vergence.geometry.head import HeadCalibration
from vergence.geometry.head_accuracy import Accuracy, HeldOut
from vergence.geometry.parameters import change_named

HEAD = plain_head(0.075, 280.0, camera_m=((0.02, 0, 0), (0.02, 0, 0)))


def observations(views: int = 20, noise: Noise = EXACT) -> Observations:
    """Return views of one board before moving eyes."""
    how = Recording(straight=0, orientations=views, noise=noise)
    return record(HEAD, np.random.default_rng(1), how)


def cross_validated(
    seen: Observations, calibrate: Callable[[np.ndarray], HeadCalibration]
) -> HeldOut:
    """Return the held-out errors of calibrations of heads, with no board known."""
    parts = calibrate_folds(seen, lambda rows: PartCalibration(calibrate(rows), {}, 1.0))
    return held_out(seen, parts, parts[0].head)


def test_folds_spread_each_placement():
    placement = np.repeat([0, 1], [10, 15])
    number = folds(placement)
    for k in (0, 1):
        assert np.ptp(np.bincount(number[placement == k], minlength=5)) <= 1


def test_a_perfect_calibration_has_no_held_out_error():
    found = cross_validated(observations(), lambda _: HEAD)
    assert found.transfer_px == pytest.approx(0, abs=1e-4)  # as the poses of boards are found
    assert found.point_mm == pytest.approx(0, abs=1e-6)
    assert found.transfer_views == found.point_views == 20
    assert found.expected_mm is None


def test_corners_are_carried_from_eye_to_eye_by_a_board_of_the_size_that_was_estimated():
    board = replace(BOARD, square_m=BOARD.square_m / 1.05)
    seen = replace(observations(), board=board)
    parts = calibrate_folds(seen, lambda _: PartCalibration(HEAD, {}, 1.05))
    assert held_out(seen, parts, HEAD).transfer_px == pytest.approx(0, abs=1e-4)


def test_training_never_contains_the_views_that_are_predicted():
    trained: list[np.ndarray] = []

    def calibrate(rows: np.ndarray) -> HeadCalibration:
        trained.append(rows)
        return HEAD

    cross_validated(observations(), calibrate)
    left_out = ~np.array(trained)
    assert left_out.sum(axis=1).tolist() == [4] * 5
    assert (left_out.sum(axis=0) == 1).all()


def test_noise_of_the_readings_explains_the_held_out_error():
    exact = Accuracy("bundle", ("left_wide.fx",), np.array([[1e-20]]), 0.0, (2e-3,))
    head = replace(HEAD, accuracy=exact)
    found = cross_validated(observations(60, Noise(joint_rad=2e-3)), lambda _: head)
    assert found.expected_mm is not None
    assert found.point_mm == pytest.approx(found.expected_mm, rel=0.25)


@pytest.mark.parametrize("information", [[1.0] * 5, [0.5, 0.3, 0.1, 0.05]])
def test_parts_that_differ_as_stated_have_a_jackknife_ratio_of_one(information: list[float]):
    rng = np.random.default_rng(4)
    head = stated(HEAD, rng)
    assert head.accuracy is not None
    names, unit = head.accuracy.parameters, head.accuracy.covariance

    def weighted_mean(values: Array, weights: Array) -> HeadCalibration:
        """Return the head of the weighted mean of values (k, n), which states its covariance."""
        accuracy = replace(head.accuracy, covariance=unit / weights.sum())
        mean = (weights[:, None] * values).sum(axis=0) / weights.sum()
        return replace(change_named(head, names, mean), accuracy=accuracy)

    weights, squares = np.array(information), []
    for _ in range(30):
        views = rng.multivariate_normal(np.zeros(len(names)), unit, len(weights), method="cholesky")
        views /= np.sqrt(weights)[:, None]
        others = [np.delete(np.arange(len(weights)), k) for k in range(len(weights))]
        parts = [weighted_mean(views[rows], weights[rows]) for rows in others]
        ratio = jackknife_ratio(weighted_mean(views, weights), parts)
        assert ratio is not None
        squares.append(ratio**2)
    assert np.sqrt(np.mean(squares)) == pytest.approx(1, abs=0.15)
    assert jackknife_ratio(HEAD, [HEAD] * 5) is None  # states no covariance
    assert jackknife_ratio(head, [head, HEAD]) is None  # nor does one of the parts
    assert jackknife_ratio(head, [head]) is None


def test_parts_of_few_views_need_not_agree_better_than_these_views_allow():
    rng = np.random.default_rng([7, 3, 3])  # compared with what the whole knows, it would be void
    head = random_head(rng, lenses=["wide"])
    few = Recording(straight=3, orientations=3, alike=False)
    found = calibrate(record(head, rng, few)).accuracy
    assert texts(found.findings, "void") == []
    assert found.held_out is not None
    assert found.held_out.jackknife_ratio < 1
