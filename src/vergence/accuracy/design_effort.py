"""What the calibration of a designed head adds to the error of a point, by the effort it takes.

A standard recording: boards at eight places near the head, each seen by both eyes from three
directions of gaze, filling half to three quarters of the images' height whatever the lens. Its
information is bundle adjustment's own, with joint readings as noisy as the head's and corners as
noisy as stated; V views carry V / 24 of it. Focal lengths, image centres, mountings, gains and axes
are estimated, distortion is taken as known.
"""

from __future__ import annotations

import numpy as np

from vergence.accuracy.design import gaze_at
from vergence.accuracy.plan_information import information, linearised_views, without_place
from vergence.accuracy.plan_views import MARGIN_PX, Views
from vergence.accuracy.plan_workspace import point_by_parameters
from vergence.arrays import Array
from vergence.calibration.bundle.bundle_adjustment import fixed_by_default
from vergence.geometry.board import Chessboard, corner_points
from vergence.geometry.camera import pinhole
from vergence.geometry.head import HeadCalibration, MountedCamera
from vergence.geometry.kinematics import EYES
from vergence.geometry.parameters import POSE, parameter_names
from vergence.geometry.se3 import pose, rotation

R_EYE_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""A camera, and a board, that look along x and against it."""
PLACES, GAZES = 8, 3
VIEWS = PLACES * GAZES
FILLS = (0.5, 0.75)
"""Of an image's height, by the circle about a board, as large as its slant may make it."""
LEAN_RAD = (0.6, 0.6, 0.4)
"""Slants, and the turn in its plane, of a board."""
GAZE_RAD = (0.35, 0.25)
"""Pan and tilt towards boards, to either side."""
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
    draw = rng.uniform(-1, 1, (PLACES, 6))
    lens = head.cameras["left_wide"].intrinsics
    size_px, f = np.array([lens.width, lens.height]), lens.matrix[0, 0]
    baseline = head.T_rbase_lbase[1, 3]
    corners = corner_points(board)
    radius = np.linalg.norm(np.ptp(corners, axis=0)) / 2
    radius_px = (np.mean(FILLS) + draw[:, 0] * np.ptp(FILLS) / 2) * lens.height / 2
    distance = radius * (f / radius_px + np.sin(np.linalg.norm(LEAN_RAD[:2])))
    pan, tilt = draw[:, 1] * GAZE_RAD[0], draw[:, 2] * GAZE_RAD[1]
    ray = np.stack([np.cos(tilt) * np.cos(pan), np.cos(tilt) * np.sin(pan), -np.sin(tilt)], -1)
    centre = distance[:, None] * ray
    R = _turn(pan, tilt) @ R_EYE_CAM @ rotation(draw[:, 3:] * LEAN_RAD)
    from_left = centre - [0.0, baseline / 2, 0.0]
    T = pose(R, from_left - R @ corners.mean(axis=0))
    # The board moves through the images by as much as leaves it whole there; angles add up.
    edge = np.arctan((size_px / 2 - MARGIN_PX) / f)
    room = USED * np.maximum(edge - np.arctan(radius_px / f)[:, None], 0.0)
    fixating = np.stack(gaze_at(np.array(baseline), centre), axis=-1)
    off = rng.uniform(-1, 1, (PLACES, GAZES, 2, 2)) * room[:, None, None]
    joints = fixating[:, None] + off.reshape(PLACES, GAZES, 4)
    place = np.repeat(np.arange(PLACES), GAZES)
    return Views(T[place], joints.reshape(VIEWS, 4), place)


def _turn(pan: Array, tilt: Array) -> Array:
    """Return Rz(pan) Ry(tilt) (N, 3, 3)."""
    zero = np.zeros_like(pan)
    about_z = rotation(np.stack([zero, zero, pan], axis=-1))
    return about_z @ rotation(np.stack([zero, tilt, zero], axis=-1))


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
    columns = [parameter_names(head).index(name) for name in names]
    views = standard_recording(head, board)
    linear = linearised_views(head, board, views, names, np.ones(len(names)))
    pair = ("left_wide", "right_wide")
    moved = point_by_parameters(head, pair, points_m, joints)[..., columns].reshape(-1, len(names))
    found = []
    for std in joint_std_rad:
        of_views = information(linear, corner_std_px, np.array(std))
        unknowns = len(names) + len(POSE)
        at_places = of_views.reshape(PLACES, GAZES, unknowns, unknowns).sum(axis=1)
        total = without_place(at_places).sum(axis=0)
        scale = 1 / np.sqrt(np.diag(total))
        L = np.linalg.cholesky(np.linalg.inv(total * np.outer(scale, scale)))
        spread = moved @ (scale[:, None] * L)
        found.append((spread**2).sum(axis=1).reshape(-1, 3).sum(axis=1))
    return VIEWS * np.array(found)
