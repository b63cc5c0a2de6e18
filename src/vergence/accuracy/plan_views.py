"""Candidate views of a board: where the board stands, and where the eyes look.

A view is admissible if the main camera of each eye shows the whole board, not too slanted, and
every joint is within its limits. The other cameras of the head count if they show it whole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.calibration.observations import Observations
from vergence.errors import VergenceError
from vergence.geometry.board import Board, corner_points
from vergence.geometry.camera import in_valid_field, project
from vergence.geometry.eye_motion import eye_poses
from vergence.geometry.head import HeadCalibration, main_cameras
from vergence.geometry.kinematics import EYES
from vergence.geometry.projection import camera_pose
from vergence.geometry.se3 import inverse, pose, rotation, transform

MARGIN_PX = 10.0
"""Distance of the board from the edge of an image [px]: a hand holds it a little off its place."""
LEAN_RAD = 0.7
"""Maximum turn of a board about each of its axes [rad]: beyond, corners are hard to detect."""


@dataclass(frozen=True, eq=False)
class Views:
    """V views of a board."""

    T_lbase_target: Array
    """(V, 4, 4) poses of the board."""
    joints: Array
    """(V, r) readings of the eyes' joints [rad]."""
    placement: np.ndarray
    """(V,) of int: views with the same number have the board at the same place."""

    def take(self, rows: np.ndarray | slice) -> Views:
        """Select views by their rows."""
        return Views(self.T_lbase_target[rows], self.joints[rows], self.placement[rows])


def target_poses(head: HeadCalibration, views: Views) -> dict[str, Array]:
    """Compute the poses (V, 4, 4) of the board by camera."""
    T = eye_poses(head, views.joints)
    return {
        name: inverse(camera_pose(mounted, head.T_rbase_lbase, T[:, EYES.index(mounted.eye)]))
        @ views.T_lbase_target
        for name, mounted in head.cameras.items()
    }


def shows_whole_board(head: HeadCalibration, board: Board, views: Views) -> np.ndarray:
    """Test which of the C cameras of a head show the whole board: (V, C) of bool."""
    # Corners of the outline suffice, and large boards have many others.
    grid = corner_points(board).reshape(board.rows, board.columns, 3)
    outline = np.concatenate([grid[0], grid[-1], grid[1:-1, 0], grid[1:-1, -1]])
    shown = []
    for name, T in target_poses(head, views).items():
        lens, points = head.cameras[name].intrinsics, transform(T[:, None], outline)
        pixels, size = project(lens, points), np.array(lens.size)
        inside = ((pixels > MARGIN_PX) & (pixels < size - 1 - MARGIN_PX)).all(axis=-1)
        shown.append((inside & in_valid_field(lens, *np.moveaxis(points, -1, 0))).all(axis=1))
    return np.stack(shown, axis=1)


def admissible_views(
    head: HeadCalibration,
    board: Board,
    limits_rad: Array,
    rng: np.random.Generator,
    *,
    places: int,
    gazes: int,
) -> Views:
    """Draw admissible views: at each of some places of the board, some directions of gaze.

    `limits_rad` (r,) are the largest readings to either side. Raises VergenceError if the board
    fits whole into the images of the eyes' main cameras at too few places.
    """
    found: list[Views] = []
    for T in _boards(head, board, limits_rad, rng, 20 * places):
        views = views_at(head, board, T, limits_rad, rng, gazes=gazes, placement=len(found))
        if len(views.placement) == gazes:
            found.append(views)
        if len(found) == places:
            return joined(*found)
    size = f"{board.columns} x {board.rows} corners of {1e3 * board.square_m:g} mm"
    raise VergenceError(
        f"A board of {size} fits whole into the images of the eyes at {len(found)} of "
        f"{places} places; take a smaller board, or let the joints move farther."
    )


def views_at(
    head: HeadCalibration,
    board: Board,
    T_lbase_target: Array,
    limits_rad: Array,
    rng: np.random.Generator,
    *,
    gazes: int,
    placement: int,
) -> Views:
    """Draw at most `gazes` admissible directions of gaze at a board (4, 4), one placement."""
    joints = rng.uniform(-limits_rad, limits_rad, (400, len(limits_rad)))
    number = np.full(400, placement)
    tried = Views(np.broadcast_to(T_lbase_target, (400, 4, 4)), joints, number)
    main = [list(head.cameras).index(name) for name in main_cameras(head)]
    shown = shows_whole_board(head, board, tried)[:, main].all(axis=1)
    return tried.take(np.flatnonzero(shown)[:gazes])


def joined(*parts: Views) -> Views:
    """Join views, in their order."""
    return Views(
        np.concatenate([part.T_lbase_target for part in parts]),
        np.concatenate([part.joints for part in parts]),
        np.concatenate([part.placement for part in parts]),
    )


def _boards(
    head: HeadCalibration, board: Board, limits_rad: Array, rng: np.random.Generator, count: int
) -> Array:
    """Draw T_lbase_target (count, 4, 4) about the axes of the first main camera."""
    mounted = head.cameras[main_cameras(head)[0]]
    corners = corner_points(board)
    gaze = rng.uniform(-limits_rad, limits_rad, (count, len(limits_rad)))
    T_base_eye = eye_poses(head, gaze)[:, EYES.index(mounted.eye)]
    T_lbase_cam = camera_pose(mounted, head.T_rbase_lbase, T_base_eye)
    lens = mounted.intrinsics
    size = np.ptp(corners, axis=0).max()
    fills = rng.uniform(0.35, 0.9, count)  # of the width of the image, by a board that faces it
    depth = size * lens.matrix[0, 0] / (fills * lens.width)
    # Anywhere in the image: a later test finds out whether both images show the whole board.
    aside = rng.uniform(-0.5, 0.5, (count, 2)) * (1 - fills)[:, None]
    aside *= np.array(lens.size) / lens.matrix[0, 0] * depth[:, None]
    R = rotation(rng.uniform(-LEAN_RAD, LEAN_RAD, (count, 3)))
    centre = np.concatenate([aside, depth[:, None]], axis=1)
    return T_lbase_cam @ pose(R, centre - (R @ corners.mean(axis=0)))


def as_seen(head: HeadCalibration, board: Board, views: Views) -> Observations:
    """Simulate the observations of views without noise; a camera shows whole boards or nothing."""
    shown, corners = shows_whole_board(head, board, views), {}
    for c, (name, T) in enumerate(target_poses(head, views).items()):
        pixels = project(head.cameras[name].intrinsics, transform(T[:, None], corner_points(board)))
        corners[name] = np.where(shown[:, c, None, None], pixels, np.nan)
    return Observations(
        board=board,
        placement=views.placement,
        eye_angles=views.joints,
        corners=corners,
        sizes={name: mounted.intrinsics.size for name, mounted in head.cameras.items()},
        eyes={name: mounted.eye for name, mounted in head.cameras.items()},
        kinematics=head.kinematics,
    )
