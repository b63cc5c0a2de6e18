"""How well a designed head locates points."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike

from closed_form import predicted_depth_std
from test_design_sweep import SMALL
from vergence.accuracy.design import (
    VIEWS,
    Sensitivity,
    designed_head,
    fixating_joints,
    noise_mean_square,
    sensitivity,
    standard_recording,
)
from vergence.accuracy.design_sweep import (
    located_points,
)
from vergence.accuracy.plan_views import as_seen, shows_whole_board
from vergence.arrays import Array
from vergence.calibration.bundle_adjustment import NoiseModel, bundle_adjust
from vergence.geometry.board import Chessboard
from vergence.geometry.projection import project_point
from vergence.stereo.triangulation import triangulate_at
from vergence.stereo.uncertainty import locate

AHEAD_M = 0.02
BOARD = Chessboard(9, 6, 0.03)


def seen(baseline_m: float, focal_px: float, points: Array, off: ArrayLike = 0.0) -> Sensitivity:
    """Return the sensitivity of points from the middle between the eyes."""
    points = points - np.array([0.0, baseline_m / 2, 0.0])
    return sensitivity(
        designed_head(baseline_m, focal_px, AHEAD_M, (640, 480)),
        BOARD,
        points=points,
        joints=fixating_joints(baseline_m, points) + np.tile(off, 2),
        corner_std_px=0.1,
        reading_std=np.array([1e-3]),
    )


def test_far_ahead_it_is_equations_20_and_21():
    """Depth and baseline of these are those of the cameras, which sit ahead of eyes that converge.

    Errors sideways add less than half a percent.
    """
    for depth_m in (1.0, 3.0):
        one = seen(0.07, 400, np.array([[depth_m, 0.0, 0.0]]), np.zeros(2))
        found = np.sqrt(noise_mean_square(one, pixel_std_px=0.2, reading_std=3e-4)[0])
        closer = 2 * AHEAD_M * np.sin(np.arctan(0.035 / depth_m))
        baseline = 0.07 - closer
        wanted = predicted_depth_std(
            [depth_m, -baseline / 2, 0.0], baseline, 400, pixel_std_px=0.2, reading_std=3e-4,
            camera_ahead_m=AHEAD_M,
        )  # fmt: skip
        assert found == pytest.approx(wanted, rel=0.005)


@pytest.mark.parametrize("correlation", [-1.0, 0.0, 0.6, 1.0])
def test_samples_of_late_readings_scatter_as_stated(correlation):
    """Errors of the same joint in both eyes are correlated as the eyes' speeds are."""
    rng, n, late_rad = np.random.default_rng(1), 20_000, 5e-4
    middle, head = np.array([0.6, 0.15, -0.1]), designed_head(0.09, 400, AHEAD_M, (640, 480))
    point = middle - [0.0, 0.045, 0.0]
    joints = fixating_joints(0.09, point)
    left, right = (project_point(head, name, joints, point) for name in head.cameras)
    own, other = rng.normal(0, late_rad, (2, n, 2))
    right_error = correlation * own + np.sqrt(1 - correlation**2) * other
    found, _ = triangulate_at(
        head,
        left=np.broadcast_to(left, (n, 2)),
        right=np.broadcast_to(right, (n, 2)),
        joints=joints + np.concatenate([own, right_error], axis=1),
    )
    squares = ((found - point) ** 2).sum(axis=1)
    stated = noise_mean_square(
        seen(0.09, 400, middle[None], np.zeros((1, 2))),
        pixel_std_px=0.0, reading_std=0.0, late_rad=late_rad, correlation=correlation,
    )[0]  # fmt: skip
    standard_error = squares.std() / np.sqrt(n) / stated
    assert squares.mean() / stated == pytest.approx(1, abs=4 * standard_error + 0.005)


@pytest.mark.parametrize(("baseline_m", "focal_px"), [(0.06, 280.0), (0.1, 500.0)])
def test_noise_and_calibration_are_the_covariance_of_located_points(baseline_m, focal_px):
    """The calibration is bundle adjustment of the recording, as accurate as it states."""
    head = designed_head(baseline_m, focal_px, AHEAD_M, (640, 480))
    views = standard_recording(head, BOARD)
    assert shows_whole_board(head, BOARD, views).mean() > 0.9
    estimate = bundle_adjust(head, as_seen(head, BOARD, views), noise=NoiseModel(0.1, 1e-3))
    calibrated = replace(head, accuracy=estimate.accuracy)
    points, off = located_points(SMALL)
    points, off = points.reshape(-1, 3), np.tile(off, (2, 1))
    from_left = points - [0.0, baseline_m / 2, 0.0]
    joints = fixating_joints(baseline_m, from_left) + np.tile(off, 2)
    left, right = (project_point(head, name, joints, from_left) for name in head.cameras)
    located = {
        stated: locate(
            each, left=left, right=right, joints=joints, pixel_std_px=0.2, reading_std=1e-3
        )
        for stated, each in ((False, head), (True, calibrated))
    }
    noise, whole = (np.trace(located[k].covariance, axis1=1, axis2=2) for k in (False, True))
    found = seen(baseline_m, focal_px, points, off)
    by_noise = noise_mean_square(found, pixel_std_px=0.2, reading_std=1e-3)
    np.testing.assert_allclose(by_noise, noise, rtol=1e-3)
    by_views = found.calibration[0] / VIEWS
    np.testing.assert_allclose(by_views, whole - noise, rtol=0.02)
    np.testing.assert_allclose(by_noise + by_views, whole, rtol=0.01)
    reach = np.abs(np.stack([left, right]) - [319.5, 239.5]).max(axis=0)
    np.testing.assert_allclose(found.offset_px, reach, atol=1e-9)
