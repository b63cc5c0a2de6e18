"""Another board for the scene than the chessboard that the model comes with."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import cv2
import mujoco
import numpy as np

from vergence.calibration.target import Charuco, opencv_board
from vergence.errors import VergenceError

MARGIN_SQUARES = 0.5
"""White all around: enough for the markers' black frames at the edge."""
TEXELS_PER_SQUARE = 60
"""About six a module of a marker: less blurs the markers, more makes the mipmaps do it."""
BLACK, WHITE = 25, 235
"""As the chessboard's (models/cbi_head/assets/make_textures.py)."""


def put_charuco(spec: mujoco.MjSpec, board: Charuco) -> None:
    """Put a ChArUco board in the place of the scene's chessboard.

    Raises:
        VergenceError: OpenCV cannot draw this board.
    """
    size = (board.squares_x * TEXELS_PER_SQUARE, board.squares_y * TEXELS_PER_SQUARE)
    try:
        drawn = opencv_board(board).generateImage(size, marginSize=0, borderBits=1)
    except cv2.error as error:
        raise VergenceError(f"OpenCV cannot draw the board: {error.err}.") from error
    grey = np.where(drawn > 127, WHITE, BLACK).astype(np.uint8)
    grey = np.pad(grey, round(MARGIN_SQUARES * TEXELS_PER_SQUARE), constant_values=WHITE)
    done, png = cv2.imencode(".png", grey)
    assert done
    # In memory, and under a name of its own: MuJoCo keeps files by name for a second.
    spec.assets = {"charuco.png": png.tobytes()}
    spec.texture("board").file = "charuco.png"
    half = (np.array([board.squares_x, board.squares_y]) / 2 + MARGIN_SQUARES) * board.square_m
    centre = (np.array([board.columns, board.rows]) - 1) / 2 * board.square_m
    for name in ("board", "board_back"):
        geom = spec.geom(name)
        geom.size[:2], geom.pos[:2] = half, centre
