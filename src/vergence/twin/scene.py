"""The scenes that the head may stand in, what moves in them by itself, and a ChArUco board."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from typing import Literal

import cv2
import mujoco
import numpy as np

from vergence.arrays import Array
from vergence.geometry.board import Charuco, opencv_board
from vergence.twin.head_file import models_folder

Scene = Literal["room", "sparse", "moving"]
"""`room`: a furnished laboratory; `sparse`: plain walls, texture on table and furniture only;
`moving`: the room, and an object as large as a head that passes."""
PASSER = "passer"
"""The body that moves by itself, where there is one."""

MARGIN_SQUARES = 0.5
"""Width of the white margin, enough for the markers' black frames at the edge."""
TEXELS_PER_SQUARE = 128
"""Finer than the narrow cameras resolve, since magnified texels would show as steps. A power of
two, so that mipmaps are halved evenly and do not shift the corners."""
BLACK, WHITE = 25, 235
"""Grey levels, as of the chessboard (models/room/assets/make_textures.py)."""


def load_room(scene: Scene = "room") -> mujoco.MjSpec:
    """Read a scene: a room, the calibration board, the object and the hand."""
    return mujoco.MjSpec.from_file(str(models_folder() / "room" / f"{scene}.xml"))


def passer_position(time_s: float) -> Array:
    """Compute the position (3,) [m] of the passing object in the world.

    It moves 0.75 m before the head, to its left, at 0.24 m/s at most. With its own width it sweeps
    over a third of a 2.8 mm lens's view.
    """
    phase = 2 * np.pi * time_s / 5.0
    return np.array([0.75, 0.30 + 0.19 * np.sin(phase), 1.20 + 0.03 * np.sin(2 * phase)])


def put_charuco(spec: mujoco.MjSpec, board: Charuco) -> None:
    """Replace the chessboard of a scene."""
    size = np.array([board.squares_x, board.squares_y]) * TEXELS_PER_SQUARE
    # OpenCV draws a marker off the centre of its square by up to a pixel: it is drawn four times as
    # large and averaged.
    large = tuple((4 * size).tolist())
    drawn = opencv_board(board).generateImage(large, marginSize=0, borderBits=1)
    drawn = cv2.resize(drawn, size.tolist(), interpolation=cv2.INTER_AREA)
    grey = np.round(BLACK + drawn * ((WHITE - BLACK) / 255)).astype(np.uint8)
    grey = np.pad(grey, round(MARGIN_SQUARES * TEXELS_PER_SQUARE), constant_values=WHITE)
    done, png = cv2.imencode(".png", grey)
    assert done
    # In memory, with a name of its own: MuJoCo caches files by name for a second.
    spec.assets = {**spec.assets, "charuco.png": png.tobytes()}
    spec.texture("board").file = "charuco.png"
    half = (np.array([board.squares_x, board.squares_y]) / 2 + MARGIN_SQUARES) * board.square_m
    centre = (np.array([board.columns, board.rows]) - 1) / 2 * board.square_m
    for name in ("board", "board_back"):
        geom = spec.geom(name)
        geom.size[:2], geom.pos[:2] = half, centre
