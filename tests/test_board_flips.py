"""Boards numbered from the wrong end are turned, all of them and no others."""

from dataclasses import replace

import numpy as np
import pytest
from observed import Recording, head, observe

from vergence.calibration.checks.board_flips import Repaired, remarks, repair, turned, warnings
from vergence.calibration.sequential.intrinsics import seen_corners
from vergence.calibration.sequential.sequential import Views
from vergence.geometry.board import Charuco, Chessboard
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EyeAxes
from vergence.geometry.se3 import pose, rotation

POOR = Recording(joint_std_rad=np.radians(0.3), pixel_std_px=0.3)


def seen(seed: int, recording: Recording = POOR) -> tuple[HeadCalibration, Views]:
    """Return a head with gains of 4 % and cameras rolled by any angle, and what it sees."""
    rng = np.random.default_rng(seed)
    truth = head(rng, narrow=True)
    cameras = {
        name: replace(
            mounted,
            T_eye_cam=mounted.T_eye_cam @ pose(rotation(np.array([0, 0, rng.uniform(-3, 3)]))),
        )
        for name, mounted in truth.cameras.items()
    }
    axes = {"left": EyeAxes(1.04, 0.96), "right": EyeAxes(0.96, 1.04)}
    truth = replace(truth, cameras=cameras, axes=axes)
    return truth, observe(truth, rng, recording).views


def rough(truth: HeadCalibration) -> dict[str, Camera]:
    """Return lenses as wrong as a first calibration leaves them."""
    return {
        name: replace(mounted.intrinsics, matrix=mounted.intrinsics.matrix * [[1.01], [1.02], [1]])
        for name, mounted in truth.cameras.items()
    }


def spoilt(views: Views, seed: int, kinds: int = 2) -> tuple[Views, dict[str, np.ndarray]]:
    """Return views with up to a third of the boards turned, each camera's by itself."""
    rng = np.random.default_rng(seed)
    V = len(views.placement)
    turns = {}
    for name in views.corners:
        wrong = rng.permutation(V) < rng.integers(1, V // 3 + 1)
        turns[name] = np.where(wrong, rng.integers(1, kinds, V), 0)
    return turned(views, turns), turns


def left_over(views: Views, turns: dict[str, np.ndarray], found: Repaired, kinds: int = 2) -> int:
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
def test_every_board_that_is_numbered_from_the_wrong_end_is_turned(seed: int):
    truth, views = seen(seed)
    bad, turns = spoilt(views, seed)
    found = repair(bad, rough(truth))
    assert sum(np.count_nonzero(each) for each in turns.values()) > 10
    assert left_over(views, turns, found) == 0
    assert not any(each.any() for each in found.unclear.values())


def test_good_boards_are_left_alone():
    truth, views = seen(10)
    found = repair(views, rough(truth))
    assert not any(each.any() for each in found.turns.values())
    assert remarks(found) == warnings(found) == ()


def test_square_boards_are_turned_by_quarters():
    truth, views = seen(11)
    corners = {
        name: each.reshape(-1, 6, 9, 2)[:, :, :6].reshape(-1, 36, 2)
        for name, each in views.corners.items()
    }
    square = replace(views, board=Chessboard(6, 6, 0.03), corners=corners)
    bad, turns = spoilt(square, 11, kinds=4)
    found = repair(bad, rough(truth))
    assert left_over(square, turns, found, kinds=4) == 0


def test_a_turned_board_keeps_its_corners_in_other_places():
    _, views = seen(12)
    twice = {name: np.ones(len(views.placement), int) for name in views.corners}
    once = turned(views, twice)
    for name, corners in views.corners.items():
        np.testing.assert_array_equal(once.corners[name], corners[:, ::-1])
        np.testing.assert_array_equal(turned(once, twice).corners[name], corners)


def test_charuco_boards_have_numbers_of_their_own():
    truth, views = seen(13)
    board = Charuco(10, 7, 0.03, 0.02, "DICT_4X4_50")
    bad, _ = spoilt(replace(views, board=board), 13)
    assert repair(bad, rough(truth)).views is bad


def test_what_only_one_view_tells_is_left_and_named():
    truth, views = seen(14, Recording(straight=1, orientations=0))
    both = {name: corners for name, corners in views.corners.items() if name.endswith("wide")}
    found = repair(replace(views, corners=both), {name: rough(truth)[name] for name in both})
    assert not any(each.any() for each in found.turns.values())
    (said,) = warnings(found)
    assert "is not clear" in said
    assert "view 0 of left_wide; view 0 of right_wide" in said
