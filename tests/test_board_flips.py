"""Boards numbered from the wrong end are turned, all of them and no others."""

from dataclasses import replace

import numpy as np
import pytest

from simulated_head import random_head
from simulated_recording import Noise, Recording, as_poses, record
from texts import texts
from turned_boards import count, flips, rolled, squared
from vergence.arrays import Array
from vergence.calibration.board_numbering import (
    number_alike,
    turn_boards,
    without_unclear,
)
from vergence.calibration.observations import Observations
from vergence.errors import VergenceError
from vergence.geometry.board import corner_points
from vergence.geometry.head import HeadCalibration
from vergence.vision.board_pose import board_poses

POOR = Recording(noise=Noise(pixel_px=0.3, joint_rad=np.radians(0.3)))


def seen(seed: int, recording: Recording = POOR) -> tuple[HeadCalibration, Observations]:
    """Return a head with gains of 4 % and cameras rolled by any angle, and what it observes."""
    rng = np.random.default_rng(seed)
    truth = rolled(random_head(rng), rng)
    return truth, record(truth, rng, recording)


def rough_poses(truth: HeadCalibration, views: Observations) -> dict[str, Array]:
    """Return the boards' poses by lenses as wrong as a first calibration leaves them."""
    points, found = corner_points(views.board), {}
    for name, corners in views.corners.items():
        lens = truth.cameras[name].intrinsics
        rough = replace(lens, matrix=lens.matrix * [[1.01], [1.02], [1]])
        found[name] = board_poses(rough, corners, points)
    return found


def with_turns(views: Observations, seed: int) -> tuple[Observations, dict[str, np.ndarray]]:
    """Return views with up to a third of the boards turned, each camera's by itself."""
    rng, V = np.random.default_rng(seed), len(views.placement)
    kinds = 4 if views.board.columns == views.board.rows else 2
    turns = {name: flips(V, rng.uniform(1 / V, 1 / 3), kinds, rng) for name in views.corners}
    return turn_boards(views, turns), turns


@pytest.mark.parametrize("seed", range(2))
def test_every_board_that_is_numbered_from_the_wrong_end_is_turned(seed: int):
    truth, views = seen(seed)
    bad, turns = with_turns(views, seed)
    counted = count(bad, turns, number_alike(bad, rough_poses(truth, bad)))
    assert counted.injected > 10
    assert counted.remaining == counted.turned_falsely == counted.unclear == 0


def test_good_boards_are_left_alone():
    truth, views = seen(10)
    found = number_alike(views, rough_poses(truth, views))
    assert not any(each.any() for each in found.turns.values())
    assert without_unclear(views, found)[1] == []


def test_square_boards_are_turned_by_quarters():
    truth, views = seen(11)
    bad, turns = with_turns(squared(views), 11)
    counted = count(bad, turns, number_alike(bad, rough_poses(truth, bad)))
    assert counted.remaining == counted.turned_falsely == 0


def test_boards_that_nothing_settles_are_refused():
    truth, views = seen(14, Recording(straight=1, orientations=0))
    both = {name: corners for name, corners in views.corners.items() if name.endswith("wide")}
    views = replace(views, corners=both)
    found = number_alike(views, rough_poses(truth, views))
    assert not any(each.any() for each in found.turns.values())
    assert without_unclear(views, found)[1] == []  # its ends differ in colour
    ambiguous = squared(views)
    found = number_alike(ambiguous, rough_poses(truth, ambiguous))
    with pytest.raises(VergenceError, match=r"_wide: use a board whose ends differ"):
        without_unclear(ambiguous, found)


ONE_PLACEMENT = [replace(POOR, straight=0, orientations=views, alike=False) for views in (3, 5, 12)]


@pytest.mark.parametrize("recording", ONE_PLACEMENT, ids=lambda each: each.orientations)
def test_a_board_at_one_place_is_not_doubted(recording: Recording):
    for seed in range(20, 22):
        truth, views = seen(seed, recording)
        found = number_alike(views, rough_poses(truth, views))
        assert not any(each.any() for each in found.turns.values())
        assert texts(without_unclear(views, found)[1]) == []


@pytest.mark.parametrize("recording", ONE_PLACEMENT, ids=lambda each: each.orientations)
def test_a_board_at_one_place_that_one_camera_numbers_from_the_other_end_is_turned(
    recording: Recording,
):
    for seed in range(20, 22):
        truth, views = seen(seed, recording)
        upside_down = {"right_wide": np.ones(len(views.placement), int)}
        bad = turn_boards(views, upside_down)
        found = number_alike(bad, rough_poses(truth, bad))
        shared = [each.astype(bool) for each in found.turns.values() if each.any()]
        assert texts(without_unclear(views, found)[1]) == []
        np.testing.assert_array_equal(shared, [np.ones(len(views.placement), bool)])


def test_bases_of_measured_poses_tell_nothing_of_a_board_at_one_place():
    truth, views = seen(20, ONE_PLACEMENT[-1])
    views = squared(as_poses(views))
    found = number_alike(views, rough_poses(truth, views))
    with pytest.raises(VergenceError, match="settle from which end the board is numbered"):
        without_unclear(views, found)
