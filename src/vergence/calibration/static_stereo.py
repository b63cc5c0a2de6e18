"""The constant pose between two cameras that see the same board (Sec. II-A, and R_fp, t_fp)."""

from __future__ import annotations

import numpy as np

from vergence.arrays import Array
from vergence.calibration.hand_eye import agreeing_rotations
from vergence.calibration.unknowns import POSE_SCALE
from vergence.errors import VergenceError
from vergence.estimation.least_squares import least_squares
from vergence.estimation.variables import Block, Variables
from vergence.geometry.camera import Camera
from vergence.geometry.se3 import boxplus, inverse, known_poses, mean_pose
from vergence.vision.board_pose import (
    LEAST_CORNERS,
    BoardViews,
    board_latent,
    board_poses,
    seen_corners,
)


def calibrate_pair(
    corners_a: Array,
    corners_b: Array,
    points: Array,
    a: Camera,
    b: Camera,
    *,
    names: tuple[str, str] = ("camera a", "camera b"),
) -> tuple[Array, float]:
    """Find T_b_a (4, 4) of two rigidly connected cameras with known intrinsics.

    Also returns the root mean square distance of corners from their reprojections [px].

    Args:
        corners_a: (V, K, 2) pixels in camera a; NaN where a corner was not seen.
        corners_b: (V, K, 2) pixels in camera b, at the same moments.
        points: (K, 3) the board's corners in frame target.
        a: its intrinsics.
        b: its intrinsics.
        names: of both, for the message.

    Raises:
        VergenceError: no view shows six common corners that are not on one line.
    """
    both = seen_corners(corners_a) & seen_corners(corners_b)
    corners_a, corners_b = (
        np.where(both[..., None], each, np.nan) for each in (corners_a, corners_b)
    )
    T_a, T_b = (
        board_poses(camera, corners, points) for camera, corners in ((a, corners_a), (b, corners_b))
    )
    between = T_b @ inverse(T_a)
    known = np.flatnonzero(known_poses(between))
    if not len(known):
        raise VergenceError(
            f"The pose between {' and '.join(names)} needs views in which both see "
            f"{LEAST_CORNERS} corners of the board, not all on one line and not far from the "
            "images' middles; found none."
        )
    # A few corners in one part of the image may put a board where it is not.
    known = known[agreeing_rotations(between[known, :3, :3])]
    start = Block(mean_pose(between[known]), np.array(POSE_SCALE), boxplus)
    views = (
        BoardViews(corners=corners_a[known], points=points, camera=a),
        BoardViews(corners=corners_b[known], points=points, camera=b, relative=True),
    )
    x = Variables({"T_cam_reference": start}, board_latent(T_a[known]))
    found = least_squares(views, x)
    squares = sum(float((errors**2).sum()) for errors in found.errors)
    return found.x["T_cam_reference"], float(np.sqrt(squares / (2 * both[known].sum())))
