"""What a simulated head finds of a board in images that it would take, drawn without MuJoCo.

The pictures are those of drawn_card, with a mild blur and sensor noise; the corners are found by
the detector of calibrations. The board is a ChArUco board with the corners of
simulated_recording.BOARD, which may be cut off at the edges of an image.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from drawn_card import draw_card, sample_slopes
from simulated_recording import BOARD, POINTS
from vergence.arrays import Array
from vergence.calibration.detection import detect_or_explain
from vergence.geometry.board import Charuco, opencv_board
from vergence.geometry.head import HeadCalibration, camera_pose_in_base
from vergence.geometry.se3 import inverse, pose

CHARUCO = Charuco(
    squares_x=BOARD.columns + 1,
    squares_y=BOARD.rows + 1,
    square_m=BOARD.square_m,
    marker_m=0.625 * BOARD.square_m,  # a whole number of picture elements
    dictionary="DICT_4X4_50",
)
BLUR_PX = 0.6
_SQUARE, _MARGIN = 64, 32
"""Picture elements along a square of the board, and along its white margin."""


def found_corners(
    head: HeadCalibration,
    noise: np.random.Generator,
    *,
    T_lbase_target: Array,
    joints: Array,
) -> Mapping[str, Array]:
    """Return by camera the corners (V, K, 2) [px] found in V drawn images; NaN: not found.

    Boards stand at T_lbase_target (V, 4, 4), and the joints truly read (V, r).
    """
    size = np.array([CHARUCO.squares_x, CHARUCO.squares_y]) * _SQUARE + 2 * _MARGIN
    picture = opencv_board(CHARUCO).generateImage(tuple(size.tolist()), marginSize=_MARGIN)
    picture = np.where(picture > 127, 230, 20).astype(np.uint8)
    width_m = CHARUCO.square_m * size[0] / _SQUARE
    T_target_card = pose(t=POINTS.mean(axis=0))
    found = {}
    for name, mounted in head.cameras.items():
        slopes = sample_slopes(mounted.intrinsics)
        corners = np.full((len(joints), len(POINTS), 2), np.nan)
        for v, (T, u) in enumerate(zip(T_lbase_target, joints, strict=True)):
            T_base_target = T if mounted.eye == "left" else head.T_rbase_lbase @ T
            T_cam_card = inverse(camera_pose_in_base(head, name, u)) @ T_base_target @ T_target_card
            image = draw_card(
                mounted.intrinsics,
                picture,
                T_cam_card,
                width_m,
                noise=noise,
                blur_px=BLUR_PX,
                slopes=slopes,
            )
            seen, _ = detect_or_explain(image[..., 0], CHARUCO)
            corners[v] = np.nan if seen is None else seen
        found[name] = corners
    return found
