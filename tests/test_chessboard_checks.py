"""What OpenCV takes for a chessboard is refused where it is a part of another one, or none."""

import cv2
import numpy as np
import pytest

from recordings import held, picture
from vergence.geometry.board import Charuco, Chessboard
from vergence.vision import board_detection
from vergence.vision.board_detection import detect_board, ends_inside, goes_on, is_chequered

BOARD = Chessboard(columns=8, rows=6, square_m=0.03)
SIZE = 300, 240
IMAGE, TRUTH = picture(BOARD, held(0, shift=20, square_px=22), SIZE)
GRID = TRUTH.reshape(6, 8, 2)
PARTS = {
    "one column less": GRID[:, :-1],
    "one row less": GRID[1:],
    "the middle": GRID[1:-1, 2:-2],
    "a corner": GRID[:4, :3],
}


def test_the_whole_board_is_one():
    assert is_chequered(IMAGE, GRID)
    assert not goes_on(IMAGE, GRID)
    assert ends_inside(GRID, IMAGE.shape)


@pytest.mark.parametrize("name", PARTS)
def test_a_part_of_a_board_goes_on(name: str):
    part = PARTS[name]
    for quarter in range(4):
        assert goes_on(IMAGE, np.rot90(part, quarter))
    assert goes_on(255 - IMAGE, part)


@pytest.mark.parametrize("name", PARTS)
def test_a_part_of_a_board_whose_outermost_squares_are_narrow_goes_on(name: str):
    along, down = GRID[0, 1] - GRID[0, 0], GRID[1, 0] - GRID[0, 0]
    ends = zip(GRID[[0, 0, -1, -1], [0, -1, -1, 0]], (-1, 1, 1, -1), (-1, -1, 1, 1), strict=True)
    outline = np.array([corner + 0.4 * (x * along + y * down) for corner, x, y in ends])
    shown = cv2.fillConvexPoly(np.zeros_like(IMAGE), np.round(outline).astype(int), 1)
    narrow = np.where(shown, IMAGE, IMAGE.max())
    assert goes_on(narrow, PARTS[name])
    assert not goes_on(narrow, GRID)


def test_a_board_that_an_image_cuts_off_does_not_end_inside():
    assert not ends_inside(GRID[:, :5], IMAGE[:, : int(GRID[:, 4, 0].max()) + 10].shape)


def test_every_second_corner_is_no_chessboard():
    """They lie evenly, along the diagonals of the squares."""
    j, i = np.indices((3, 3))
    diagonal = GRID[j + i, 2 + i - j]
    assert not is_chequered(IMAGE, diagonal)


@pytest.mark.parametrize("name", PARTS)
def test_whatever_part_of_a_board_opencv_finds_is_refused(name: str, monkeypatch):
    part = PARTS[name]
    found = True, part.reshape(-1, 1, 2).astype(np.float32)
    monkeypatch.setattr(cv2, "findChessboardCorners", lambda *_, **__: found)
    monkeypatch.setattr(board_detection.cv2, "findChessboardCornersSB", lambda *_, **__: found)
    rows, columns = part.shape[:2]
    assert detect_board(IMAGE, Chessboard(columns, rows, 0.03)) is None


def test_squares_with_markers_are_no_chessboard():
    board = Charuco(9, 7, 0.03, 0.022, "DICT_4X4_50")
    image, truth = picture(board, held(0, shift=20, square_px=22), SIZE)
    assert not is_chequered(image, truth.reshape(6, 8, 2))
