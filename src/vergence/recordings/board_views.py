"""Where the board stands before each camera of a recording, with lenses that need only be rough."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.calibration.board_numbering import nearest_numbering
from vergence.calibration.intrinsics import calibrate_camera
from vergence.calibration.lenses import LensModel
from vergence.data.description import DatasetCamera
from vergence.errors import VergenceError
from vergence.geometry.board import Board, corner_points
from vergence.geometry.camera import Camera, pinhole, project
from vergence.geometry.eye_motion import eye_linearised
from vergence.geometry.kinematics import EYES, Kinematics, Side
from vergence.geometry.se3 import known_poses, pose, transform
from vergence.recordings.board_motion import EyeViews, carried
from vergence.vision.board_pose import (
    LEAST_CORNERS,
    board_errors,
    board_poses,
    determines_pose,
    refined_poses,
    seen_corners,
    seen_from_the_other_side,
)

LENSES: tuple[LensModel, ...] = ("radial-tangential", "fisheye", "none")
"""Lenses that are tried in turn, until one is good enough for poses of boards."""
GOOD_LENS_PX, BEST_LENS_PX = 0.5, 0.05
"""Root mean square of corners' errors [px] up to which a lens is good enough, and least one."""
SHIFT_M = 0.2
"""Error of a measured pose's position [m] that counts as one of its rotation by 1 rad."""


@dataclass(frozen=True, eq=False)
class BoardViews:
    """What one camera saw in n frames."""

    rows: np.ndarray
    """(n,) of int: which frames; those whose corners determine the board's pose."""
    T_cam_target: Array
    """(n, 4, 4), all numbered from one end of the board."""
    covariance: Array
    """(n, 6, 6) of its increments, as if corners near each other erred alike."""
    pixels: Array
    """(n, K, 2) where the pose puts the corners [px]."""


def board_views(stated: DatasetCamera, board: Board, corners: Array) -> BoardViews | None:
    """Place the board before a camera, by its corners (m, K, 2) [px], NaN where not seen.

    None: no view determines its pose.
    """
    points = corner_points(board)
    rows = np.flatnonzero(determines_pose(points, seen_corners(corners)))
    if not len(rows):
        return None
    camera = _rough_lens(stated, corners[rows], points)
    T = _board_poses(camera, corners[rows], points)
    rows, T = rows[known_poses(T)], T[known_poses(T)]
    errors, by_pose, _ = board_errors(camera, T, corners[rows], points)
    count = seen_corners(corners[rows]).sum(axis=1)
    squares = (errors**2).sum(axis=1) / (2 * count)
    least = max(BEST_LENS_PX**2, float(squares.mean()))
    scale = np.maximum(squares, least) * count / LEAST_CORNERS
    R, middle = nearest_numbering(T[:, :3, :3], board), points.mean(axis=0)
    turned = pose(R, T[:, :3, 3] + (T[:, :3, :3] - R) @ middle)
    carry = carried(np.tile(np.eye(6), (len(T), 1, 1)), turned[:, :3, 3] - T[:, :3, 3])
    covariance = scale[:, None, None] * np.linalg.inv(np.swapaxes(by_pose, 1, 2) @ by_pose)
    return BoardViews(
        rows,
        turned,
        carry @ covariance @ np.swapaxes(carry, 1, 2),
        project(camera, transform(turned[:, None], points)),
    )


def eye_views(views: BoardViews, kinematics: Kinematics, eye: Side, readings: Array) -> EyeViews:
    """Join views with the poses of their eye, by readings (m, r) or poses (m, 2, 4, 4)."""
    readings, board = readings[views.rows], (views.T_cam_target, views.covariance)
    if readings.ndim > 2:
        T = readings[:, EYES.index(eye)]
        by_errors = np.tile(np.diag([1.0] * 3 + [SHIFT_M] * 3), (len(T), 1, 1))
        return EyeViews(T, by_errors, *board)
    T, _, by_readings = eye_linearised(kinematics, eye, readings)
    used = kinematics.used(eye)
    by, gears = by_readings[..., used], kinematics.gear_ratios[used]
    return EyeViews(T, by / gears, *board)


def _rough_lens(stated: DatasetCamera, corners: Array, points: Array) -> Camera:
    """Fit a lens; without enough views take the stated one, or guess."""
    size, best, least_px = (stated.width, stated.height), stated.intrinsics, np.inf
    for model in LENSES:
        try:
            found = calibrate_camera(corners, points, size=size, lens_model=model)
        except VergenceError:
            continue
        if found.rms_px < least_px:
            best, least_px = found.camera, found.rms_px
        if least_px < GOOD_LENS_PX:
            break
    return pinhole(*size, 0.9 * size[0]) if best is None else best


def _board_poses(camera: Camera, corners: Array, points: Array) -> Array:
    """Fit T_cam_target (n, 4, 4), with the slant of two that fits better."""
    T, squares = refined_poses(camera, corners, points, board_poses(camera, corners, points))
    other = seen_from_the_other_side(T, points)
    other, by_other = refined_poses(camera, corners, points, other)
    return np.where((by_other < squares)[:, None, None], other, T)
