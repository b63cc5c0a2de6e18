"""Where a board stands before a camera of known intrinsics."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from test_intrinsics import POINTS, boards, lens, views
from vergence.vision.board_pose import board_poses, determines_pose

SOLVE_PNP = 1e-7
"""Rotations [rad] and metres at which OpenCV's refinement stops on exact corners."""


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_exact_corners_give_the_exact_poses(seed: int):
    rng = np.random.default_rng(seed)
    camera, T = lens(rng, 0, 1, 2, 3), boards(5, rng)
    np.testing.assert_allclose(board_poses(camera, views(camera, T), POINTS), T, atol=SOLVE_PNP)


def test_skew_is_no_slant_of_the_board():
    rng = np.random.default_rng(0)
    camera, T = lens(rng, 0, 1, 2, 3), boards(5, rng)
    matrix = camera.matrix + np.array([[0.0, 20.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    skewed = replace(camera, matrix=matrix)
    np.testing.assert_allclose(board_poses(skewed, views(skewed, T), POINTS), T, atol=SOLVE_PNP)


def test_a_pose_needs_six_corners_that_are_not_in_one_row():
    rng = np.random.default_rng(9)
    camera, T = lens(rng), boards(4, rng)
    corners = views(camera, T)
    row = POINTS[:, 1] == POINTS[0, 1]
    assert row.sum() >= 6
    corners[0, 5:], corners[1, ~row], corners[2, :20] = np.nan, np.nan, np.nan
    poses = board_poses(camera, corners, POINTS)
    assert np.isnan(poses[:2]).all()
    np.testing.assert_allclose(poses[2:], T[2:], atol=SOLVE_PNP)
    assert np.isnan(board_poses(camera, corners[:1], POINTS)).all()


def test_corners_that_spread_in_two_directions_determine_a_pose():
    seen = np.zeros((4, len(POINTS)), bool)
    seen[0, :5] = True
    seen[1, :9] = True  # a row
    seen[2, [*range(9), 9]] = True  # and one more
    seen[3] = True
    assert determines_pose(POINTS, seen).tolist() == [False, False, True, True]
