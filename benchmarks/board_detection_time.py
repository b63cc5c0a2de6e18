"""Time of finding a chessboard's corners, beside OpenCV's detector by sectors on the same images.

    python benchmarks/board_detection_time.py [--images 60] [--seed 0]

Boards of 9 x 6 corners are drawn before a wide lens, with noise and blur, at distances of 0.3 to
0.7 m and leaning by up to 0.7 rad. `detect_board` refines the corners as well, whose errors are
printed: by noise, and by being taken for others (more than 1 px). Every tenth image has no board.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import tyro

from drawn_card import WIDE, draw_card
from vergence.geometry.board import Chessboard, corner_points
from vergence.geometry.camera import project
from vergence.geometry.se3 import pose, rotation, transform
from vergence.vision.board_detection import detect_board

BOARD = Chessboard(columns=9, rows=6, square_m=0.030)
_SQUARE = 40
"""Pixels across a square of the picture."""


def chessboard_picture(board: Chessboard) -> np.ndarray:
    """Return a picture (h, w) uint8 of a board with a white margin of a square."""
    rows, columns = np.indices((board.rows + 1, board.columns + 1))
    squares = np.where((rows + columns) % 2, 230, 20).astype(np.uint8)
    large = np.kron(squares, np.ones((_SQUARE, _SQUARE), np.uint8))
    return np.pad(large, _SQUARE, constant_values=230)


def main(images: int = 60, seed: int = 0) -> None:
    """Print what is found, with which errors, and the ratio of the times.

    Args:
        images: how many.
        seed: of poses and noise.
    """
    cv2.setNumThreads(1)
    rng = np.random.default_rng(seed)
    picture, size = chessboard_picture(BOARD), (BOARD.columns, BOARD.rows)
    spent: dict[tuple[str, bool], float] = defaultdict(float)
    width_m = BOARD.square_m * picture.shape[1] / _SQUARE
    corners_card = corner_points(BOARD) - corner_points(BOARD).mean(axis=0)

    def timed(name: str, shows: bool, find: Callable[[], Any]) -> Any:
        begin = time.thread_time()
        result = find()
        spent[name, shows] += time.thread_time() - begin
        return result

    shown, found, by_opencv, errors = 0, 0, 0, []
    for k in range(images):
        depth = rng.uniform(0.3, 0.7)
        T = pose(rotation(rng.uniform(-0.7, 0.7, 3)), [*rng.uniform(-0.3, 0.3, 2) * depth, depth])
        truth = project(WIDE, transform(T, corners_card))
        shows = k % 10 != 9
        card = picture if shows else np.full_like(picture, 230)
        image = draw_card(WIDE, card, T, width_m, noise=rng, blur_px=0.5)
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        ours = timed("ours", shows, lambda grey=grey: detect_board(grey, BOARD))
        theirs = timed(
            "OpenCV", shows, lambda grey=grey: cv2.findChessboardCornersSB(grey, size, flags=0)
        )
        shown += shows
        found += ours is not None
        by_opencv += bool(theirs[0])
        if ours is not None:
            errors.append(np.linalg.norm(ours - truth, axis=1))
    off = np.concatenate(errors)
    wrong = off > 1
    rms = float(np.sqrt(np.nanmean(off[~wrong] ** 2) / 2))
    print(f"{shown} of {images} images show a board: {found} found, {by_opencv} by OpenCV")
    print(f"corners: {rms:.3f} px rms per coordinate, {np.count_nonzero(wrong)} taken for others")
    ratio = {each: spent["ours", each] / spent["OpenCV", each] for each in (True, False)}
    print(f"time / OpenCV's: {ratio[True]:.2f} with a board (bar 1), {ratio[False]:.2f} without")


if __name__ == "__main__":
    tyro.cli(main)
