"""The pose between two cameras that see the same board."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulated_head import random_camera, random_pose
from test_intrinsics import POINTS, SINGLE_PRECISION_POSE, SINGLE_PRECISION_PX, boards, views
from vergence.calibration.initial import calibrate_pair
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera
from vergence.geometry.se3 import pose


def pair(
    rng: np.random.Generator, n: int = 8
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray], tuple[Camera, Camera]]:
    """Return T_b_a, corners (n, K, 2) in both cameras, and the cameras, without skew."""
    skewed = random_camera(rng), random_camera(rng)  # OpenCV knows no skew
    a, b = (replace(camera, matrix=camera.matrix * (1 - np.eye(3, k=1))) for camera in skewed)
    T_b_a = random_pose(rng, 0.05, 0.002) @ pose(t=[0.09, 0, 0])
    T_a_target = pose(t=[-0.045, 0, 0]) @ boards(n, rng)
    return T_b_a, (views(a, T_a_target), views(b, T_b_a @ T_a_target)), (a, b)


@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 8]))
@settings(max_examples=10)
def test_exact_corners_give_the_exact_pose(seed: int, views: int):
    T_b_a, corners, cameras = pair(np.random.default_rng(seed), views)
    found, rms = calibrate_pair(*corners, POINTS, *cameras)
    np.testing.assert_allclose(found, T_b_a, atol=SINGLE_PRECISION_POSE)
    assert rms < SINGLE_PRECISION_PX


def test_cameras_that_never_saw_the_board_together_are_refused():
    _, corners, cameras = pair(np.random.default_rng(4))
    corners[0][:4], corners[1][4:] = np.nan, np.nan
    with pytest.raises(VergenceError, match=r"a and camera b .* both see 6 corners .*; found none"):
        calibrate_pair(*corners, POINTS, *cameras)
    with pytest.raises(VergenceError, match="The pose between left_wide and left_narrow needs"):
        calibrate_pair(*corners, POINTS, *cameras, names=("left_wide", "left_narrow"))


def test_corners_that_tell_no_pose_are_refused():
    _, corners, cameras = pair(np.random.default_rng(5))
    on_one_line = POINTS[:, 1] == POINTS[0, 1]
    for seen in corners:
        seen[:, ~on_one_line] = np.nan
    with pytest.raises(VergenceError, match="not all on one line"):
        calibrate_pair(*corners, POINTS, *cameras)
    # 70 degrees from the axes of lenses that see so far.
    lens = Camera(640, 480, np.diag([150.0, 150.0, 1.0]), np.zeros(4), "fisheye")
    aside = 150 * np.radians(70) + np.zeros((2, len(POINTS), 2)) + POINTS[:, :2]
    with pytest.raises(VergenceError, match="not far from the images' middles"):
        calibrate_pair(aside, aside, POINTS, lens, lens)
