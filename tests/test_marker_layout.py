"""Markers tell a ChArUco board that is described wrongly from one that is described rightly."""

from dataclasses import replace

import numpy as np
import pytest

from recordings import held, picture
from vergence.geometry.board import Charuco, opencv_board
from vergence.vision.board_detection import detect_board, upsampled
from vergence.vision.marker_layout import (
    board_of,
    contradicts,
    marker_pairs,
    marker_squares,
    read_markers,
)

BOARD = Charuco(squares_x=7, squares_y=6, square_m=0.03, marker_m=0.022, dictionary="DICT_4X4_50")
SIZE = 280, 240


def pairs_of(image: np.ndarray, board: Charuco = BOARD):
    return marker_pairs(*read_markers(upsampled(image)[0], board.dictionary))


@pytest.mark.parametrize("legacy", [False, True])
def test_markers_are_in_the_squares_that_opencv_puts_them_in(legacy: bool):
    for squares_x in range(3, 9):
        for squares_y in range(3, 9):
            board = replace(BOARD, squares_x=squares_x, squares_y=squares_y, legacy=legacy)
            quads = np.array(opencv_board(board).getObjPoints())[..., :2]
            squares = np.floor(quads.mean(axis=1) / board.square_m)
            np.testing.assert_array_equal(marker_squares(board), squares)


@pytest.mark.parametrize(
    ("there", "described"),
    [
        ({}, {"legacy": True}),
        ({"legacy": True}, {}),
        ({"squares_x": 8}, {"squares_x": 8, "legacy": True}),
        ({"squares_x": 8}, {"squares_x": 9}),
        ({"squares_x": 8}, {"squares_x": 10}),
        ({"squares_x": 8}, {"squares_x": 4, "squares_y": 12}),
        ({"squares_x": 5}, {"squares_x": 4}),
    ],
)
def test_a_board_that_is_described_wrongly_has_no_corners_of_wrong_numbers(there, described):
    """OpenCV finds corners for each of these, which are off by a square and more."""
    right, wrong = replace(BOARD, **there), replace(BOARD, **described)
    for k in range(2):
        image, truth = picture(right, held(k, shift=20, square_px=22), SIZE)
        assert detect_board(image, wrong) is None
        found = detect_board(image, right)
        assert found is not None
        np.testing.assert_allclose(found, truth, atol=0.15)
        pairs = pairs_of(image)
        assert contradicts(pairs, wrong)
        assert not contradicts(pairs, right)
        assert board_of(pairs, wrong) == right


def test_rows_that_are_not_there_do_no_harm():
    image, truth = picture(BOARD, held(0, shift=20), SIZE)
    found = detect_board(image, replace(BOARD, squares_y=7))
    assert found is not None
    np.testing.assert_allclose(found[:30], truth, atol=0.15)
    assert np.isnan(found[30:]).all()


@pytest.mark.parametrize("seen", [np.s_[:, 150:], np.s_[:110], np.s_[60:160, 60:160]])
def test_parts_of_a_board_do_not_contradict_its_description(seen):
    image, _ = picture(BOARD, held(0, shift=20), SIZE)
    part = np.full_like(image, 120)
    part[seen] = image[seen]
    assert not contradicts(pairs_of(part), BOARD)


def test_one_marker_has_no_neighbours():
    image, _ = picture(BOARD, held(0, shift=20), SIZE)
    quads, ids = read_markers(upsampled(image)[0], BOARD.dictionary)
    alone = marker_pairs(quads[:1], ids[:1])
    assert alone.ids.shape == alone.steps.shape == (0, 2)
    assert not contradicts(alone, BOARD)
    assert board_of(alone, BOARD) is None


def test_markers_that_their_mirror_images_are_taken_for_contradict_the_board():
    """Some have mirror images that are other markers; they stand apart from each other."""
    board = Charuco(
        squares_x=8, squares_y=6, square_m=0.03, marker_m=0.022, dictionary="DICT_4X4_50"
    )
    image, _ = picture(board, held(0, shift=20, square_px=22), SIZE)
    mirrored = np.ascontiguousarray(image[:, ::-1])
    pairs = pairs_of(mirrored, board)
    assert len(pairs.ids) > 0
    assert contradicts(pairs, board)
    assert detect_board(mirrored, board) is None
