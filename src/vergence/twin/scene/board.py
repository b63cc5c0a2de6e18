"""Replace the chessboard of the scene by a ChArUco board."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import cv2
import mujoco
import numpy as np

from vergence.errors import VergenceError
from vergence.geometry.board import Charuco, opencv_board

MARGIN_SQUARES = 0.5
"""Width of the white margin, enough for the markers' black frames at the edge."""
TEXELS_PER_SQUARE = 128
"""Finer than the narrow cameras resolve, since magnified texels would show as steps. A power of
two, so that mipmaps are halved evenly and do not shift the corners."""
MARKER_OVERSAMPLING = 4
"""Oversampling: OpenCV draws a marker on whole pixels, off the centre of its square by up to one
pixel, so the board is drawn this many times larger and averaged."""
BLACK, WHITE = 25, 235
"""Grey levels, as of the chessboard (models/cbi_head/assets/make_textures.py)."""


def put_charuco(spec: mujoco.MjSpec, board: Charuco) -> None:
    """Replace the chessboard of a scene; VergenceError if OpenCV cannot draw this board."""
    size = np.array([board.squares_x, board.squares_y]) * TEXELS_PER_SQUARE
    try:
        drawn = opencv_board(board).generateImage(
            tuple((MARKER_OVERSAMPLING * size).tolist()), marginSize=0, borderBits=1
        )
    except cv2.error as error:
        raise VergenceError(f"OpenCV cannot draw the board: {error.err}.") from error
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
