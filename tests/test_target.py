"""Finding the calibration board: where its corners are, and which is the first."""

from functools import cache

import cv2
import numpy as np
import pytest

from vergence.geometry.board import Chessboard, corner_points
from vergence.geometry.camera import Camera, normalise, pinhole, project
from vergence.geometry.se3 import inverse, pose, rotation, transform
from vergence.vision.board_detection import SEARCHED_PX, detect_board
from vergence.vision.corner_refinement import curvatures

BOARD = Chessboard(columns=9, rows=6, square_m=0.03)
CAMERA = pinhole(360, 300, 280.0, (-0.12, 0.02, 0.0005, -0.0005, 0.0))
_FINE = 4  # samples along each side of a pixel


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


@pytest.mark.parametrize("name", POSES)
def test_corners_are_found_in_their_order_and_without_bias(name: str):
    """Within 0.02 px on average; upside down, the first is still the first.

    Single ones scatter, since edges along the grid of a picture without blur are aliased.
    """
    true = project(CAMERA, transform(POSES[name], corner_points(BOARD)))
    found = detect_board(picture(POSES[name]), BOARD)
    assert found is not None
    assert found.shape == (54, 2)
    assert np.abs((found - true).mean(axis=0)).max() < 0.02
    assert np.sqrt(((found - true) ** 2).mean()) < 0.06
    assert np.abs(found - true).max() < 0.2


def by_sectors_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2, "findChessboardCorners", lambda *_, **__: (False, None))


@pytest.mark.parametrize("roll_deg", [3, 65, 128, 175, 244, 310])
@pytest.mark.parametrize(
    ("size", "same_turned_by"),
    [((9, 6), [0]), ((6, 7), [0]), ((7, 5), [0, 2]), ((6, 4), [0, 2]), ((5, 5), [0, 2]),
     ((6, 6), [0, 1, 2, 3])],
)  # fmt: skip
def test_boards_that_look_alike_are_numbered_from_the_upper_left_whatever_finds_them(
    size: tuple[int, int], same_turned_by: list[int], roll_deg: float, monkeypatch
):
    board = Chessboard(*size, square_m=0.03)
    T = held((0.1, 0.2, np.radians(roll_deg)), 0.45, board)
    true = project(CAMERA, transform(T, corner_points(board))).reshape(*size[::-1], 2)
    alike = [np.rot90(true, quarters) for quarters in same_turned_by]
    first = min(alike, key=lambda grid: grid[0, 0].sum())
    found = [detect_board(picture(T, board), board)]
    by_sectors_only(monkeypatch)
    found.append(detect_board(picture(T, board), board))
    for each in found:
        assert each is not None
        assert np.abs(each - first.reshape(-1, 2)).max() < 0.2


@pytest.mark.parametrize("out_px", [0, 14, 28])
def test_a_board_half_out_of_sight_is_not_taken_for_one_that_is_shifted_by_a_square(out_px: int):
    there = held((0.2, 0.3, 0.06), 0.4)
    true = project(CAMERA, transform(there, corner_points(BOARD)))
    edge = int(true[:, 0].max()) + 30 - out_px
    found = detect_board(np.ascontiguousarray(picture(there)[:, :edge]), BOARD)
    assert found is not None or out_px > 0
    assert found is None or np.nanmax(np.abs(found - true)) < 0.5


FISHEYE = Camera(640, 480, CAMERA.matrix, np.array([0.01, -0.004, 0.001, 0.0]), "fisheye")
ASIDE = pose(rotation((0.0, 0.8, 0.0))) @ pose(t=[0, 0, 0.35]) @ held((0.1, 0.3, 0.2), 0.0)


@pytest.mark.parametrize("corner", [(2, 4), (0, 0), (5, 3), (3, 8)])
@pytest.mark.parametrize(
    ("camera", "T"), [(CAMERA, POSES["leaning"]), (FISHEYE, ASIDE)], ids=["pinhole", "fisheye"]
)
def test_the_bend_of_a_grid_is_that_of_its_lines_in_the_camera(
    camera: Camera, T: np.ndarray, corner: tuple[int, int]
):
    """Off each line by its second derivative, on the rim as inside; nothing along the line."""
    true = project(camera, transform(T, corner_points(BOARD))).reshape(6, 9, 2)
    bend = curvatures(true)

    def image_of(offset_m: np.ndarray) -> np.ndarray:
        points = corner_points(BOARD).reshape(6, 9, 3)[corner] + [*offset_m, 0.0]
        return project(camera, transform(T, points))

    a, b = (image_of(0.001 * side) - image_of(-0.001 * side) for side in np.eye(2))
    M = np.linalg.inv(np.stack([a, b], axis=-1) / 0.002)
    for line in (0, 1):
        x, y = offset = (5 * np.stack([a, b])[line]) / np.linalg.norm([a, b][line])
        there, back = image_of(M @ offset), image_of(-(M @ offset))
        bent = M @ ((there + back) / 2 - true[corner])
        found = M @ bend[corner] @ [x * x, x * y, y * y]
        assert abs(found[1 - line] - bent[1 - line]) < 0.001 * np.linalg.norm(M)
        assert abs(found[line]) < 1e-6
        if camera is CAMERA:  # squares shrink along the line
            assert abs(bent[line]) > 0.005 * np.linalg.norm(M)


def test_where_the_board_is_not_as_a_whole_it_is_not_found():
    """One that leaves the image, one with other counts, and none."""
    away = picture(pose(t=[0.2, 0, 0]) @ POSES["facing"])
    noise = np.random.default_rng(0).integers(0, 256, (300, 360, 3)).astype(np.uint8)
    for image in (away, noise, np.full((300, 360), 128, np.uint8)):
        assert detect_board(image, BOARD) is None
    assert detect_board(picture(POSES["facing"]), Chessboard(10, 7, 0.03)) is None


def test_a_board_in_a_large_image_is_found_in_a_smaller_one_and_refined_in_the_whole():
    image = picture(held((0.2, 0.3, 0.1), 0.5))
    large = cv2.resize(image, None, fx=5, fy=5, interpolation=cv2.INTER_CUBIC)
    assert large.size > SEARCHED_PX
    small, found = detect_board(image, BOARD), detect_board(large, BOARD)
    assert small is not None
    assert found is not None
    np.testing.assert_allclose((found + 0.5) / 5 - 0.5, small, rtol=0, atol=0.2)


def test_an_image_without_contrast_is_not_searched(monkeypatch):
    monkeypatch.setattr(cv2, "findChessboardCorners", None)  # would take a minute, and gigabytes
    assert detect_board(np.full((2500, 20000), 7, np.uint8), BOARD) is None
