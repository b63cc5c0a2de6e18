"""What the calibration of a designed head adds to the error of a point, by the effort it takes.

A standard recording, in the proportions that docs/calibrate.md advises for wide cameras: boards
at eight places near the head, seen by both eyes at straight gaze, and one board at rest that they
see from 16 directions of gaze. They fill half to three quarters of the images' height whatever the
lens. Its information is bundle adjustment's own, with joint readings as noisy as the head's and
corners as noisy as stated; V views carry V / 24 of it. Focal lengths, image centres, mountings,
gains and axes are estimated, distortion is taken as known.
"""

from __future__ import annotations

import numpy as np

from vergence.accuracy.design import gaze_at
from vergence.accuracy.plan_information import gained, information, linearised_views
from vergence.accuracy.plan_views import MARGIN_PX, Views
from vergence.accuracy.plan_workspace import point_by_parameters
from vergence.arrays import Array
from vergence.calibration.bundle.bundle_adjustment import fixed_by_default
from vergence.geometry.board import Chessboard, corner_points
from vergence.geometry.camera import pinhole
from vergence.geometry.head import R_EYE_CAM, WIDE, HeadCalibration, MountedCamera
from vergence.geometry.kinematics import EYES, looking_along
from vergence.geometry.parameters import named_columns, parameter_names
from vergence.geometry.se3 import pose, rotation

STRAIGHT, GAZES = 8, 16
"""Boards at straight gaze, and directions of gaze to a board at rest."""
VIEWS = STRAIGHT + GAZES
FILLS = (0.5, 0.75)
"""Shares of an image's height that the circle about a board fills, however it is slanted."""
LEAN_RAD = (0.6, 0.6, 0.4)
"""Slants, and the turn in its plane, of a board."""
USED = 0.85
"""Part of the room that a board leaves in an image through which it moves."""


def designed_head(
    baseline_m: float, focal_px: float, camera_ahead_m: float, image_px: tuple[int, int]
) -> HeadCalibration:
    """Return the symmetric head of `design`: two pinhole cameras ahead of the rotation centres."""
    mounted = pose(R_EYE_CAM, [camera_ahead_m, 0.0, 0.0])
    return HeadCalibration(
        cameras={
            f"{eye}_wide": MountedCamera(
                eye=eye, intrinsics=pinhole(*image_px, focal_px), T_eye_cam=mounted
            )
            for eye in EYES
        },
        T_rbase_lbase=pose(t=[0.0, baseline_m, 0.0]),
    )


def standard_recording(head: HeadCalibration, board: Chessboard) -> Views:
    """Return 24 views of a board by a designed head: the same for all heads, to their scale."""
    rng = np.random.default_rng(0)
    draw, around = rng.uniform(-1, 1, (STRAIGHT + 1, 6)), rng.uniform(-1, 1, (GAZES, 2))
    draw[-1, 1:3] = 0  # the board at rest stands ahead
    lens, baseline = head.cameras["left_wide"].intrinsics, head.T_rbase_lbase[1, 3]
    size_px, f = np.array(lens.size), lens.matrix[0, 0]
    corners = corner_points(board)
    radius = np.linalg.norm(np.ptp(corners, axis=0)) / 2
    radius_px = (np.mean(FILLS) + draw[:, 0] * np.ptp(FILLS) / 2) * lens.height / 2
    distance = radius * (f / radius_px + np.sin(np.linalg.norm(LEAN_RAD[:2])))
    # The board stands wherever both images hold it whole; angles add up.
    edge = np.arctan((size_px / 2 - MARGIN_PX) / f)
    room = USED * np.maximum(edge - np.arctan(radius_px / f)[:, None], 0.0)
    apart = np.arctan(baseline / 2 / distance)
    pan = draw[:, 1] * np.maximum(room[:, 0] - apart, 0.0)
    tilt = draw[:, 2] * room[:, 1]
    centre = distance[:, None] * looking_along(pan, tilt)
    R = R_EYE_CAM @ rotation(draw[:, 3:] * LEAN_RAD)
    T = pose(R, centre - [0.0, baseline / 2, 0.0] - R @ corners.mean(axis=0))
    fixating = np.stack(gaze_at(np.array(baseline), centre[-1]), axis=-1)
    moving = fixating + np.tile(around * room[-1], 2)
    place = np.append(np.arange(STRAIGHT), np.full(GAZES, STRAIGHT))
    return Views(T[place], np.concatenate([np.zeros((STRAIGHT, 4)), moving]), place)


def calibration_mean_square(
    head: HeadCalibration,
    board: Chessboard,
    *,
    points_m: Array,
    joints: Array,
    corner_std_px: float,
    joint_std_rad: Array,
) -> Array:
    """Return (S, N) [m^2] what one view's worth of calibration adds; V views add a Vth of it.

    Args:
        head: that of `designed_head`.
        board: that it is calibrated with.
        points_m: (N, 3) in the left eye's base frame.
        joints: (N, 4) readings at which they are located.
        corner_std_px: noise of one coordinate of a corner.
        joint_std_rad: (S,) levels of the noise of readings.
    """
    fixed = fixed_by_default(head, timed=False)
    names = tuple(name for name in parameter_names(head) if name not in fixed)
    columns = named_columns(head, names)
    views = standard_recording(head, board)
    linear = linearised_views(head, board, views, names, np.ones(len(names)))
    moved = point_by_parameters(head, WIDE, points_m, joints)[..., columns].reshape(-1, len(names))
    found = []
    for std in joint_std_rad:
        total = gained(information(linear, corner_std_px, np.full(4, std)), views.placement)
        scale = 1 / np.sqrt(np.diag(total))
        L = np.linalg.cholesky(np.linalg.inv(total * np.outer(scale, scale)))
        spread = moved @ (scale[:, None] * L)
        found.append((spread**2).sum(axis=1).reshape(-1, 3).sum(axis=1))
    return VIEWS * np.array(found)
