"""Held-out errors and the predicted covariance: exact where all is exact, true where it is not."""

from dataclasses import replace

import numpy as np
import pytest
from heads import R_EYE_CAM, plain_head, point_in_camera, random_head

from vergence.arrays import Array
from vergence.calibration.bundle.problem import calibration_names
from vergence.calibration.checks.cross_validation import (
    Observations,
    calibration_covariance,
    folds,
    held_out,
    predicted_covariance,
    scatter,
)
from vergence.calibration.sequential.sequential import Views
from vergence.errors import VergenceError
from vergence.geometry.board import Chessboard, corner_points
from vergence.geometry.camera import project
from vergence.geometry.head import Accuracy, HeadCalibration, T_base_cam, load, save
from vergence.geometry.parameters import changed, difference, without_offsets
from vergence.geometry.se3 import pose, transform
from vergence.stereo.triangulation import locate

BOARD = Chessboard(columns=5, rows=4, square_m=0.03)
HEAD = plain_head(0.075, 280.0, camera_m=((0.02, 0, 0), (0.02, 0, 0)))
NAMES = calibration_names(tuple(HEAD.cameras))


def stated(head: HeadCalibration, rng: np.random.Generator) -> HeadCalibration:
    """Return a head that states a correlated covariance of plausible size."""
    chosen = tuple(n for n in NAMES if n.endswith((".fx", "rx", "ry", "rz", "tx", "ty", "tz")))
    scale = [0.3 if n.endswith("fx") else 1e-3 if n[-2] == "r" else 2e-4 for n in chosen]
    A = np.eye(len(chosen)) + 0.2 * rng.normal(size=(len(chosen),) * 2)
    covariance = scale * (A @ A.T) * np.array(scale)[:, None]
    accuracy = Accuracy(
        method="refined",
        parameters=chosen,
        covariance=covariance,
        pixel_std_px=0.1,
        joint_std=(1e-3,),
    )
    return replace(head, accuracy=accuracy)


def observations(views: int = 20, *, joint_std: float = 0.0) -> Observations:
    rng = np.random.default_rng(1)
    angles = rng.uniform(-0.2, 0.2, (views, 4))
    places = [pose(R_EYE_CAM, [0.5, 0.06, 0.05]), pose(R_EYE_CAM, [0.6, 0.03, 0.0])]
    placement = np.arange(views) % 2
    corners = {}
    for name, mounted in HEAD.cameras.items():
        seen = []
        for row in range(views):
            points = transform(places[placement[row]], corner_points(BOARD))
            in_cam = point_in_camera(HEAD, name, angles[row : row + 1], points)
            seen.append(project(mounted.intrinsics, in_cam))
        corners[name] = np.array(seen)
    readings = angles + rng.normal(0, joint_std, angles.shape)
    sizes = dict.fromkeys(corners, (640, 480))
    return Observations(Views(BOARD, placement, readings, corners, sizes), None, None)


def sight(head: HeadCalibration) -> tuple[Array, Array, Array]:
    angles = np.random.default_rng(2).uniform(-0.2, 0.2, (6, 4))
    point = np.array([[0.5, 0.03, 0.02]])
    pixels = []
    for name, mounted in head.cameras.items():
        each = [point_in_camera(head, name, a[None], point)[0] for a in angles]
        pixels.append(project(mounted.intrinsics, np.array(each)))
    return pixels[0], pixels[1], angles


def test_folds_spread_each_placement():
    placement = np.repeat([0, 1], [10, 15])
    number = folds(placement)
    for k in (0, 1):
        assert np.ptp(np.bincount(number[placement == k], minlength=5)) <= 1


def test_a_perfect_calibration_has_no_held_out_error():
    found = held_out(observations(), lambda _: HEAD)
    assert found.transfer_px == pytest.approx(0, abs=1e-6)
    assert found.point_mm == pytest.approx(0, abs=1e-6)
    assert found.transfer_views == found.point_views == 20
    assert found.expected_mm is None


def test_training_never_contains_the_views_that_are_predicted():
    seen = observations()
    trained: list[Array] = []

    def calibrate(part: Observations) -> HeadCalibration:
        trained.append(part.views.eye_angles[:, 0])
        return HEAD

    held_out(seen, calibrate)
    missing = [set(seen.views.eye_angles[:, 0]) - set(part) for part in trained]
    assert [len(part) for part in missing] == [4] * 5
    assert set.union(*missing) == set(seen.views.eye_angles[:, 0])


def test_noise_of_the_readings_explains_the_held_out_error():
    exact = Accuracy(
        method="refined",
        parameters=("left_wide.fx",),
        covariance=np.array([[1e-20]]),
        pixel_std_px=0.0,
        joint_std=(2e-3,),
    )
    head = replace(HEAD, accuracy=exact)
    found = held_out(observations(60, joint_std=2e-3), lambda _: head)
    assert found.expected_mm is not None
    assert found.point_mm == pytest.approx(found.expected_mm, rel=0.25)


def test_too_few_views_for_the_folds_are_refused():
    with pytest.raises(VergenceError, match="at least 5 views, found 4"):
        held_out(observations(4), lambda _: HEAD)


def test_the_predicted_covariance_is_that_of_sampled_calibrations():
    rng = np.random.default_rng(3)
    head = stated(HEAD, rng)
    assert head.accuracy is not None
    pixels_l, pixels_r, angles = sight(head)
    draws = rng.multivariate_normal(
        np.zeros(len(head.accuracy.parameters)), head.accuracy.covariance, 600
    )
    points = np.array(
        [
            locate(changed(head, head.accuracy.parameters, d), pixels_l, pixels_r, angles).points
            for d in draws
        ]
    )
    predicted = calibration_covariance(head, pixels_l, pixels_r, angles)
    ratio = points.var(axis=0) / np.diagonal(predicted, axis1=1, axis2=2)
    np.testing.assert_allclose(np.sqrt(ratio), 1, atol=0.12)
    more = predicted_covariance(head, pixels_l, pixels_r, angles)
    assert (np.trace(more - predicted, axis1=1, axis2=2) > 0).all()


def test_folds_that_scatter_as_stated_have_a_ratio_of_one():
    rng = np.random.default_rng(4)
    head = stated(HEAD, rng)
    assert head.accuracy is not None
    names, covariance = head.accuracy.parameters, head.accuracy.covariance
    ratios = []
    for _ in range(10):
        parts = rng.multivariate_normal(np.zeros(len(names)), 5 * covariance, 5)
        # Each head is the mean of the other four parts, and states the covariance of that.
        means = (parts.sum(axis=0) - parts) / 4
        accuracy = replace(head.accuracy, covariance=covariance * 5 / 4)
        ratio = scatter([replace(changed(head, names, m), accuracy=accuracy) for m in means])
        assert ratio is not None
        ratios.append(ratio)
    assert np.mean(ratios) == pytest.approx(1, abs=0.15)


def test_a_calibration_without_covariance_predicts_nothing():
    with pytest.raises(VergenceError, match="states no covariance"):
        calibration_covariance(HEAD, *sight(HEAD))


@pytest.mark.parametrize("seed", range(5))
def test_a_change_is_the_difference_that_it_makes(seed: int):
    rng = np.random.default_rng(seed)
    head = without_offsets(random_head(rng))
    names = [n for n in calibration_names(tuple(head.cameras)) if not n.endswith("offset_rad")]
    change = rng.normal(0, 1e-3, len(names))
    off = difference(changed(head, names, change), head)
    np.testing.assert_allclose([off[n] for n in names], change, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_a_head_without_offsets_sees_the_same(seed: int):
    rng = np.random.default_rng(seed)
    head = random_head(rng)
    plain = without_offsets(head)
    angles = rng.normal(0, 0.2, (10, 2))
    for name in head.cameras:
        one, other = T_base_cam(head, name, angles), T_base_cam(plain, name, angles)
        side = head.cameras[name].eye
        turn = one[0] @ np.linalg.inv(other[0])
        np.testing.assert_allclose(one, turn @ other, atol=1e-12)
        assert turn[2, 2] == pytest.approx(1)  # about the pan axis alone
        assert head.axes[side].pan_offset_rad == pytest.approx(np.arctan2(turn[1, 0], turn[0, 0]))


def test_accuracy_travels_with_the_file_and_old_files_load(tmp_path):
    head = stated(HEAD, np.random.default_rng(5))
    save(head, tmp_path / "new.json")
    back = load(tmp_path / "new.json")
    assert back.accuracy is not None
    assert head.accuracy is not None
    assert back.accuracy.parameters == head.accuracy.parameters
    np.testing.assert_array_equal(back.accuracy.covariance, head.accuracy.covariance)
    text = (tmp_path / "new.json").read_text()
    start = text.index(' "time_offset_s"')
    end = text.index(' "format"')
    (tmp_path / "old.json").write_text(text[:start] + text[end:])
    assert load(tmp_path / "old.json").accuracy is None
