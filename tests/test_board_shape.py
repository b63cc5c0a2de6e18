"""A board whose squares are not square is named, by how much; a good one is not doubted."""

import re
from dataclasses import replace

import numpy as np
import pytest

import simulated_recording
from simulated_head import random_head
from simulated_recording import POINTS, Recording, moving_recording, record
from texts import texts
from vergence.calibration.calibrate import calibrate
from vergence.calibration.excitation import (
    stretch,
    stretched_board,
)
from vergence.calibration.intrinsics import calibrate_intrinsics, lenses_of_the_paper
from vergence.calibration.observations import Observations
from vergence.geometry.board import corner_points
from vergence.vision.board_pose import board_poses

USUAL = Recording(straight=15, orientations=30, alike=False)


def seen(seed: int, monkeypatch, high: float, how: Recording = USUAL) -> Observations:
    """Return a recording of a board whose squares are higher than wide by a factor."""
    rng = np.random.default_rng(seed)
    head = random_head(rng)
    monkeypatch.setattr(simulated_recording, "POINTS", POINTS * [1, high, 1])
    return record(head, rng, how)


def checked(views: Observations):
    """Return the arguments of the check."""
    lenses, points = calibrate_intrinsics(views), corner_points(views.board)
    poses = {n: board_poses(each.camera, views.corners[n], points) for n, each in lenses.items()}
    return views, poses, lenses


@pytest.mark.parametrize(("high", "seed"), [(0.997, 0), (1.001, 0), (1.003, 2)])
def test_a_stretched_board_is_found_out_and_by_how_much(high: float, seed: int, monkeypatch):
    views = checked(seen(seed, monkeypatch, high))
    value, std = stretch(*views)
    assert value == pytest.approx(high - 1, abs=4 * std)
    assert std < 4e-4
    if abs(high - 1) > 0.002:
        (found,) = stretched_board(*views, moving=True)
        assert found.severity == "void"
        said = found.sentence
        assert re.search(r"are 0\.\d\d % (higher|lower) than wide", said)
        assert ("higher" in said) == (high > 1)


def test_a_good_board_is_not_doubted(monkeypatch):
    for seed in range(4, 7):  # the others have the same noise as the stretched ones
        views = checked(seen(seed, monkeypatch, 1.0))
        assert stretched_board(*views, moving=True) == []


def test_a_stretched_board_whose_two_sides_are_stated_is_not_doubted(monkeypatch):
    views = seen(3, monkeypatch, 1.003)
    board = replace(views.board, square_y_m=1.003 * views.board.square_m)
    np.testing.assert_allclose(corner_points(board), POINTS * [1, 1.003, 1], rtol=1e-12)
    stated = checked(replace(views, board=board))
    assert stretched_board(*stated, moving=True) == []
    value, std = stretch(*stated)
    assert abs(value) < 4 * std


@pytest.mark.usefixtures("two_folds")
def test_rows_of_moving_eyes_are_not_used_with_a_stretched_board():
    rng = np.random.default_rng(6)
    head = random_head(rng, lenses=("wide",))
    views = moving_recording(
        head,
        rng,
        USUAL.noise,
        record(head, rng, USUAL),
        times_s=np.arange(30) / 15,
        gaze=lambda t: 0.15 * np.sin(t[:, None] * [2.0, 1.4, 2.0, 1.4]),
        time_offset_s=0.01,
    )
    assert not calibrate(views, lens="radial-tangential-k3").accuracy.void
    square = views.board.square_m
    wrong = replace(views, board=replace(views.board, square_y_m=0.996 * square))
    void = texts(calibrate(wrong, lens="radial-tangential-k3").findings, "void")
    assert any("With rows of moving eyes it makes gains and axes wrong" in said for said in void)


@pytest.mark.usefixtures("two_folds")
def test_a_calibration_by_a_stretched_board_is_doubted(monkeypatch):
    views = seen(3, monkeypatch, 1.003)
    found = calibrate(views, lens=lenses_of_the_paper(views))
    assert any("The squares of the board are" in said for said in texts(found.findings))
    assert found.summary().startswith("DOUBTFUL")
