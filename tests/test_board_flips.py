"""Boards numbered from the wrong end are turned, all of them and no others."""

from dataclasses import replace

import numpy as np
import pytest

from simulated_head import random_head
from simulated_recording import Noise, Recording, record
from vergence.arrays import Array
from vergence.calibration.checks.board_flips import (
    Renumbered,
    number_alike,
    remarks,
    turn_boards,
    warnings,
)
from vergence.calibration.observations import Observations
from vergence.geometry.board import Charuco, Chessboard, corner_points
from vergence.geometry.head import HeadCalibration
from vergence.geometry.se3 import pose, rotation
from vergence.vision.board_pose import board_poses, seen_corners

POOR = Recording(noise=Noise(pixel_px=0.3, joint_rad=np.radians(0.3)))


def seen(seed: int, recording: Recording = POOR) -> tuple[HeadCalibration, Observations]:
    """Return a head with gains of 4 % and cameras rolled by any angle, and what it observes."""
    rng = np.random.default_rng(seed)
    truth = random_head(rng)
    cameras = {
        name: replace(
            mounted,
            T_eye_cam=mounted.T_eye_cam @ pose(rotation(np.array([0, 0, rng.uniform(-3, 3)]))),
        )
        for name, mounted in truth.cameras.items()
    }
    truth = replace(truth, cameras=cameras)
    return truth, record(truth, rng, recording)


def rough_poses(truth: HeadCalibration, views: Observations) -> dict[str, Array]:
    """Return the boards' poses by lenses as wrong as a first calibration leaves them."""
    points, found = corner_points(views.board), {}
    for name, corners in views.corners.items():
        lens = truth.cameras[name].intrinsics
        rough = replace(lens, matrix=lens.matrix * [[1.01], [1.02], [1]])
        found[name] = board_poses(rough, corners, points)
    return found


def with_turns(
    views: Observations, seed: int, kinds: int = 2
) -> tuple[Observations, dict[str, np.ndarray]]:
    """Return views with up to a third of the boards turned, each camera's by itself."""
    rng = np.random.default_rng(seed)
    V = len(views.placement)
    turns = {}
    for name in views.corners:
        wrong = rng.permutation(V) < rng.integers(1, V // 3 + 1)
        turns[name] = np.where(wrong, rng.integers(1, kinds, V), 0)
    return turn_boards(views, turns), turns


def left_over(
    views: Observations, turns: dict[str, np.ndarray], found: Renumbered, kinds: int = 2
) -> int:
    """Return how many images differ from most others of their placement."""
    count = 0
    there = {name: seen_corners(c).sum(axis=1) >= 6 for name, c in views.corners.items()}
    for p in np.unique(views.placement):
        after = np.concatenate(
            [
                ((turns[name] + found.turns[name]) % kinds)[there[name] & (views.placement == p)]
                for name in turns
            ]
        )
        count += len(after) - np.bincount(after, minlength=1).max()
    return count


@pytest.mark.parametrize("seed", range(4))
def test_every_board_that_is_numbered_from_the_wrong_end_is_turn_boards(seed: int):
    truth, views = seen(seed)
    bad, turns = with_turns(views, seed)
    found = number_alike(bad, rough_poses(truth, bad))
    assert sum(np.count_nonzero(each) for each in turns.values()) > 10
    assert left_over(views, turns, found) == 0
    assert not any(each.any() for each in found.unclear.values())


def test_the_poses_are_those_of_the_boards_as_they_are_numbered_now():
    truth, views = seen(15)
    bad, _ = with_turns(views, 15)
    found = number_alike(bad, rough_poses(truth, bad))
    for name, expected in rough_poses(truth, found.observations).items():
        both = np.isfinite(expected).all(axis=(1, 2))
        np.testing.assert_allclose(found.T_cam_target[name][both], expected[both], atol=1e-5)


def test_good_boards_are_left_alone():
    truth, views = seen(10)
    found = number_alike(views, rough_poses(truth, views))
    assert not any(each.any() for each in found.turns.values())
    assert remarks(found) == warnings(found) == ()


def test_square_boards_are_turned_by_quarters():
    truth, views = seen(11)
    corners = {
        name: each.reshape(-1, 6, 9, 2)[:, :, :6].reshape(-1, 36, 2)
        for name, each in views.corners.items()
    }
    square = replace(views, board=Chessboard(6, 6, 0.03), corners=corners)
    bad, turns = with_turns(square, 11, kinds=4)
    found = number_alike(bad, rough_poses(truth, bad))
    assert left_over(square, turns, found, kinds=4) == 0


def test_a_turned_board_keeps_its_corners_in_other_places():
    _, views = seen(12)
    twice = {name: np.ones(len(views.placement), int) for name in views.corners}
    once = turn_boards(views, twice)
    for name, corners in views.corners.items():
        np.testing.assert_array_equal(once.corners[name], corners[:, ::-1])
        np.testing.assert_array_equal(turn_boards(once, twice).corners[name], corners)


def test_charuco_boards_have_numbers_of_their_own():
    truth, views = seen(13)
    board = Charuco(10, 7, 0.03, 0.02, "DICT_4X4_50")
    bad, _ = with_turns(replace(views, board=board), 13)
    assert number_alike(bad, rough_poses(truth, bad)).observations is bad


def test_boards_that_one_view_leaves_open_are_named():
    truth, views = seen(14, Recording(straight=1, orientations=0))
    both = {name: corners for name, corners in views.corners.items() if name.endswith("wide")}
    views = replace(views, corners=both)
    found = number_alike(views, rough_poses(truth, views))
    assert not any(each.any() for each in found.turns.values())
    (said,) = warnings(found)
    assert "is not clear" in said
    assert "view 0 of left_wide; view 0 of right_wide" in said
