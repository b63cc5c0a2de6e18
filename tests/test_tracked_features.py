"""Features tracked in one eye: exact on exact data, true to their covariance."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulated_frames import (
    CAMERAS,
    JOINT_STD_RAD,
    NOISE_PX,
    begin,
    head_of,
    postures,
)
from simulated_matches import drawn_head, matches, room, squared_distance, tracked_features
from vergence.estimation.linear import posterior
from vergence.geometry.head import parameter_names
from vergence.geometry.parameters import boxminus, boxplus
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import inverse, transform
from vergence.self_calibration.filter import update
from vergence.self_calibration.frame import estimate_from_matches
from vergence.self_calibration.kalman import predict
from vergence.self_calibration.keyframe import (
    TURNED_RAD,
    add_tracked,
    augmented_covariance,
    worth_tracking,
)
from vergence.self_calibration.match_noise import RevisitCorrelation
from vergence.self_calibration.residuals import motion_coordinates, motion_residuals
from vergence.self_calibration.state import FilterState, FrameEstimate, TrackedFeatures
from vergence.stereo.extrinsics import camera_poses
from vergence.vision.matching.scene_features import Matches


@given(st.integers(0, 1000))
def test_features_tracked_by_the_true_geometry_have_no_residual(seed):
    head, rng = head_of(seed), np.random.default_rng(seed)
    then, now = postures(2, rng)
    for camera, (residuals, _) in motion_of(head, then, now, room(100, rng)):
        assert len(residuals) > 5, camera
        np.testing.assert_allclose(residuals, 0, atol=1e-7)


def motion_of(head, then, now, points, change=None, turned=(0.0, 0.0)):
    """Yield each camera and its residuals, of exact pixels by a head and angles that are not."""
    changed = head if change is None else boxplus(head, change)
    poses = [camera_poses(head, joints, cameras=CAMERAS) for joints in (then, now)]
    for k, camera in enumerate(CAMERAS):
        in_camera = [transform(inverse(T[k]), points) for T in poses]
        # Beyond its reach a lens folds back into the image.
        ahead = [p[:, 2] > 1.5 * np.linalg.norm(p[:, :2], axis=1) for p in in_camera]
        near = ahead[0] & ahead[1]
        earlier, later = (project_point(head, camera, j, points) for j in (then, now))
        moments = np.stack([then + turned[0], now + turned[1]])
        T_then, T_now = camera_poses(changed, moments, cameras=CAMERAS)[:, k]
        found = motion_residuals(
            changed.camera(camera).intrinsics,
            inverse(T_now) @ T_then,
            earlier=earlier[near],
            later=later[near],
            depths_m=in_camera[0][near, 2],
        )
        yield camera, found


@given(st.integers(0, 1000))
def test_residuals_of_tracked_features_change_as_their_derivatives_say(seed):
    head, rng = head_of(seed), np.random.default_rng(seed)
    then, now = postures(2, rng)
    points = room(100, rng)
    change, turns = rng.normal(0, 1, len(parameter_names(head))), rng.normal(0, 1, (2, 4))
    step = 1e-6
    ends = [
        [
            residuals
            for _, (residuals, _) in motion_of(head, then, now, points, h * change, h * turns)
        ]
        for h in (-step, step)
    ]
    names = parameter_names(head)
    exact = motion_of(head, then, now, points)
    for (camera, (_, J)), low, high in zip(exact, *ends, strict=True):
        slope = -(high - low) / (2 * step)  # the derivatives are of what is predicted
        by_unknowns = motion_coordinates(head, names, then, now, camera).by_unknowns
        expected = J[..., :-1] @ by_unknowns @ [*change, *turns[1], *turns[0]]
        np.testing.assert_allclose(slope, expected, rtol=1e-4, atol=2e-3)


def learned_while_moving(truth, state, angles, points, rng, *, track=True, noise_px=NOISE_PX):
    """Return the state after simulated frames at true angles (N, r), 0.5 s apart."""
    at = {}
    for now in angles:
        readings = now + rng.normal(0, JOINT_STD_RAD, len(now))
        seen = estimate_from_matches(
            state, matches(truth, now, points, noise_px=noise_px, rng=rng), readings
        )
        key, features = state.keyframe, None
        if track and key is not None and np.abs(readings - key.joints).max() >= TURNED_RAD:
            features = tracked_features(
                truth, key, then=at["key"], now=now, points=points, noise_px=noise_px, rng=rng
            )
        state = predict(update(state, seen, features), 0.5)
        if key is None or state.keyframe is None or state.keyframe.pixels is not key.pixels:
            at["key"] = now
    return state


def test_focal_lengths_and_gains_show_in_parallel_motion_if_features_are_tracked():
    head = head_of(1)
    phase = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    pan, tilt = 0.35 * np.sin(phase), 0.25 * np.cos(phase)
    angles = np.stack([pan, tilt, pan, tilt], axis=1)
    stds, errors = {}, {}
    for track in (False, True):
        rng = np.random.default_rng(0)
        state = begin(head)
        truth = drawn_head(state, rng)
        state = learned_while_moving(truth, state, angles, room(500, rng), rng, track=track)
        names = [n for n in state.names if n.endswith(("fx", "gain"))]
        difference = boxminus(truth, state.head)
        std = dict(zip(state.names, np.sqrt(np.diag(state.covariance)), strict=True))
        stds[track] = np.array([std[name] for name in names])
        errors[track] = np.array([difference[name] for name in names]) / stds[track]
    focal = np.array([name.endswith("fx") for name in names])
    assert (stds[True][focal] < 0.2 * stds[False][focal]).all()
    assert (stds[True] < 0.7 * stds[False]).all()
    assert (np.abs(errors[True]) < 3.5).all()


def test_features_are_tracked_to_postures_that_are_far_enough_and_new():
    head, rng = head_of(1), np.random.default_rng(0)
    points, there = room(300, rng), np.zeros(4)

    def seen_at(readings):
        found = matches(head, readings, points, noise_px=NOISE_PX, rng=rng)
        return estimate_from_matches(state, found, readings)

    state = begin(head)
    state = predict(update(state, seen_at(there)), 0.5)
    for turned, stood, worth in ((0.5, 0.0, False), (1.5, 0.0, True), (1.5, 1.5, False)):
        before = RevisitCorrelation(
            there[None] + stood * TURNED_RAD + 1e-3 * np.arange(60)[:, None], np.zeros(60), 60.0
        )
        state = replace(state, revisits=before)
        assert worth_tracking(state, seen_at(there + turned * TURNED_RAD)) == worth


@pytest.mark.slow
def test_stated_covariances_are_true_where_features_are_tracked():
    nominal, of_head, degrees = head_of(1), 0.0, 0
    for seed in range(5):
        rng = np.random.default_rng(seed)
        state = begin(nominal)
        truth = drawn_head(state, rng)
        angles = postures(12, rng)
        state = learned_while_moving(truth, state, angles, room(300, rng), rng)
        of_head += squared_distance(state, truth)
        degrees += len(state.names)
    # Simulated features share no errors, for which the variance is inflated: distances are about
    # two thirds, which five heads leave uncertain by a sixth of them.
    assert 0.45 < of_head / degrees < 1.3


def turned_once(wrong_rad: float = 0.0) -> tuple[FilterState, FrameEstimate, TrackedFeatures]:
    """Return the state after a frame, the next one, and features that were tracked to it.

    These are where they would be if both eyes had turned by some more.
    """
    head, rng = head_of(0), np.random.default_rng(0)
    points, state = room(400, rng), begin(head)
    then, now = np.zeros(4), np.array([0.2, 0.0, 0.2, 0.0])
    seen = estimate_from_matches(
        state, matches(head, then, points, noise_px=NOISE_PX, rng=rng), then
    )
    state = predict(update(state, seen), 0.5)
    assert state.keyframe is not None
    seen = estimate_from_matches(state, matches(head, now, points, noise_px=NOISE_PX, rng=rng), now)
    tracked = tracked_features(
        head,
        state.keyframe,
        then=then,
        now=now + wrong_rad,
        points=points,
        noise_px=NOISE_PX,
        rng=rng,
    )
    return state, seen, tracked


def test_features_that_moved_by_themselves_teach_nothing():
    state, seen, wrong = turned_once(np.radians(3))
    without, with_wrong = (update(state, seen, each) for each in (None, wrong))
    np.testing.assert_array_equal(with_wrong.covariance, without.covariance)


def test_depths_that_are_all_wrong_alike_do_not_move_the_cameras():
    """Else parallax, wrong by a few percents, would tell how far they are off the joints' axes."""
    head, rng = head_of(0), np.random.default_rng(0)
    points, state = room(400, rng), begin(head)
    then, now = np.zeros(4), np.array([0.2, 0.1, 0.2, 0.1])
    seen = estimate_from_matches(
        state, matches(head, then, points, noise_px=NOISE_PX, rng=rng), then
    )
    state = predict(update(state, seen), 0.5)
    assert state.keyframe is not None
    seen = estimate_from_matches(state, matches(head, now, points, noise_px=NOISE_PX, rng=rng), now)
    right = tracked_features(
        head, state.keyframe, then=then, now=now, points=points, noise_px=NOISE_PX, rng=rng
    )
    near, far = (
        replace(right, depths_m=(s * right.depths_m[0], s * right.depths_m[1])) for s in (0.9, 1.1)
    )
    ends = [update(state, seen, each).head for each in (near, far)]
    moved = boxminus(ends[1], ends[0])
    shifts_m = [moved[n] for n in state.names if n.endswith(("tx", "ty", "tz"))]
    assert max(np.abs(shifts_m)) < 2e-4


def told(state, seen, tracked):
    """Return what features tell beside the prior, and the change (K,) that they make."""
    C = augmented_covariance(state)
    zero = np.zeros_like(C), np.zeros(len(C))
    N, b = add_tracked(state, seen, tracked, zero)
    return np.linalg.norm(N), posterior(N, b, C)[0] / np.sqrt(np.diag(C))


def test_features_tell_as_little_as_the_posture_of_their_frame_is_new():
    state, seen, tracked = turned_once()
    (whole, _), (little, change) = (
        told(state, replace(seen, novelty=novelty), tracked) for novelty in (1.0, 1e-4)
    )
    assert whole / little == pytest.approx(1e4, rel=0.1)
    assert np.abs(change).max() < 0.1


def test_features_of_another_keyframe_and_few_ones_do_not_count():
    state, seen, tracked = turned_once()
    other = replace(tracked, readings=tracked.readings + 0.01)
    few = TrackedFeatures(
        tracked.readings,
        tuple(Matches(m.left[:11], m.right[:11], m.covariance[:11]) for m in tracked.matches),
        tuple(depths[:11] for depths in tracked.depths_m),
    )
    without, *others = (update(state, seen, each) for each in (None, other, few))
    for each in others:
        np.testing.assert_array_equal(each.covariance, without.covariance)
