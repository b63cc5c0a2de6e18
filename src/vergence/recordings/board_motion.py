"""Whether a board stood still between two views of a camera whose eye turned.

A camera that sits at T_eye_cam in its eye places the board at T_base_eye T_eye_cam T_cam_target.
Errors of readings shift and turn that pose along a few directions only, errors of corners along all
of them. Lenses need only be rough. Where the camera sits, and how much the readings err, follows
from the views themselves: first by a consensus of turns, then by those pairs of views whose boards
agree.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.stats import chi2

from vergence.arrays import Array
from vergence.calibration.board_numbering import nearest_numbering
from vergence.calibration.hand_eye import park_martin, solve_rotation
from vergence.calibration.intrinsics import calibrate_camera
from vergence.calibration.lenses import LensModel
from vergence.data.description import DatasetCamera, Description
from vergence.errors import VergenceError
from vergence.geometry.board import corner_points
from vergence.geometry.camera import Camera, pinhole, project
from vergence.geometry.eye_motion import eye_linearised
from vergence.geometry.kinematics import EYES
from vergence.geometry.se3 import (
    angle,
    boxminus,
    boxplus,
    hat,
    inverse,
    known_poses,
    pose,
    rotvec,
    transform,
)
from vergence.vision.board_pose import (
    LEAST_CORNERS,
    board_errors,
    board_poses,
    refined_poses,
    seen_from_the_other_side,
)

READING_RAD = np.radians(0.5), np.radians(0.01), np.radians(1.0)
"""Deviation of readings assumed first, least and largest [rad]: half of a backlash of one degree;
below a good encoder; a hobby servo."""
GAIN_STD = 0.03
"""Deviation of gains from one, of servos and of gears."""
GATE = float(chi2.isf(1e-6, 6))
"""Squared distance of six standard normal numbers from which a board has moved."""
TURNS_RAD, TURNS_PART = np.radians(1.5), 0.05
"""Difference of an eye's and a camera's turn [rad], and as a part of it, that backlash and gains
explain."""
SUCCESSIVE, LEAST_PAIRS = 3, 6
"""Views that place the camera for a start, and fewest pairs that agree with it: all of four views.
"""
EASES = 10.0, 3.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0
"""Factors on GATE in the steps of the robust estimate, whose start is off by a centimetre."""
LENSES: tuple[LensModel, ...] = ("radial-tangential", "fisheye")
"""Lenses that are tried in turn, until one is good enough."""
GOOD_LENS_PX, BEST_LENS_PX = 0.5, 0.05
"""Root mean square of corners' errors [px] up to which a lens is good enough, and least one."""
SHIFT_M = 0.2
"""Error of a measured pose's position [m] that counts as one of its rotation by 1 rad."""


@dataclass(frozen=True, eq=False)
class BoardViews:
    """n views of a board by one camera, and how its eye stood."""

    rows: np.ndarray
    """(n,) of int: which frames; those whose corners determine the board's pose."""
    T_base_eye: Array
    """(n, 4, 4) by the readings."""
    by_errors: Array
    """(n, 6, q) increments of that pose by the q quantities that err, each as 1 rad of a joint."""
    T_cam_target: Array
    """(n, 4, 4), all numbered from one end of the board."""
    covariance: Array
    """(n, 6, 6) of its increments, as if corners near each other erred alike."""
    pixels: Array
    """(n, K, 2) where the pose puts the corners [px]."""


def board_views(
    description: Description, name: str, corners: Array, readings: Array
) -> BoardViews | None:
    """Place the board before a camera, by its corners (m, K, 2) [px], NaN where not seen.

    Readings are (m, r), or poses (m, 2, 4, 4). None: no view determines the board's pose.
    """
    stated, board = description.cameras[name], description.board
    if board is None or not np.isfinite(corners).any():
        return None
    points = corner_points(board)
    camera = _rough_lens(stated, corners, points)
    refined = partial(refined_poses, camera, corners, points)
    T, squares = refined(board_poses(camera, corners, points))
    slanted, others = refined(seen_from_the_other_side(T, points))
    T[others < squares] = slanted[others < squares]
    rows = np.flatnonzero(known_poses(T))
    if not len(rows):
        return None
    T, squares = T[rows], np.minimum(squares, others)[rows]
    # A board that is turned about its middle has its corners at the same places.
    R, middle = nearest_numbering(T[:, :3, :3], board), points.mean(axis=0)
    T = pose(R, T[:, :3, 3] + (T[:, :3, :3] - R) @ middle)
    _, by_pose, _ = board_errors(camera, T, corners[rows], points)
    variance = np.maximum(squares.mean(), squares) / 2 / LEAST_CORNERS + BEST_LENS_PX**2
    information = np.swapaxes(by_pose, 1, 2) @ by_pose
    if readings.ndim > 2:
        T_base_eye = readings[rows, EYES.index(stated.eye)]
        by_errors = np.tile(np.diag([1.0] * 3 + [SHIFT_M] * 3), (len(T), 1, 1))
    else:
        kinematics = description.head_kinematics
        T_base_eye, _, by_errors = eye_linearised(kinematics, stated.eye, readings[rows])
        used = kinematics.used(stated.eye)
        by_errors = by_errors[..., used] / kinematics.gear_ratios[used]
    return BoardViews(
        rows,
        T_base_eye,
        by_errors,
        T,
        variance[:, None, None] * np.linalg.inv(information),
        project(camera, transform(T[:, None], points)),
    )


def _rough_lens(stated: DatasetCamera, corners: Array, points: Array) -> Camera:
    """Fit a lens; without enough views take the stated one, or guess."""
    size = stated.width, stated.height
    camera = stated.intrinsics or pinhole(*size, 0.9 * size[0])
    for model in LENSES:
        with suppress(VergenceError):
            found = calibrate_camera(corners, points, size=size, lens_model=model)
            camera = found.camera
            if found.rms_px < GOOD_LENS_PX:
                break
    return camera


def squared_distances(views: BoardViews, i: np.ndarray, k: np.ndarray) -> Array:
    """Compute the squared distances (p,) of the boards in pairs of views i and k (p,).

    They are those of six standard normal numbers where the board stood still; NaN: the views do not
    tell where the camera sits.
    """
    T_eye_cam, reading_rad = _consensus(views, i, k), READING_RAD[0]
    squared = np.full(len(i), np.nan)
    if T_eye_cam is None:
        return squared
    turned_rad = angle((inverse(views.T_base_eye[i]) @ views.T_base_eye[k])[:, :3, :3])
    by_gains = (GAIN_STD * turned_rad) ** 2 / 2  # of the sum of two
    for ease in EASES:
        T_base_cam = views.T_base_eye @ T_eye_cam
        T = T_base_cam @ views.T_cam_target
        arms = (T[:, :3, 3] - each[:, :3, 3] for each in (T_base_cam, views.T_base_eye))
        by_camera, by_errors = map(_carried, (_block(views.T_base_eye), views.by_errors), arms)
        turned = _block(T_base_cam)
        by_corners = turned @ views.covariance @ np.swapaxes(turned, 1, 2)
        by_readings = by_errors @ np.swapaxes(by_errors, 1, 2)
        away, by_camera, J = boxminus(T[k], T[i]), by_camera[k] - by_camera[i], by_errors[k]
        by_corners, by_readings = (C[i] + C[k] for C in (by_corners, by_readings))
        W = np.linalg.inv(by_corners + (reading_rad**2 + by_gains)[:, None, None] * by_readings)
        squared = np.einsum("pi,pij,pj->p", away, W, away)
        W *= ((1 + squared / (ease * GATE)) ** -2)[:, None, None]  # of Geman and McClure
        normal = np.einsum("pia,pij,pjb->ab", by_camera, W, by_camera)
        right = np.einsum("pia,pij,pj->a", by_camera, W, away)
        T_eye_cam = boxplus(T_eye_cam, -np.linalg.pinv(normal, 1e-9, hermitian=True) @ right)
        near = squared < GATE
        if near.sum() >= LEAST_PAIRS:
            J_W = np.swapaxes(J, 1, 2)[near] @ np.linalg.inv(by_corners[near])
            errors = np.linalg.solve(J_W @ J[near], J_W @ away[near, :, None])
            # The deviation by the median, of differences of two; less by half at most in a step.
            median = float(np.median(np.abs(errors), axis=0).max())
            least, most = READING_RAD[1:]
            reading_rad = min(max(1.05 * median, least, reading_rad / 2), most)
    return squared


def _carried(by: Array, arm: Array) -> Array:
    """Carry increments (n, 6, m) of a frame over to what is fixed to it, an arm (n, 3) away."""
    return np.concatenate([by[:, :3], by[:, 3:] - hat(arm) @ by[:, :3]], axis=1)


def _block(T: Array) -> Array:
    """Turn increments (n, 6) from the axes of frame b into those of frame a, by T_a_b (n, 4, 4)."""
    return np.einsum("ab,nij->naibj", np.eye(2), T[:, :3, :3]).reshape(-1, 6, 6)


def _consensus(views: BoardViews, i: np.ndarray, k: np.ndarray) -> Array | None:
    """Find a T_eye_cam of SUCCESSIVE views by which most pairs turn as read; None: too few do.

    A reading of the wrong sign looks like another mounting, to first order.
    """
    E, T = views.T_base_eye, views.T_cam_target
    i, k = i[k - i <= SUCCESSIVE], k[k - i <= SUCCESSIVE]
    A, B = inverse(E[i]) @ E[k], T[i] @ inverse(T[k])
    by_eye, by_camera = rotvec(A[:, :3, :3]), rotvec(B[:, :3, :3])
    turn = np.linalg.norm(by_eye, axis=1)
    allowed = TURNS_RAD + TURNS_PART * turn
    best = np.zeros(len(i), bool)
    for first in range(len(E) - SUCCESSIVE + 1):
        few = slice(first, first + SUCCESSIVE)
        with suppress(VergenceError):
            R = park_martin(E[few], T[few])[:3, :3]
            agreeing = np.linalg.norm(by_eye - by_camera @ R.T, axis=1) < allowed
            best = max(best, agreeing & (turn > allowed), key=np.count_nonzero)
    if np.count_nonzero(best) < LEAST_PAIRS:
        return None
    R = solve_rotation(by_eye[best], by_camera[best])
    right = A[best, :3, 3] - B[best, :3, 3] @ R.T
    left = (np.eye(3) - A[best, :3, :3]).reshape(-1, 3)
    return pose(R, np.linalg.lstsq(left, right.ravel(), rcond=0.01)[0])
