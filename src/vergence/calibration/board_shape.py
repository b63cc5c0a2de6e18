"""Whether the board's squares are square, by its images.

A board that a printer has stretched along one side looks like pixels that are not square, and makes
a focal length wrong. Where boards are rolled in the image, or slanted, the two are told apart: the
stretch turns with the board, and that of the pixels does not.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vergence.arrays import Array
from vergence.calibration.intrinsics import Intrinsics
from vergence.calibration.lens_statistics import jackknife_covariance, noise_covariance
from vergence.calibration.lenses import without_poses
from vergence.calibration.observations import Observations
from vergence.findings import Finding, void, warning
from vergence.geometry.board import corner_points
from vergence.geometry.se3 import known_poses
from vergence.vision.board_pose import board_errors, determines_pose, seen_corners

LEAST_VIEWS = 6
"""Of a camera that says something: with fewer the views' own scatter says nothing."""
SURE = 4.0
"""Standard deviations from which a stretch is no chance."""
LEAST_STRETCH = 5e-4
"""Stretch that is spoken of: it makes focal lengths wrong by about as much as good recordings leave
them uncertain."""
LEAST_STRETCH_IN_MOTION = 1e-3
"""Stretch with which rows of moving eyes must not be used: with 0.2 % and corners known to 0.01 px
points were wrong by 12 % where rows at rest left 1 %. The images of one motion share the error."""
_STEP = 1e-6
"""Relative change of the board by which derivatives are taken."""


def stretch(
    observations: Observations,
    T_cam_target: Mapping[str, Array],
    intrinsics: Mapping[str, Intrinsics],
) -> tuple[float, float]:
    """Return by how much squares are higher than wide, relative to it, and its standard deviation.

    By all cameras, weighted; the deviation is infinite where no camera tells. T_cam_target has by
    camera the poses (V, 4, 4) of the board by its intrinsics, NaN where not known.
    """
    points, found = corner_points(observations.board), []
    for name, each in intrinsics.items():
        corners, T = observations.corners[name], T_cam_target[name]
        usable = determines_pose(points, seen_corners(corners)) & known_poses(T)
        found.append(_stretch_of_camera(each, T[usable], corners[usable], points))
    values, stds = np.array(found).reshape(-1, 2).T
    information = (1 / stds**2).sum()
    if not information > 0:
        return 0.0, np.inf
    return float((values / stds**2).sum() / information), float(1 / np.sqrt(information))


def stretched_board(
    observations: Observations,
    T_cam_target: Mapping[str, Array],
    intrinsics: Mapping[str, Intrinsics],
    *,
    moving: bool,
) -> list[Finding]:
    """Find squares that are not square; the arguments are stretch's.

    With rows of moving eyes, whose images share the error, the result must not be used.
    """
    value, std = stretch(observations, T_cam_target, intrinsics)
    if not abs(value) > max(SURE * std, LEAST_STRETCH):
        return []
    board = observations.board
    height_m = (1 + value) * (board.square_y_m or board.square_m)
    sentence = (
        f"The squares of the board are {100 * abs(value):.2f} % "
        f"{'higher' if value > 0 else 'lower'} than wide by the images (one standard deviation: "
        f"{100 * std:.2f} %), which makes focal lengths wrong by as much: measure the board along "
        "its rows and its columns, state both sides in dataset.json (by the images "
        f"board.square_y_m is {height_m:.6g} if board.square_m is right), and check that it is "
        "flat."
    )
    if moving and abs(value) > LEAST_STRETCH_IN_MOTION:
        sentence += " With rows of moving eyes it makes gains and axes wrong; leave them out."
        return [void("stretched-board-in-motion", sentence)]
    return [warning("stretched-board", sentence)]


def _stretch_of_camera(
    lens: Intrinsics, T_cam_target: Array, corners: Array, points: Array
) -> tuple[float, float]:
    """Return the stretch and its standard deviation, by one step of least squares from a fit.

    The deviation is infinite where views or corners are too few.
    """
    camera = lens.camera
    errors, by_pose, by_lens = board_errors(camera, T_cam_target, corners, points)
    stretched, *_ = board_errors(camera, T_cam_target, corners, points * [1, 1 + _STEP, 1])
    by_stretch = (stretched - errors)[..., None] / _STEP
    by_all = np.concatenate([by_lens[..., lens.free], by_stretch], axis=2)
    # A view of few corners may have a pose that puts one of them behind the camera.
    before = np.isfinite(errors).all(axis=1) & np.isfinite(by_all).all(axis=(1, 2))
    if before.sum() < LEAST_VIEWS:
        return 0.0, np.inf
    errors, corners = errors[before], corners[before]
    rest = without_poses(by_pose[before], by_all[before])
    information_inverse = noise_covariance(rest, 1.0)
    step = -information_inverse @ np.einsum("vin,vi->n", rest, errors)
    left = errors + rest @ step
    redundancy = 2 * seen_corners(corners).sum() - 6 * len(corners) - rest.shape[2]
    if redundancy < 1:
        return 0.0, np.inf
    variance = (left**2).sum() / redundancy
    by_noise, by_views = information_inverse * variance, jackknife_covariance(left, rest)
    return float(step[-1]), float(np.sqrt(max(by_noise[-1, -1], by_views[-1, -1])))
