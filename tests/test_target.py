"""Finding the calibration board: where its corners are, and which is the first."""

from functools import cache

import numpy as np
import pytest
from pydantic import ValidationError

from vergence.calibration.target import Chessboard, corner_points, find_corners
from vergence.camera import normalise, pinhole, project
from vergence.geometry import inverse, pose, rotation, transform

BOARD = Chessboard(columns=9, rows=6, square_m=0.03)
CAMERA = pinhole(360, 300, 280.0, (-0.12, 0.02, 0.0005, -0.0005, 0.0))
_FINE = 6  # samples along each side of a pixel


@cache
def _rays() -> np.ndarray:
    """Return the directions of all samples of CAMERA's pixels."""
    offsets = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    u = (np.arange(CAMERA.width)[:, None] + offsets).ravel()
    v = (np.arange(CAMERA.height)[:, None] + offsets).ravel()
    xy = normalise(CAMERA, np.stack(np.meshgrid(u, v), axis=-1))
    return np.concatenate([xy, np.ones((*xy.shape[:2], 1))], axis=-1)


def picture(T_cam_target: np.ndarray, board: Chessboard = BOARD) -> np.ndarray:
    """Return the image (H, W) uint8 of a board with a white margin before grey, antialiased."""
    T_target_cam = inverse(T_cam_target)
    rays = _rays() @ T_target_cam[:3, :3].T
    x, y = (
        (T_target_cam[k, 3] - rays[..., k] * (T_target_cam[2, 3] / rays[..., 2])) / board.square_m
        for k in (0, 1)
    )
    black = (np.floor(x) + np.floor(y)) % 2 == 0  # the square outside the first corner is black
    inside = (x >= -1) & (x < board.columns) & (y >= -1) & (y < board.rows)
    margin = (x >= -2) & (x < board.columns + 1) & (y >= -2) & (y < board.rows + 1)
    grey = np.where(inside, np.where(black, 20.0, 230.0), np.where(margin, 230.0, 120.0))
    fine = grey.reshape(CAMERA.height, _FINE, CAMERA.width, _FINE)
    return np.round(fine.mean(axis=(1, 3))).astype(np.uint8)


def held(turn: tuple[float, float, float], depth_m: float, board: Chessboard = BOARD) -> np.ndarray:
    """Return T_cam_target of a board around the optical axis."""
    middle = corner_points(board).mean(axis=0)
    return pose(rotation(turn), [0.01, -0.02, depth_m]) @ pose(t=-middle)


POSES = {  # none along the pixel grid, which this picture's samples would share
    "facing": held((0, 0, 0.06), 0.4),
    "leaning": held((0.6, -0.4, 0.2), 0.4),
    "upside down": held((0.1, 0.2, np.pi), 0.4),
    "on its side": held((0.2, 0.1, np.pi / 2), 0.4),
}


def test_corners_run_along_the_rows_from_the_first():
    points = corner_points(BOARD)
    assert points.shape == (54, 3)
    np.testing.assert_allclose(points[[0, 1, 9]], [[0, 0, 0], [0.03, 0, 0], [0, 0.03, 0]])


@pytest.mark.parametrize("name", POSES)
def test_corners_are_found_in_their_order_and_without_bias(name: str):
    """Within 0.02 px on average; upside down, the first is still the first.

    Single ones scatter, since edges along the grid of a picture without blur are aliased.
    """
    true = project(CAMERA, transform(POSES[name], corner_points(BOARD)))
    found = find_corners(picture(POSES[name]), BOARD)
    assert found is not None
    assert found.shape == (54, 2)
    assert np.abs((found - true).mean(axis=0)).max() < 0.02
    assert np.sqrt(((found - true) ** 2).mean()) < 0.06
    assert np.abs(found - true).max() < 0.2


def test_colour_pictures_serve_as_well():
    grey = picture(POSES["leaning"])
    colour = find_corners(np.repeat(grey[..., None], 3, axis=2), BOARD)
    np.testing.assert_array_equal(colour, find_corners(grey, BOARD))


def test_a_board_whose_counts_have_the_same_parity_looks_alike_from_both_ends():
    board = Chessboard(columns=7, rows=5, square_m=0.03)
    true = project(CAMERA, transform(held((0.1, 0.2, 0), 0.35, board), corner_points(board)))
    found = find_corners(picture(held((0.1, 0.2, 0), 0.35, board), board), board)
    assert found is not None
    assert min(np.abs(found - true).max(), np.abs(found[::-1] - true).max()) < 0.2


def test_a_board_that_leaves_the_image_is_not_found():
    assert find_corners(picture(pose(t=[0.2, 0, 0]) @ POSES["facing"]), BOARD) is None


def test_a_board_with_other_counts_is_not_found():
    assert find_corners(picture(POSES["facing"]), Chessboard(10, 7, 0.03)) is None


def test_an_empty_image_has_no_board():
    assert find_corners(np.full((300, 360), 128, np.uint8), BOARD) is None
    noise = np.random.default_rng(0).integers(0, 256, (300, 360, 3)).astype(np.uint8)
    assert find_corners(noise, BOARD) is None


@pytest.mark.parametrize("wrong", [{"columns": 0}, {"rows": -1}, {"square_m": 0.0}, {"square": 1}])
def test_an_impossible_board_is_refused(wrong: dict):
    with pytest.raises(ValidationError):
        Chessboard(**({"columns": 9, "rows": 6, "square_m": 0.03} | wrong))
