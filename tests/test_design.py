"""How well a designed head locates points: the closed form is that of located points."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulated_head import plain_head
from test_design_sweep import SMALL
from vergence.accuracy.design import gaze_at, joint_std_rad, mean_square, sensitivity
from vergence.accuracy.design_effort import (
    VIEWS,
    calibration_mean_square,
    designed_head,
    standard_recording,
)
from vergence.accuracy.design_sweep import (
    located_points,
)
from vergence.accuracy.plan_views import as_seen, held_whole
from vergence.arrays import Array
from vergence.calibration.bundle.bundle_adjustment import bundle_adjust
from vergence.geometry.board import Chessboard
from vergence.geometry.head import HeadCalibration
from vergence.geometry.projection import project_point
from vergence.stereo.depth_error import predicted_depth_std
from vergence.stereo.triangulation import triangulate_at
from vergence.stereo.uncertainty import locate

AHEAD_M = 0.02


def of_design(baseline_m: float, focal_px: float) -> HeadCalibration:
    return plain_head(baseline_m, focal_px, camera_m=((AHEAD_M, 0, 0),) * 2)


def pixels(head: HeadCalibration, joints: Array, points: Array, baseline_m: float) -> list[Array]:
    """Return the pixels of points from the middle between the eyes."""
    from_left = points - [0.0, baseline_m / 2, 0.0]
    return [project_point(head, name, joints, from_left) for name in head.cameras]


@given(
    baseline_m=st.floats(0.03, 0.3),
    focal_px=st.floats(200, 2000),
    x=st.floats(0.25, 3),
    aside=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.4, 0.4)),
    off=st.tuples(st.floats(-0.15, 0.15), st.floats(-0.15, 0.15)),
    noise=st.tuples(st.floats(0.01, 2), st.floats(1e-5, 5e-3)),
)
def test_the_closed_form_is_the_covariance_of_a_located_point(
    baseline_m, focal_px, x, aside, off, noise
):
    point = np.array([[x, x * aside[0], x * aside[1]]])
    head, off_rad = of_design(baseline_m, focal_px), np.array(off)
    joints = np.stack(gaze_at(np.array(baseline_m), point), axis=-1) + np.tile(off_rad, 2)
    left, right = pixels(head, joints, point, baseline_m)
    located = locate(
        head, left=left, right=right, joints=joints, pixel_std_px=noise[0], joint_std_rad=noise[1]
    )
    seen = sensitivity(baseline_m, point, camera_ahead_m=AHEAD_M, off_rad=off_rad)
    found = mean_square(seen, focal_px=focal_px, pixel_std_px=noise[0], joint_std_rad=noise[1])
    np.testing.assert_allclose(found[0], np.trace(located.covariance[0]), rtol=0.01)
    pinned = np.array([[319.5, 239.5]])
    reach = max(np.abs((uv - pinned) / focal_px)[0, 0] for uv in (left, right))
    np.testing.assert_allclose(seen.image_x[0], reach, rtol=1e-9, atol=1e-9)


def test_far_ahead_it_is_equations_20_and_21():
    """Depth and baseline of these are those of the cameras, which sit ahead of eyes that converge.

    Errors sideways add less than half a percent.
    """
    for depth_m in (1.0, 3.0):
        point = np.array([depth_m, 0.0, 0.0])
        seen = sensitivity(0.07, point, camera_ahead_m=AHEAD_M)
        found = np.sqrt(mean_square(seen, focal_px=400, pixel_std_px=0.2, joint_std_rad=3e-4))
        closer = 2 * AHEAD_M * np.sin(np.arctan(0.035 / depth_m))
        baseline = 0.07 - closer
        wanted = predicted_depth_std(
            [depth_m, -baseline / 2, 0.0], baseline, 400, pixel_std_px=0.2, joint_std_rad=3e-4,
            camera_ahead_m=AHEAD_M,
        )  # fmt: skip
        assert found == pytest.approx(wanted, rel=0.005)


@pytest.mark.parametrize("correlation", [-1.0, 0.0, 0.6, 1.0])
def test_samples_of_late_readings_scatter_as_stated(correlation):
    """Errors of the same joint in both eyes are correlated as the eyes' speeds are."""
    rng, n, late_rad, baseline_m = np.random.default_rng(1), 20_000, 5e-4, 0.09
    point, head = np.array([0.6, 0.15, -0.1]), of_design(0.09, 400)
    joints = np.array(gaze_at(np.array(baseline_m), point))
    left, right = pixels(head, joints, point, baseline_m)
    own, other = rng.normal(0, late_rad, (2, n, 2))
    right_error = correlation * own + np.sqrt(1 - correlation**2) * other
    found, _ = triangulate_at(
        head,
        left=np.broadcast_to(left, (n, 2)),
        right=np.broadcast_to(right, (n, 2)),
        joints=joints + np.concatenate([own, right_error], axis=1),
    )
    squares = ((found + np.array([0, baseline_m / 2, 0]) - point) ** 2).sum(axis=1)
    stated = mean_square(
        sensitivity(baseline_m, point, camera_ahead_m=AHEAD_M),
        focal_px=400, pixel_std_px=0.0, joint_std_rad=0.0, late_rad=late_rad,
        correlation=correlation,
    )  # fmt: skip
    standard_error = squares.std() / np.sqrt(n) / stated
    assert squares.mean() / stated == pytest.approx(1, abs=4 * standard_error + 0.005)


def test_an_encoder_rounds_uniformly():
    step = 2 * np.pi / 4096
    errors = np.random.default_rng(0).uniform(-step / 2, step / 2, 100_000)
    assert joint_std_rad(4096, 0.0) == pytest.approx(errors.std(), rel=0.01)
    assert joint_std_rad(0, 0.1) == np.radians(0.1)
    assert joint_std_rad(4096, 0.1) == pytest.approx(np.hypot(errors.std(), np.radians(0.1)), 1e-3)


@pytest.mark.parametrize(("baseline_m", "focal_px"), [(0.06, 280.0), (0.1, 500.0)])
def test_what_the_calibration_adds_is_what_bundle_adjustment_of_the_recording_states(
    baseline_m, focal_px
):
    """And with the noise of a point, it is the whole covariance of `locate`."""
    board = Chessboard(9, 6, 0.03)
    head = designed_head(baseline_m, focal_px, AHEAD_M, (640, 480))
    views = standard_recording(head, board)
    assert held_whole(head, board, views).mean() > 0.9
    estimate = bundle_adjust(head, as_seen(head, board, views), pixel_std_px=0.1, joint_std=1e-3)
    calibrated = replace(head, accuracy=estimate.accuracy)
    points, off = located_points(SMALL)
    points, off = points.reshape(-1, 3), np.tile(off, (2, 1))
    joints = np.stack(gaze_at(np.array(baseline_m), points), axis=-1) + np.tile(off, 2)
    left, right = pixels(head, joints, points, baseline_m)
    located = locate(
        calibrated, left=left, right=right, joints=joints, pixel_std_px=0.2, joint_std_rad=1e-3
    )
    by_views = calibration_mean_square(
        head,
        board,
        points_m=points - [0.0, baseline_m / 2, 0.0],
        joints=joints,
        corner_std_px=0.1,
        joint_std_rad=np.array([1e-3]),
    )[0]
    seen = sensitivity(baseline_m, points, camera_ahead_m=AHEAD_M, off_rad=off)
    noise = mean_square(seen, focal_px=focal_px, pixel_std_px=0.2, joint_std_rad=1e-3)
    whole = np.trace(located.covariance, axis1=1, axis2=2)
    np.testing.assert_allclose(by_views / VIEWS, whole - noise, rtol=0.02)
    np.testing.assert_allclose(noise + by_views / VIEWS, whole, rtol=0.01)
