"""Boards of all kinds: found, numbered, and about as accurate as a chessboard."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from board_kinds import BOARDS, CAMERAS, board_picture, compared
from recordings import board_json, change_about, small_dataset
from vergence.calibration.board_numbering import symmetries
from vergence.calibration.other_boards import why_not_found
from vergence.calibration.outliers import strays
from vergence.data.reader import load_dataset
from vergence.geometry.board import (
    AprilGrid,
    Board,
    corner_points,
    described,
    even_grids,
)

CHESSBOARD, CHARUCO, CIRCLES, _, APRIL = BOARDS
assert isinstance(APRIL, AprilGrid)


@pytest.mark.parametrize("board", BOARDS[2:], ids=described)
def test_errors_of_corners_are_below_one_and_a_half_times_a_chessboards(board: Board):
    (found, true), usual = (compared(each, CAMERAS["narrow"], 3) for each in (board, CHESSBOARD))
    assert np.isfinite(found[..., 0]).mean() > 0.9
    error, usual_error = found - true, np.subtract(*usual)
    assert np.nanmean(error**2) < 1.5**2 * np.nanmean(usual_error**2)


@pytest.mark.parametrize("board", BOARDS, ids=described)
def test_corners_of_a_board_lie_evenly_in_its_parts(board: Board):
    points, parts = corner_points(board)[:, :2] / board.square_m, even_grids(board)
    assert sorted(np.concatenate([part.ravel() for part in parts])) == list(range(len(points)))
    for part in parts:
        steps = np.diff(points[part], axis=1), np.diff(points[part], axis=0)
        assert all(np.ptp(step, axis=(0, 1)) == pytest.approx(0, abs=1e-12) for step in steps)
        assert not strays(points[part][None] * 30).any()


@pytest.mark.parametrize("board", BOARDS, ids=described)
def test_symmetries_put_the_corners_of_a_board_onto_each_other(board: Board):
    points = corner_points(board)
    away = points - points.mean(axis=0)
    turned = away @ np.swapaxes(symmetries(board), 1, 2)
    assert np.linalg.norm(turned[:, :, None] - away, axis=3).min(axis=2).max() < 1e-9
    assert (len(symmetries(board)) == 1) == (board not in (CHESSBOARD, CIRCLES))


def test_spellings_of_opencv_name_the_same_markers():
    replace(APRIL, dictionary="DICT_APRILTAG_36H11")
    with pytest.raises(ValueError, match="No marker dictionary is called 'DICT_APRILTAG_36h12'"):
        replace(APRIL, dictionary="DICT_APRILTAG_36h12")
    with pytest.raises(ValueError, match="whose markers are 0 to 586"):
        replace(APRIL, tags_x=30, tags_y=30)


def test_markers_that_cannot_be_read_are_called_so():
    assert "no marker of DICT_4X4_50 could be read" in why_not_found(
        board_picture(APRIL).grey[::2, ::2].copy(), CHARUCO
    )


def test_a_dataset_describes_each_kind(tmp_path: Path):
    small_dataset(tmp_path)
    for board in BOARDS:
        change_about(tmp_path, {"board": json.loads(json.dumps(board_json(board)))})
        assert load_dataset(tmp_path).description.board == board
