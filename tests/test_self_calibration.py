"""Self-calibration from matches: exact on exact data, true to its covariance, never fooled."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from simulated_head import random_head
from simulated_matches import drawn_head, followed, matches, room
from uncalibrated_head import simulated
from vergence.geometry import se3
from vergence.geometry.camera import normalise
from vergence.geometry.head import HeadCalibration, load_head, save_head
from vergence.geometry.parameters import boxminus, boxplus, change_named, parameter_names
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import inverse, transform
from vergence.self_calibration.frame import from_matches, locate_seen
from vergence.self_calibration.keyframe import TURNED_RAD
from vergence.self_calibration.learning import learn, learn_followed, learned_head
from vergence.self_calibration.match_noise import recurrence_inflation, with_frame
from vergence.self_calibration.prior import UNCALIBRATED, tolerance_covariance
from vergence.self_calibration.residuals import epipolar_residuals, motion_residuals
from vergence.self_calibration.state import SelfCalibration, initial_self_calibration
from vergence.self_calibration.update import evidence_about
from vergence.stereo.extrinsics import T_rcam_lcam, camera_poses
from vergence.vision.scene_features import Matches

CAMERAS = ("left_wide", "right_wide")
NOISE_PX = 0.08
JOINT_STD_RAD = np.radians(0.15)


def head_of(seed: int) -> HeadCalibration:
    return random_head(np.random.default_rng(seed), lenses=("wide",))


def begin(head: HeadCalibration) -> SelfCalibration:
    """Return a state that is told the noise of simulated matches, but not that of the readings."""
    return replace(initial_self_calibration(head), match_scale=1.0)


def postures(frames: int, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(-0.25, 0.25, (frames, 4))


@given(st.integers(0, 1000))
def test_matches_of_the_true_geometry_have_no_residual(seed):
    head, rng = head_of(seed), np.random.default_rng(seed)
    angles = postures(1, rng)[0]
    seen = matches(head, angles, room(200, rng), noise_px=0.0, rng=rng)
    found = epipolar_residuals(head, angles, seen.left, seen.right, CAMERAS)
    np.testing.assert_allclose(found.residuals, 0, atol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1)


@given(st.integers(0, 1000))
def test_residuals_change_as_their_derivatives_say(seed):
    head, rng = head_of(seed), np.random.default_rng(seed)
    angles = postures(1, rng)[0]
    seen = matches(head, angles, room(40, rng), noise_px=0.0, rng=rng)

    def residuals(change: np.ndarray, turned: np.ndarray) -> np.ndarray:
        changed = boxplus(head, change)
        found = epipolar_residuals(changed, angles + turned, seen.left, seen.right, CAMERAS)
        return found.residuals

    found = epipolar_residuals(head, angles, seen.left, seen.right, CAMERAS)
    names, step = parameter_names(head), 1e-6
    change, turn = rng.normal(0, 1, len(names)), rng.normal(0, 1, 4)
    ends = [residuals(h * change, h * turn) for h in (-step, step)]
    slope = -(ends[1] - ends[0]) / (2 * step)  # the derivatives are of what is predicted
    expected = found.by_parameters @ change + found.by_readings @ turn
    np.testing.assert_allclose(slope, expected, rtol=1e-4, atol=1e-3)


def turn_error_deg(head, joints, truth, angles) -> float:
    T, T_true = T_rcam_lcam(head, joints), T_rcam_lcam(truth, angles)
    return float(np.degrees(np.linalg.norm(se3.boxminus(T, T_true)[:3])))


@pytest.mark.parametrize("seed", range(3))
def test_exact_matches_give_the_exact_pose_of_the_cameras(seed):
    """The readings are wrong by half a degree, the head is not."""
    head, rng = head_of(seed), np.random.default_rng(seed)
    state = begin(head)
    state = replace(state, covariance=1e-12 * state.covariance, joint_std_rad=np.radians(0.5))
    angles = postures(1, rng)[0]
    readings = angles + np.radians(0.5) * np.array([1, -1, -1, 1])
    exact = matches(head, angles, room(600, rng), noise_px=0.0, rng=rng)
    found = from_matches(state, exact, readings)
    assert found.status == "seen"
    assert turn_error_deg(head, readings, head, angles) > 0.5
    assert turn_error_deg(found.head, found.joints, head, angles) < 1e-3


def test_seven_of_ten_wrong_matches_change_little():
    head, rng = head_of(0), np.random.default_rng(0)
    state = begin(head)
    for angles in postures(5, rng):
        readings = angles + rng.normal(0, JOINT_STD_RAD, 4)
        seen = matches(head, angles, room(900, rng), noise_px=NOISE_PX, rng=rng, outliers=0.7)
        found = from_matches(state, seen, readings)
        assert found.status == "seen"
        assert turn_error_deg(found.head, found.joints, head, angles) < 0.05


def block_errors(seen: Matches, rng: np.random.Generator) -> Matches:
    """Return matches whose errors are half their own, half those of all in a block of 64 px."""
    column, row = (seen.left // 64).astype(int).T
    shared = rng.normal(0, NOISE_PX, (100, 2))[10 * row + column]
    return replace(seen, right=seen.right + shared)


def test_a_covariance_counts_errors_that_neighbouring_matches_share():
    head, points = head_of(0), room(900, np.random.default_rng(0))
    state = replace(begin(head), joint_std_rad=np.radians(0.5))
    state = replace(state, covariance=1e-12 * state.covariance)
    names, stds, squares = state.names, [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        angles = postures(1, rng)[0]
        seen = matches(head, angles, points, noise_px=NOISE_PX, rng=rng)
        readings = angles + rng.normal(0, state.joint_std_rad, 4)
        found = from_matches(state, block_errors(seen, rng), readings)
        error = (found.joints - angles)[[0, 2]] @ [1, -1]
        own = found.covariance[len(names) :, len(names) :][np.ix_([0, 2], [0, 2])]
        stds.append(np.sqrt([1, -1] @ own @ [1, -1]))
        squares.append((error / stds[-1]) ** 2)
        assert found.evidence is not None
        assert found.evidence.design_effect > 1.5
    low, high = chi2.interval(0.999, len(squares))
    assert low < sum(squares) < high


def test_what_is_seen_again_teaches_little_but_what_is_new_does():
    """A still head matches the same windows, with the same errors, thirty times in a second."""
    head, rng = head_of(0), np.random.default_rng(0)
    points, angles = room(300, rng), np.zeros(4)
    same = matches(head, angles, points, noise_px=NOISE_PX, rng=rng)
    focal = begin(head).names.index("left_wide.fx")
    stds = {}
    for kind in ("same", "new"):
        state = begin(head)
        for _ in range(60):
            new = matches(head, angles, points, noise_px=NOISE_PX, rng=rng)
            readings = angles + rng.normal(0, JOINT_STD_RAD, 4)
            found = from_matches(state, same if kind == "same" else new, readings)
            state = learn(state, found, 1 / 30)
        assert state.recurrence is not None
        stds[kind] = np.sqrt(state.covariance[focal, focal]), state.recurrence.correlation
    assert stds["new"][1] < 0.15
    assert stds["same"][1] > 0.7
    assert stds["same"][0] > 1.1 * stds["new"][0]


def test_a_scene_that_shows_nothing_leaves_head_and_readings_as_they_were():
    head, rng = head_of(0), np.random.default_rng(0)
    state, readings = begin(head), np.zeros(4)
    none = Matches(np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 2, 2)))
    wrong = matches(head, readings, room(40, rng), noise_px=NOISE_PX, rng=rng, outliers=1.0)
    for seen in (none, wrong):
        found = from_matches(state, seen, readings)
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
    for seed in range(20):
        rng = np.random.default_rng(seed)
        state = begin(nominal)
        names, before = state.names, state.covariance
        truth = drawn_head(state, rng)
        points = room(500, rng)
        angles, found = np.zeros(4), None
        for angles in postures(frames, rng):
            readings = angles + rng.normal(0, JOINT_STD_RAD, 4)
            seen = matches(truth, angles, points, noise_px=NOISE_PX, rng=rng)
            found = from_matches(state, seen, readings)
            state = learn(state, found, 0.0)
        assert found is not None
        target = np.array([0.8, 0.05, -0.05])
        pixels = [project_point(truth, name, angles, target)[None] for name in CAMERAS]
        where = locate_seen(found, left=pixels[0], right=pixels[1], pixel_std_px=1e-3)
        error = where.xyz[0] - target
        of_point.append(error @ np.linalg.solve(where.covariance[0], error))
        difference = boxminus(truth, state.head)
        wrong = np.array([difference[name] for name in names])
        of_head += float(wrong @ np.linalg.solve(state.covariance, wrong))
        degrees += len(names)
        stds.append(state.joint_std_rad)
        assert (np.diag(state.covariance) <= np.diag(before) * (1 + 1e-9)).all()
    # Twenty heads leave a tenth: each is linearised where it is still wrong.
    assert 0.7 < of_head / degrees < 1.25
    low, high = chi2.interval(0.999, 3 * len(of_point))
    assert low < sum(of_point) < high
    assert np.degrees(np.mean(stds)) == pytest.approx(0.15, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("noise_px", "seen_before", "features"), [(0.08, 40, 500), (0.05, 80, 1500)]
)
@pytest.mark.parametrize("axis", ["rx", "ry", "rz"])
def test_a_bumped_camera_is_reported_and_corrected(axis, noise_px, seen_before, features):
    """Also of a head that is known so well that a linear model of the bump would be too coarse."""
    head, rng = head_of(2), np.random.default_rng(3)
    truth, state, points = head, begin(head), room(features, rng)
    reported, angles, found = [], np.zeros(4), None
    for k, angles in enumerate(postures(seen_before + 10, rng)):
        if k == seen_before:
            name = f"left_wide.T_eye_cam.{axis}"
            truth = change_named(truth, [name], np.radians([1.0]))
        readings = angles + rng.normal(0, JOINT_STD_RAD, 4)
        seen = matches(truth, angles, points, noise_px=noise_px, rng=rng)
        found = from_matches(state, seen, readings)
        state = learn(state, found, 0.3)
        if state.bumped:
            reported.append(k)
    assert found is not None
    assert len(reported) == 1
    assert seen_before <= reported[0] < seen_before + 3
    assert turn_error_deg(found.head, found.joints, truth, angles) < 0.1


def uncalibrated(seed: int) -> tuple[SelfCalibration, HeadCalibration, np.random.Generator]:
    """Return what is known of a head by its drawing, and the head as it was built."""
    state, rng = begin(head_of(seed)), np.random.default_rng(seed)
    C = tolerance_covariance(state.head, state.names, UNCALIBRATED)
    change = rng.multivariate_normal(np.zeros(len(state.names)), C)
    return state, change_named(state.head, state.names, change), rng


def squared_distance(state: SelfCalibration, truth: HeadCalibration) -> float:
    difference = boxminus(truth, state.head)
    wrong = np.array([difference[name] for name in state.names])
    return float(wrong @ np.linalg.solve(state.covariance, wrong))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_a_head_that_is_not_as_calibrated_is_reported_and_learned(seed):
    """A drawing in place of a calibration: alone, most pairs contradict what it states."""
    state, truth, rng = uncalibrated(seed)
    points, reported, errors = room(500, rng), [], []
    for k, angles in enumerate(postures(20, rng)):
        readings = angles + rng.normal(0, JOINT_STD_RAD, 4)
        seen = matches(truth, angles, points, noise_px=NOISE_PX, rng=rng)
        found = from_matches(state, seen, readings)
        state = learn(state, found, 0.3)
        errors.append(turn_error_deg(found.head, found.joints, truth, angles))
        reported += [k] * state.uncalibrated
        assert not state.bumped
    assert len(reported) == 1
    assert reported[0] < 6
    assert max(errors) > 0.5
    assert max(errors[8:]) < 0.1
    assert squared_distance(state, truth) < chi2.isf(1e-4, len(state.names))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [14])
def test_slow_motion_of_a_head_that_is_hardly_known_does_not_seem_to_show_its_scale(seed):
    """Linearised at a different head each, frames would together determine what none shows."""
    steps, truth = simulated(seed, pairs=65)
    _, state, _ = steps[-1]
    assert squared_distance(state, truth) < chi2.isf(1e-4, len(state.names))


def test_evidence_about_another_head_says_the_same():
    head, rng = head_of(0), np.random.default_rng(0)
    state, angles = begin(head), postures(1, rng)[0]
    seen = matches(head, angles, room(300, rng), noise_px=NOISE_PX, rng=rng)
    says = from_matches(state, seen, angles).evidence
    assert says is not None
    change = np.zeros(len(says.vector))
    change[: len(state.names)] = 1e-5 * rng.normal(size=len(state.names))
    moved = replace(state, head=change_named(head, state.names, change[: len(state.names)]))
    other = evidence_about(moved, says, head)
    # The same change fits best, from where the head is now, and as well.
    expected = says.information @ change
    np.testing.assert_allclose(
        says.vector - other.vector, expected, atol=1e-3 * np.abs(expected).max()
    )
    rest = [
        e.misfit - e.vector @ np.linalg.pinv(says.information) @ e.vector for e in (says, other)
    ]
    assert rest[1] == pytest.approx(rest[0], rel=1e-3)


def test_a_learned_head_is_a_calibration_with_its_accuracy(tmp_path):
    head, rng = head_of(0), np.random.default_rng(0)
    state = begin(head)
    for angles in postures(3, rng):
        seen = matches(head, angles, room(300, rng), noise_px=NOISE_PX, rng=rng)
        state = learn(state, from_matches(state, seen, angles), 0.3)
    save_head(learned_head(state), tmp_path / "learned.json")
    again = load_head(tmp_path / "learned.json")
    assert again.accuracy is not None
    np.testing.assert_allclose(again.accuracy.covariance, state.covariance, rtol=1e-9)
    assert initial_self_calibration(again).names == state.names


@given(st.integers(0, 1000))
def test_features_followed_by_the_true_geometry_have_no_residual(seed):
    head, rng = head_of(seed), np.random.default_rng(seed)
    then, now = postures(2, rng)
    for camera, found in motion_of(head, then, now, room(100, rng)):
        assert len(found.residuals) > 5, camera
        np.testing.assert_allclose(found.residuals, 0, atol=1e-7)


def motion_of(head, then, now, points, change=None, turned=(0.0, 0.0)):
    """Yield each camera and its residuals, of exact pixels by a head and angles that are not."""
    changed = head if change is None else boxplus(head, change)
    poses = [camera_poses(head, joints, cameras=CAMERAS) for joints in (then, now)]
    for k, camera in enumerate(CAMERAS):
        in_camera = [transform(inverse(T[k]), points) for T in poses]
        # Beyond its reach a lens folds back into the image.
        ahead = [p[:, 2] > 1.5 * np.linalg.norm(p[:, :2], axis=1) for p in in_camera]
        near, T = ahead[0] & ahead[1], poses[0][k]
        earlier, later = (project_point(head, camera, j, points) for j in (then, now))
        # A changed geometry sees the point as far along the ray as the unchanged one.
        rays = points - T[:3, 3]
        T_changed = camera_poses(changed, then + turned[0], cameras=CAMERAS)[k]
        xy = normalise(changed.camera(camera).intrinsics, earlier)
        changed_rays = np.column_stack([xy, np.ones(len(xy))]) @ T_changed[:3, :3].T
        along = np.einsum("ni,ni->n", rays, points - T_changed[:3, 3])
        depths = along / np.einsum("ni,ni->n", rays, changed_rays)
        found = motion_residuals(
            changed,
            camera,
            before=then + turned[0],
            now=now + turned[1],
            earlier=earlier[near],
            later=later[near],
            depths_m=depths[near],
        )
        yield camera, found


@given(st.integers(0, 1000))
def test_residuals_of_followed_features_change_as_their_derivatives_say(seed):
    head, rng = head_of(seed), np.random.default_rng(seed)
    then, now = postures(2, rng)
    points = room(100, rng)
    change, turns = rng.normal(0, 1, len(parameter_names(head))), rng.normal(0, 1, (2, 4))
    step = 1e-6
    ends = [
        [found.residuals for _, found in motion_of(head, then, now, points, h * change, h * turns)]
        for h in (-step, step)
    ]
    for (_, found), low, high in zip(motion_of(head, then, now, points), *ends, strict=True):
        slope = -(high - low) / (2 * step)  # the derivatives are of what is predicted
        expected = found.by_parameters @ change + found.by_before @ turns[0]
        expected += found.by_now @ turns[1]
        np.testing.assert_allclose(slope, expected, rtol=1e-4, atol=2e-3)


def learned_while_moving(truth, state, angles, points, rng, *, follow=True, noise_px=NOISE_PX):
    """Return the state after simulated frames at true angles (N, r), 0.5 s apart."""
    at = {}
    for now in angles:
        readings = now + rng.normal(0, JOINT_STD_RAD, len(now))
        seen = from_matches(
            state, matches(truth, now, points, noise_px=noise_px, rng=rng), readings
        )
        key, features = state.keyframe, None
        if follow and key is not None and np.abs(readings - key.joints).max() >= TURNED_RAD:
            features = followed(
                truth, key, then=at["key"], now=now, points=points, noise_px=noise_px, rng=rng
            )
        state = learn_followed(state, seen, features, 0.5)
        if key is None or state.keyframe is None or state.keyframe.pixels is not key.pixels:
            at["key"] = now
    return state


def test_focal_lengths_and_gains_show_in_parallel_motion_if_features_are_followed():
    head = head_of(1)
    phase = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    pan, tilt = 0.35 * np.sin(phase), 0.25 * np.cos(phase)
    angles = np.stack([pan, tilt, pan, tilt], axis=1)
    stds, errors = {}, {}
    for follow in (False, True):
        rng = np.random.default_rng(0)
        state = begin(head)
        truth = drawn_head(state, rng)
        state = learned_while_moving(truth, state, angles, room(500, rng), rng, follow=follow)
        names = [n for n in state.names if n.endswith(("fx", "gain"))]
        difference = boxminus(truth, state.head)
        std = dict(zip(state.names, np.sqrt(np.diag(state.covariance)), strict=True))
        stds[follow] = np.array([std[name] for name in names])
        errors[follow] = np.array([difference[name] for name in names]) / stds[follow]
    focal = np.array([name.endswith("fx") for name in names])
    assert (stds[True][focal] < 0.2 * stds[False][focal]).all()
    assert (stds[True] < 0.7 * stds[False]).all()
    assert (np.abs(errors[True]) < 3.5).all()


@pytest.mark.slow
def test_stated_covariances_are_true_where_features_are_followed():
    nominal, of_head, degrees = head_of(1), 0.0, 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        state = begin(nominal)
        truth = drawn_head(state, rng)
        angles = postures(12, rng)
        state = learned_while_moving(truth, state, angles, room(500, rng), rng)
        difference = boxminus(truth, state.head)
        wrong = np.array([difference[name] for name in state.names])
        of_head += float(wrong @ np.linalg.solve(state.covariance, wrong))
        degrees += len(state.names)
    assert 0.6 < of_head / degrees < 1.3


def test_features_that_moved_by_themselves_teach_nothing():
    head, rng = head_of(0), np.random.default_rng(0)
    points, state = room(400, rng), begin(head)
    then, now = np.zeros(4), np.array([0.2, 0.0, 0.2, 0.0])
    seen = from_matches(state, matches(head, then, points, noise_px=NOISE_PX, rng=rng), then)
    state = learn(state, seen, 0.5)
    assert state.keyframe is not None
    seen = from_matches(state, matches(head, now, points, noise_px=NOISE_PX, rng=rng), now)
    turned = now + np.radians(3) * np.array([1, 1, 1, 1])
    wrong = followed(
        head, state.keyframe, then=then, now=turned, points=points, noise_px=NOISE_PX, rng=rng
    )
    without, with_wrong = (learn_followed(state, seen, each, 0.5) for each in (None, wrong))
    np.testing.assert_array_equal(with_wrong.covariance, without.covariance)


def test_depths_that_are_all_wrong_alike_do_not_move_the_cameras():
    """Else parallax, wrong by a few percents, would tell how far they are off the joints' axes."""
    head, rng = head_of(0), np.random.default_rng(0)
    points, state = room(400, rng), begin(head)
    then, now = np.zeros(4), np.array([0.2, 0.1, 0.2, 0.1])
    seen = from_matches(state, matches(head, then, points, noise_px=NOISE_PX, rng=rng), then)
    state = learn(state, seen, 0.5)
    assert state.keyframe is not None
    seen = from_matches(state, matches(head, now, points, noise_px=NOISE_PX, rng=rng), now)
    right = followed(
        head, state.keyframe, then=then, now=now, points=points, noise_px=NOISE_PX, rng=rng
    )
    near, far = (
        replace(right, depths_m=(s * right.depths_m[0], s * right.depths_m[1])) for s in (0.9, 1.1)
    )
    ends = [learn_followed(state, seen, each, 0.5).head for each in (near, far)]
    moved = boxminus(ends[1], ends[0])
    shifts_m = [moved[n] for n in state.names if n.endswith(("tx", "ty", "tz"))]
    assert max(np.abs(shifts_m)) < 2e-4


def test_a_keyframe_stays_until_the_eyes_have_turned():
    head, rng = head_of(0), np.random.default_rng(0)
    points, state = room(400, rng), begin(head)
    kept = []
    for pan in np.radians([0.0, 3.0, 6.0, 9.0, 12.0]):
        joints = np.array([pan, 0.0, pan, 0.0])
        seen = matches(head, joints, points, noise_px=NOISE_PX, rng=rng)
        state = learn(state, from_matches(state, seen, joints), 0.5)
        assert state.keyframe is not None
        kept.append(np.degrees(state.keyframe.joints[0]))
    np.testing.assert_allclose(kept, [0, 0, 0, 9, 9], atol=0.5)


def test_a_frame_counts_by_what_its_posture_adds():
    """At one posture n frames tell as much as n / (1 + c (n - 1)) independent ones."""
    joints, blocks = np.zeros(4), np.ones(8)
    before, told, c = None, 0.0, 0.3
    for n in range(1, 6):
        told += 1 / recurrence_inflation(before, joints, 0.0)
        assert told == pytest.approx(n / (1 + c * (n - 1)))
        before = replace(with_frame(before, joints, blocks, 0.0), correlation=c)
    assert recurrence_inflation(before, joints + np.radians(30), 0.0) == pytest.approx(1, abs=1e-3)
    assert recurrence_inflation(before, joints, 3600.0) == pytest.approx(1, abs=1e-3)
