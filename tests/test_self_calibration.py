"""Self-calibration from matches: exact on exact data, true to its covariance, never fooled."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from drawn_head import four_cameras
from head_kinds import KINDS
from head_kinds import head_of as head_of_kind
from simulated_frames import (
    CAMERAS,
    JOINT_STD_RAD,
    NOISE_PX,
    begin,
    head_of,
    postures,
)
from simulated_matches import drawn_head, matches, room, squared_distance, turn_error_deg
from vergence.errors import VergenceError
from vergence.geometry.head import parameter_names, reading_stds
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import Side
from vergence.geometry.parameters import boxplus, change_between, parameter_values
from vergence.geometry.projection import project_point
from vergence.self_calibration import filter as self_calibration_filter
from vergence.self_calibration.filter import learned_head, update
from vergence.self_calibration.frame import estimate_from_matches, locate_in_frame
from vergence.self_calibration.kalman import predict
from vergence.self_calibration.prior import initial_state
from vergence.self_calibration.residuals import epipolar_residuals, pair_coordinates
from vergence.stereo.extrinsics import relative_camera_pose
from vergence.vision.matching.scene_features import Matches


def pair_of(head, angles):
    """Return the lenses of the main cameras, and T_rcam_lcam."""
    lenses = tuple(head.camera(name).intrinsics for name in CAMERAS)
    return lenses, relative_camera_pose(head, angles, cameras=CAMERAS)


@given(st.integers(0, 1000))
def test_matches_of_the_true_geometry_have_no_residual(seed):
    head, rng = head_of(seed), np.random.default_rng(seed)
    angles = postures(1, rng)[0]
    seen = matches(head, angles, room(200, rng), noise_px=0.0, rng=rng)
    found = epipolar_residuals(*pair_of(head, angles), seen.left, seen.right)
    np.testing.assert_allclose(found.residuals, 0, atol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1)


@given(st.integers(0, 1000))
def test_residuals_change_as_their_derivatives_say(seed):
    head, rng = head_of(seed), np.random.default_rng(seed)
    angles = postures(1, rng)[0]
    seen = matches(head, angles, room(40, rng), noise_px=0.0, rng=rng)

    def residuals(change: np.ndarray, turned: np.ndarray) -> np.ndarray:
        changed = boxplus(head, change)
        pair = pair_of(changed, angles + turned)
        return epipolar_residuals(*pair, seen.left, seen.right).residuals

    found = epipolar_residuals(*pair_of(head, angles), seen.left, seen.right)
    names, step = parameter_names(head), 1e-6
    change, turn = rng.normal(0, 1, len(names)), rng.normal(0, 1, 4)
    ends = [residuals(h * change, h * turn) for h in (-step, step)]
    slope = -(ends[1] - ends[0]) / (2 * step)  # the derivatives are of what is predicted
    pair = pair_coordinates(head, names, angles, CAMERAS)
    expected = found.by_coordinates @ pair.by_unknowns @ [*change, *turn]
    np.testing.assert_allclose(slope, expected, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_exact_matches_give_the_exact_pose_of_the_cameras(seed):
    """The readings are wrong by half a degree, the head is not."""
    head, rng = head_of(seed), np.random.default_rng(seed)
    state = begin(head)
    state = replace(state, covariance=1e-12 * state.covariance, reading_std=np.radians(0.5))
    angles = postures(1, rng)[0]
    readings = angles + np.radians(0.5) * np.array([1, -1, -1, 1])
    exact = matches(head, angles, room(600, rng), noise_px=0.0, rng=rng)
    found = estimate_from_matches(state, exact, readings)
    assert found.status == "seen"
    assert turn_error_deg(head, readings, head, angles) > 0.5
    assert turn_error_deg(found.head, found.joints, head, angles) < 1e-3


def test_seven_of_ten_wrong_matches_change_little():
    head, rng = head_of(0), np.random.default_rng(0)
    state, errors = begin(head), []
    for angles in postures(10, rng):
        readings = angles + rng.normal(0, JOINT_STD_RAD, 4)
        seen = matches(head, angles, room(900, rng), noise_px=NOISE_PX, rng=rng, outliers=0.7)
        found = estimate_from_matches(state, seen, readings)
        assert found.status == "seen"
        errors.append(turn_error_deg(found.head, found.joints, head, angles))
    assert np.median(errors) < 0.04
    assert max(errors) < 0.1  # readings alone: 0.24 in the median


def test_a_scene_that_shows_nothing_leaves_head_and_readings_as_they_were():
    head, rng = head_of(0), np.random.default_rng(0)
    state, readings = begin(head), np.zeros(4)
    none = Matches(np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 2, 2)))
    wrong = matches(head, readings, room(40, rng), noise_px=NOISE_PX, rng=rng, outliers=1.0)
    for seen in (none, wrong):
        found = estimate_from_matches(state, seen, readings)
        assert found.status != "seen"
        assert found.head is head
        np.testing.assert_array_equal(found.joints, readings)


@pytest.mark.slow
def test_stated_covariances_are_true_for_heads_drawn_at_random():
    """Of the learned parameters and of a point, by squared Mahalanobis distances in sum.

    Noise of the readings is not told: it is 0.15 degrees, and assumed 0.2, which still counts
    for five of about thirty readings here.
    """
    nominal, frames = head_of(1), 12
    of_head, of_point, stds, degrees = 0.0, [], [], 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        state = begin(nominal)
        before = state.covariance
        truth = drawn_head(state, rng)
        points = room(300, rng)
        angles, found = np.zeros(4), None
        for angles in postures(frames, rng):
            readings = angles + rng.normal(0, JOINT_STD_RAD, 4)
            seen = matches(truth, angles, points, noise_px=NOISE_PX, rng=rng)
            found = estimate_from_matches(state, seen, readings)
            state = update(state, found)
        assert found is not None
        target = np.array([0.8, 0.05, -0.05])
        pixels = [project_point(truth, name, angles, target)[None] for name in CAMERAS]
        where = locate_in_frame(found, left=pixels[0], right=pixels[1], pixel_std_px=1e-3)
        error = where.xyz[0] - target
        of_point.append(error @ np.linalg.solve(where.covariance[0], error))
        of_head += squared_distance(state, truth)
        degrees += len(state.names)
        stds.append(state.reading_std)
        assert (np.diag(state.covariance) <= np.diag(before) * (1 + 1e-9)).all()
    # Twelve heads leave an eighth: each is linearised where it is still wrong.
    assert 0.65 < of_head / degrees < 1.3
    low, high = chi2.interval(0.999, 3 * len(of_point))
    assert low < sum(of_point) < high
    assert np.degrees(np.mean(stds)) == pytest.approx(0.15, abs=0.02)


def test_a_frame_at_a_posture_that_was_learned_from_tells_no_more_of_the_head():
    """The same errors again: the head stays, and only the joints follow the images."""
    rng, state = np.random.default_rng(5), begin(head_of(5))
    truth, joints = drawn_head(state, rng), postures(1, rng)[0]
    pair = matches(truth, joints, room(400, rng), noise_px=NOISE_PX, rng=rng)
    for _ in range(30):
        state = predict(update(state, estimate_from_matches(state, pair, joints)), 0.1)
    again = estimate_from_matches(state, pair, joints)
    assert again.evidence is not None
    P = len(state.names)
    before = np.sqrt(np.diag(state.covariance))
    moved = change_between(again.head, state.head, state.names) / before
    assert np.abs(moved).max() < 0.02
    np.testing.assert_allclose(np.sqrt(np.diag(again.covariance))[:P], before, rtol=0.02)
    # Elsewhere it tells what is new.
    away = joints + np.radians([25.0, -20.0, -25.0, 20.0])
    elsewhere = matches(truth, away, room(400, rng), noise_px=NOISE_PX, rng=rng)
    other = estimate_from_matches(state, elsewhere, away)
    assert (np.diag(other.covariance)[:P] < 0.9 * before**2).any()


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "one eye"])
def test_heads_of_every_kind_are_learned(kind):
    """Whatever their joints, lenses and image sizes, with cameras that are rolled by any angle."""
    rng = np.random.default_rng([3, KINDS.index(kind)])
    state = replace(initial_state(head_of_kind(kind, rng)), match_scale=1.0)
    truth, points = drawn_head(state, rng), room(500, rng)
    errors_deg, statuses = [], set()
    readings = len(truth.kinematics.readings)
    for angles in rng.uniform(-0.25, 0.25, (20, readings)):
        given = angles + rng.normal(0, JOINT_STD_RAD, readings)
        pair = state.cameras
        seen = matches(truth, angles, points, noise_px=NOISE_PX, rng=rng, cameras=pair)
        found = estimate_from_matches(state, seen, given)
        errors_deg.append(turn_error_deg(found.head, found.joints, truth, angles, pair))
        statuses.add(found.status)
        state = predict(update(state, found), 0.3)
    assert statuses == {"seen"}
    assert squared_distance(state, truth) < chi2.isf(1e-4, len(state.names))
    # Half of what readings are wrong by: of 88 drawn heads 0.018 in the mean, 0.062 at most.
    assert np.mean(errors_deg[5:]) < np.degrees(JOINT_STD_RAD) / 2


def test_readings_before_a_gear_teach_what_those_behind_it_do():
    head, gear = head_of(0), 100.0
    eyes: dict[Side, tuple[Joint, ...]] = {
        eye: tuple(
            replace(joint, readings=dict.fromkeys(joint.readings, 1 / gear)) for joint in joints
        )
        for eye, joints in head.kinematics.eyes.items()
    }
    before_it = replace(head, kinematics=replace(head.kinematics, eyes=eyes))
    learned = []
    for each, factor in ((head, 1.0), (before_it, gear)):
        state, rng = begin(each), np.random.default_rng(0)
        truth, points = drawn_head(begin(head), rng), room(300, rng)
        for angles in postures(5, rng):
            read = factor * (angles + rng.normal(0, JOINT_STD_RAD, 4))
            seen = matches(truth, angles, points, noise_px=NOISE_PX, rng=rng)
            state = predict(update(state, estimate_from_matches(state, seen, read)), 0.3)
        learned.append(state)
    one, other = learned
    std = np.sqrt(np.diag(one.covariance))
    values, others = (parameter_values(each.head) for each in learned)
    for name, scale in zip(one.names, std, strict=True):
        value = values[name]
        assert value is None or abs(others[name] - value) < 1e-3 * scale
    np.testing.assert_allclose(np.sqrt(np.diag(other.covariance)), std, rtol=1e-3)
    stds = [reading_stds(learned_head(each)) for each in learned]
    np.testing.assert_allclose(stds[1], gear * stds[0], rtol=1e-3)


def test_the_first_frames_are_linearised_again_at_their_end_though_one_was_not_believed(
    monkeypatch,
):
    found, again = [], self_calibration_filter._relinearise

    def counted(past, after):
        found.append(len(past))
        return again(past, after)

    monkeypatch.setattr(self_calibration_filter, "_RELINEARISED", (2, 4, 8))
    monkeypatch.setattr(self_calibration_filter, "_relinearise", counted)
    head, rng = head_of(1), np.random.default_rng(1)
    state, points = begin(head), room(300, rng)
    for k, angles in enumerate(postures(8, rng)):
        seen = matches(head, angles, points, noise_px=NOISE_PX, rng=rng)
        readings = angles + rng.normal(0, JOINT_STD_RAD, 4) + np.radians(8.0) * (k == 5)
        frame = estimate_from_matches(state, seen, readings)
        assert (frame.status == "contradiction") == (k == 5)
        state = predict(update(state, frame), 0.3)
    assert state.settled
    assert found == [2, 4, 7]


def test_readings_keep_the_ratio_of_noise_with_which_they_were_calibrated():
    stated = np.radians([0.06, 0.1])
    head = replace(head_of(0), accuracy=Accuracy("bundle", joint_std=tuple(stated)))
    state, rng = initial_state(head), np.random.default_rng(0)
    np.testing.assert_allclose(state.reading_std_rad, np.tile(stated, 2), rtol=1e-9)
    truth, points = drawn_head(state, rng), room(300, rng)
    for angles in postures(16, rng):
        readings = angles + rng.normal(0, np.tile(2 * stated, 2))
        seen = matches(truth, angles, points, noise_px=NOISE_PX, rng=rng)
        state = predict(update(state, estimate_from_matches(state, seen, readings)), 0.3)
    np.testing.assert_allclose(state.reading_std_rad, np.tile(2 * stated, 2), rtol=0.3)
    np.testing.assert_allclose(learned_head(state).accuracy.joint_std, 2 * stated, rtol=0.3)


def test_a_head_whose_joints_were_not_calibrated_is_refused():
    measured = Accuracy("bundle", joint_std=(1e-3, 1e-4), eye_motion="poses")
    with pytest.raises(VergenceError, match="calibrated with measured eye poses"):
        initial_state(replace(head_of(0), accuracy=measured))


def test_a_seen_frame_locates_by_the_cameras_that_saw_it():
    head, cameras = four_cameras(), ("left_narrow", "right_narrow")
    state = initial_state(head, cameras=cameras)
    rng, joints, point = np.random.default_rng(0), np.zeros(4), np.array([[1.0, -0.03, 0.0]])
    seen = matches(head, joints, room(3000, rng), noise_px=NOISE_PX, rng=rng, cameras=cameras)
    found = estimate_from_matches(state, seen, joints)
    left, right = (project_point(head, name, joints, point) for name in cameras)
    where = locate_in_frame(found, left=left, right=right, pixel_std_px=0.1)
    np.testing.assert_allclose(where.xyz, point, atol=0.03)
