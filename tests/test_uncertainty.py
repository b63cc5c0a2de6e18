"""How far off a located point is: Eqs. 20-21 and the covariance, against simulation."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from closed_form import predicted_depth_std
from simulated_head import plain_head, skewed_head
from test_triangulation import random_samples
from vergence.errors import VergenceError
from vergence.geometry.camera import project
from vergence.geometry.eye_motion import eye_poses
from vergence.geometry.head import HeadCalibration
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.kinematics import EYES, Kinematics
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import boxplus, rotation
from vergence.stereo.triangulation import triangulate_at
from vergence.stereo.uncertainty import (
    combination,
    depth_error,
    disparity_error,
    joints_at_images,
    locate,
    locate_jointly,
)


def test_depth_error_is_the_slope_of_depth_over_disparity():
    """Eq. 20: with z = b f / d, dz/dd = z^2 / (b f)."""
    z, b, f, small = 1.1, 0.092, 280.0, 1e-4
    nearer, farther = (b * f / (b * f / z + sign * small) for sign in (1, -1))
    assert depth_error(z, b, f, small) == pytest.approx((farther - nearer) / 2)


def test_depth_error_grows_with_the_square_of_depth():
    """Eq. 20."""
    assert depth_error(2.0, 0.1, 280.0, 1.0) == pytest.approx(4 * depth_error(1.0, 0.1, 280.0, 1.0))


@given(st.floats(-0.3, 0.3), st.floats(100, 2000))
def test_disparity_error_is_how_far_a_turned_camera_sees_its_own_centre(turn: float, focal: float):
    """Eq. 21: sigma_d = f tan(alpha) for the pixel at the image's centre."""
    camera = plain_head(0.09, focal).cameras["left_wide"].intrinsics
    seen = project(camera, rotation([0, turn, 0]) @ [0, 0, 1.0])
    assert seen[0] - 319.5 == pytest.approx(disparity_error(focal, turn), abs=1e-9)


def test_orientation_error_makes_focal_length_no_help_in_depth():
    """Eqs. 20-21 together: a longer lens does not improve what wrong orientation spoils."""
    depths = [depth_error(1.0, 0.09, f, disparity_error(f, 2e-3)) for f in (280.0, 400.0, 1200.0)]
    np.testing.assert_allclose(depths, depths[0])


def test_noise_is_a_standard_deviation_for_all_or_for_each_measurement():
    rng = np.random.default_rng(0)
    head = skewed_head(rng)
    _, eyes, left, right = random_samples(head, rng, 3)
    seen = {"left": left, "right": right, "joints": eyes}
    for wrong, found in (
        ({"pixel_std_px": -0.1}, "pixel_std_px is a standard deviation, 0 or more; found -0.1"),
        ({"pixel_std_px": np.nan}, "0 or more; found nan"),
        ({"pixel_std_px": [0.1, 0.1]}, r"shape \(4,\) or \(3, 4\); found one of shape \(2,\)"),
        ({"pixel_std_px": np.ones((2, 4))}, r"found one of shape \(2, 4\)"),
        ({"reading_std": [1e-3, 1e-3, -1e-3, 1e-3]}, "reading_std is .* found -0.001"),
        ({"reading_std": [1e-3] * 3}, r"reading_std is .* found one of shape \(3,\)"),
    ):
        with pytest.raises(VergenceError, match=found):
            locate(head, **seen, **wrong)
    own = np.full((3, 4), 0.1)
    own[1] = np.nan
    assert np.isnan(locate(head, **seen, pixel_std_px=own).covariance).all((1, 2)).tolist() == [
        False,
        True,
        False,
    ]


@pytest.mark.parametrize("weights", [np.ones(2), np.ones((3, 1)), 1.0, [1.0, np.nan, 1.0]])
def test_a_combination_has_a_finite_weight_for_each_point(weights):
    rng = np.random.default_rng(0)
    head = skewed_head(rng)
    _, eyes, left, right = random_samples(head, rng, 3)
    with pytest.raises(VergenceError, match="3 points has a finite weight for each"):
        combination(head, weights=weights, left=left, right=right, joints=eyes)


@pytest.mark.parametrize("noise_px", [0.0, 0.1])
def test_an_offset_in_time_costs_moving_eyes_nothing_once_it_is_calibrated(noise_px: float):
    """At 30 Hz and 0.5 Hz, with readings 40 ms before the images."""
    rng, t = np.random.default_rng(4), np.arange(90) / 30
    head = replace(plain_head(0.075, 280.0), time_offset_s=0.04)
    point = np.array([0.6, -0.04, 0.02])

    def eyes(time_s: np.ndarray) -> np.ndarray:
        return 0.2 * np.cos(np.pi * time_s[:, None] + np.arange(4))

    noise = rng.normal(0, noise_px, (2, len(t), 2))
    left, right = (
        project_point(head, name, eyes(t + 0.04), point) + own
        for name, own in zip(("left_wide", "right_wide"), noise, strict=True)
    )

    def rms(joints: np.ndarray) -> float:
        found = locate(head, left=left, right=right, joints=joints)
        return float(np.sqrt(((found.xyz - point) ** 2).sum(axis=1).mean()))

    without = rms(eyes(t + 0.04))
    moved = joints_at_images(head, eyes(t), t)
    assert rms(moved) < 1.1 * without + 1e-5
    assert rms(eyes(t)) > 5e-3
    with pytest.raises(VergenceError, match="increase by at most"):
        joints_at_images(head, eyes(t), 10 * t)
    with pytest.raises(VergenceError, match="one for each"):
        joints_at_images(head, eyes(t), t[:5])
    with pytest.raises(VergenceError, match="Time stamps of a motion are finite"):
        joints_at_images(head, eyes(t), np.where(np.arange(90) == 7, np.nan, t))
    as_list = joints_at_images(head, eyes(t).tolist(), t.tolist())
    np.testing.assert_array_equal(as_list, moved)


@pytest.mark.parametrize("times", [0.0, [[0.0]], [np.nan], [], [0.0, 0.1]])
def test_one_reading_has_one_finite_time_stamp(times: ArrayLike):
    head, joints = plain_head(0.075, 280.0), [0.0, 0.0, 0.0, 0.0]
    np.testing.assert_array_equal(joints_at_images(head, [joints], [0.0]), [joints])
    with pytest.raises(VergenceError, match=r"one for each|finite"):
        joints_at_images(head, [joints], times)


def test_measured_eye_poses_locate_as_the_angles_do_and_have_their_own_noise():
    """Against samples, with noise of rotation and of translation."""
    rng = np.random.default_rng(5)
    head, angles = plain_head(0.075, 280.0), np.array([0.05, -0.02, -0.06, 0.03])
    point = np.array([0.6, -0.04, 0.02])
    left, right = (
        np.tile(project_point(head, name, angles, point), (20_000, 1))
        for name in ("left_wide", "right_wide")
    )
    poses = eye_poses(head, angles)
    by_angles = locate(head, left=left[:1], right=right[:1], joints=angles, pixel_std_px=0.1)
    by_poses = locate(head, left=left[:1], right=right[:1], joints=poses, pixel_std_px=0.1)
    np.testing.assert_allclose(by_poses.xyz, by_angles.xyz, atol=1e-12)
    np.testing.assert_allclose(by_poses.covariance, by_angles.covariance, rtol=1e-9)
    stds = (1e-3, 2e-4)
    noisy = boxplus(poses, rng.normal(0, np.repeat(stds, 3), (20_000, 2, 6)))
    sampled = np.cov(locate(head, left=left, right=right, joints=noisy).xyz.T)
    (stated,) = locate(
        head, left=left[:1], right=right[:1], joints=poses, pixel_std_px=0.0, reading_std=stds
    ).covariance
    # A hundredth of the spread is what 20,000 samples leave open.
    np.testing.assert_allclose(np.sqrt(np.diag(stated)), np.sqrt(np.diag(sampled)), rtol=0.03)


def simulate(
    head: HeadCalibration,
    pixels: np.ndarray,
    eyes: np.ndarray,
    pixel_std: float,
    joint_std: float,
    n: int = 50_000,
) -> np.ndarray:
    """Return the covariance (3, 3) of noisy estimates of one sample: pixels (2, 2), eyes (4,)."""
    rng = np.random.default_rng(8)
    left, right = pixels[:, None] + rng.normal(0, pixel_std, (2, n, 2))
    joints = eyes + rng.normal(0, joint_std, (n, 4))
    return np.cov(triangulate_at(head, left=left, right=right, joints=joints)[0].T)


@pytest.mark.parametrize(
    ("depth", "focal", "joint_deg", "pixel"),
    [(0.426, 280, 0.1, 0), (0.642, 280, 0, 0.5), (0.426, 400, 0.1, 0.5), (1.106, 400, 0.1, 0.5)],
)
def test_the_closed_form_agrees_with_simulation_on_the_axis(depth, focal, joint_deg, pixel):
    """Eqs. 20-21: within 1.3 %, where sigma_z is below 8 % of z, and z above 5 baselines."""
    ahead, baseline = 0.02, 0.075
    head = plain_head(baseline, focal, camera_m=((ahead, 0, 0),) * 2)
    in_left = np.array([baseline / 2, 0, depth])  # midway between the eyes: y = -b/2 is x = b/2
    camera = head.cameras["left_wide"].intrinsics
    pixels = np.array([project(camera, in_left), project(camera, in_left - [baseline, 0, 0])])
    observed = simulate(head, pixels, np.zeros(4), pixel, np.radians(joint_deg))
    stds = {"reading_std": np.radians(joint_deg), "pixel_std_px": pixel}
    middle = [ahead + depth, -baseline / 2, 0.0]
    predicted = predicted_depth_std(middle, baseline, focal, **stds, camera_ahead_m=ahead)
    assert predicted / depth < 0.08
    assert predicted == pytest.approx(np.sqrt(observed[0, 0]), rel=0.013)


def test_the_closed_form_without_the_cameras_lever_is_too_small():
    """Eq. 21 turns the camera about its own centre, while an eye turns about another one."""
    plain, levered = (
        predicted_depth_std(
            [ahead + 0.426, -0.046, 0.0], 0.092, 280.0, reading_std=2e-3, camera_ahead_m=ahead
        )
        for ahead in (0.0, 0.02)
    )
    assert levered == pytest.approx(plain * 1.047, rel=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_the_covariance_agrees_with_simulation_anywhere(seed: int):
    rng = np.random.default_rng(seed)
    head = skewed_head(rng)
    _, eyes, left, right = random_samples(head, rng, 1)
    stds = {"pixel_std_px": 0.2, "reading_std": np.radians(0.03)}
    (predicted,) = locate(head, left=left, right=right, joints=eyes, **stds).covariance
    observed = simulate(head, np.stack([left[0], right[0]]), eyes[0], *stds.values())
    # Along the axes of the observed ellipsoid: 1.1 % for curvature, and sampling error.
    ratio = np.linalg.eigvals(np.linalg.solve(observed, predicted)).real
    np.testing.assert_allclose(np.sqrt(ratio), 1, atol=0.016)
    np.testing.assert_array_equal(predicted, predicted.T)


def test_the_covariance_agrees_with_the_closed_form_on_the_axis():
    """Eqs. 20-21 against the Jacobian: equal up to the squared angle of the half baseline."""
    head = plain_head(0.092, 280.0, camera_m=((0.02, 0, 0),) * 2)
    point, straight = np.array([[1.02, -0.046, 0.0]]), np.zeros(4)  # 1 m before the cameras
    left, right = (project_point(head, f"{eye}_wide", straight, point) for eye in EYES)
    noise = {"reading_std": 1e-3, "pixel_std_px": 0.3}
    (covariance,) = locate(head, left=left, right=right, joints=straight, **noise).covariance
    closed = predicted_depth_std(point[0], 0.092, 280.0, camera_ahead_m=0.02, **noise)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(closed, rel=0.003)


def test_each_input_may_have_its_own_noise():
    rng = np.random.default_rng(1)
    head = skewed_head(rng)
    _, eyes, left, right = random_samples(head, rng, 7)

    def covariance(pixel_px: ArrayLike, joint_rad: ArrayLike) -> np.ndarray:
        stds = {"pixel_std_px": pixel_px, "reading_std": joint_rad}
        return locate(head, left=left, right=right, joints=eyes, **stds).covariance

    parts = sum(
        covariance(0.3 * each, 0) + covariance(0, np.tile(1e-3 * each, (7, 1)))
        for each in np.eye(4)
    )
    np.testing.assert_allclose(parts, covariance(0.3, 1e-3), rtol=1e-9, atol=1e-18)


def test_what_cannot_be_located_has_no_covariance_nor_has_anything_if_no_noise_is_stated():
    left = np.array([[320.0, 240.0], [np.nan, 240.0], [340.0, 240.0]])
    right = np.array([[320.0, 240.0], [300.0, 240.0], [320.0, 240.0]])
    for stds in ({}, {"reading_std": 1e-3}, {"pixel_std_px": 0.1}):
        found = locate(plain_head(0.09, 280.0), left=left, right=right, joints=np.zeros(4), **stds)
        assert np.isfinite(found.xyz).all(axis=1).tolist() == [False, False, True]
        assert np.isfinite(found.covariance).all(axis=(1, 2)).tolist() == [False, False, bool(stds)]


def test_a_point_without_noise_of_its_own_leaves_the_weights_of_the_others():
    rng = np.random.default_rng(0)
    head = skewed_head(rng)
    _, eyes, left, right = random_samples(head, rng, 5)
    left = left + rng.normal(0, 1, left.shape)
    noise = np.tile([0.05, 0.05, 0.5, 0.5], (5, 1))
    seen: dict[str, Any] = {"left": left, "right": right, "joints": eyes, "reading_std": 1e-3}
    whole = locate(head, **seen, pixel_std_px=noise)
    noise[2] = np.nan
    found = locate(head, **seen, pixel_std_px=noise)
    others = [0, 1, 3, 4]
    np.testing.assert_array_equal(found.xyz[others], whole.xyz[others])
    np.testing.assert_array_equal(found.covariance[others], whole.covariance[others])


def test_noise_counts_that_a_calibration_states_without_a_covariance():
    rng = np.random.default_rng(0)
    head = skewed_head(rng)
    _, eyes, left, right = random_samples(head, rng, 5)
    seen: dict[str, Any] = {"left": left, "right": right, "joints": eyes}
    stated = Accuracy("paper", pixel_std_px=0.1, joint_std=(2e-3,))
    found = locate(replace(head, accuracy=stated), **seen)
    given = locate(head, **seen, pixel_std_px=0.1, reading_std=2e-3)
    np.testing.assert_allclose(found.covariance, given.covariance)


def test_points_of_a_head_that_was_estimated_with_its_readings_are_weighted_like_others():
    rng = np.random.default_rng(0)
    head = skewed_head(rng)
    _, eyes, left, right = random_samples(head, rng, 5)
    left, noise = left + rng.normal(0, 1, left.shape), [0.1, 0.1, 3.0, 3.0]
    seen: dict[str, Any] = {"left": left, "right": right, "joints": eyes[0], "pixel_std_px": noise}
    alone = locate(head, **seen, reading_std=1e-3)
    jointly = locate_jointly(head, **seen, estimate=((), 1e-6 * np.eye(4)))
    np.testing.assert_allclose(jointly.xyz, alone.xyz)
    np.testing.assert_allclose(jointly.covariance, alone.covariance)


def test_the_covariance_of_a_difference_leaves_out_what_is_shared():
    """Two points 60 mm apart at the same wrong readings, against simulation."""
    rng, n, pixel_std, joint_std = np.random.default_rng(5), 50_000, 0.1, 2e-3
    head = skewed_head(np.random.default_rng(3))
    points = np.array([[0.5, 0.03, 0.0], [0.48, 0.02, -0.05]])
    eyes = np.array([0.12, 0.02, -0.06, 0.03])
    left, right = (project_point(head, f"{eye}_wide", eyes, points) for eye in EYES)
    turned = eyes + rng.normal(0, joint_std, (n, 4))
    noisy = np.stack([left, right], axis=1)[:, :, None] + rng.normal(0, pixel_std, (2, 2, n, 2))
    a, b = (triangulate_at(head, left=u, right=v, joints=turned)[0] for u, v in noisy)
    stds = {"pixel_std_px": pixel_std, "reading_std": joint_std}
    difference, stated = combination(
        head, weights=np.array([1.0, -1.0]), left=left, right=right, joints=eyes, **stds
    )
    np.testing.assert_allclose(difference, points[0] - points[1], atol=1e-9)
    found = np.cov((a - b).T)
    np.testing.assert_allclose(found, stated, atol=0.03 * np.trace(stated))
    assert np.trace(found) < 0.1 * np.trace(np.cov(a.T))


def test_a_head_without_joints_locates_with_covariance():
    moving, pair = plain_head(0.09, 300.0), ("left_wide", "right_wide")
    rigid = replace(moving, kinematics=Kinematics({"left": (), "right": ()}, ()))
    point = np.array([[0.6, -0.04, 0.1]])
    found, expected = (
        locate(head, left=left, right=right, joints=joints, pixel_std_px=0.1, reading_std=0.0)
        for head, joints in ((rigid, np.zeros(0)), (moving, np.zeros(4)))
        for left, right in [[project_point(head, name, joints, point) for name in pair]]
    )
    np.testing.assert_allclose(found.xyz, point, atol=1e-9)
    np.testing.assert_allclose(found.covariance, expected.covariance)


def test_points_of_one_image_have_its_time_stamp_each():
    head = replace(plain_head(0.075, 280.0), time_offset_s=0.04)
    t = np.arange(12) / 30
    eyes = 0.2 * np.cos(np.pi * t[:, None] + np.arange(4))
    which = np.repeat(np.arange(12), [1, 3, 2] * 4)
    several = joints_at_images(head, eyes[which], t[which])
    np.testing.assert_array_equal(several, joints_at_images(head, eyes, t)[which])
