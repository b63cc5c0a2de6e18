"""Views of a board that a head could record: where the board stands, and where the eyes look.

A view is admissible when the main camera of each eye holds the whole board, not too slanted, and
every joint stays within its limits. The other cameras of the head count where they hold it whole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.calibration.observations import Observations
from vergence.errors import VergenceError
from vergence.geometry.board import Board, corner_points
from vergence.geometry.camera import in_reach
from vergence.geometry.eye_motion import eye_poses
from vergence.geometry.head import HeadCalibration, pair_names
from vergence.geometry.kinematics import EYES
from vergence.geometry.projection import T_lbase_cam, project_at
from vergence.geometry.se3 import inverse, pose, rotation, transform

MARGIN_PX = 10.0
"""Between the board and the edge of an image: a hand does not hold it where a plan says exactly."""
LEAN_RAD = 0.7
"""A board is turned by at most this about each of its axes: beyond, corners are hard to find."""
FILLS = (0.35, 0.9)
"""How much of the width of an image a board that faces it fills, far off and near."""
TRIES = 400
"""Postures that are tried for each view that is wanted."""


@dataclass(frozen=True, eq=False)
class Views:
    """V views of a board."""

    T_lbase_target: Array
    """(V, 4, 4) where the board stands."""
    joints: Array
    """(V, r) readings of the eyes' joints [rad]."""
    placement: np.ndarray
    """(V,) of int: views with the same number have the board at the same place."""

    def take(self, rows: np.ndarray | slice) -> Views:
        """Return some of the views."""
        return Views(self.T_lbase_target[rows], self.joints[rows], self.placement[rows])


def held_whole(head: HeadCalibration, board: Board, views: Views) -> np.ndarray:
    """Return (V, C) of bool: which of the C cameras of a head hold the whole board in V views."""
    # What holds all corners of the outline holds those inside too; large boards have many.
    corners = corner_points(board).reshape(board.rows, board.columns, 3)
    edges = corners[0], corners[-1], corners[1:-1, 0], corners[1:-1, -1]
    corners = np.concatenate(edges)
    pixels, held = _pixels(head, corners, views), []
    for name, T in T_cam_target(head, views).items():
        lens = head.cameras[name].intrinsics
        straight = in_reach(lens, *np.moveaxis(transform(T[:, None], corners), -1, 0))
        low, high = MARGIN_PX, np.array(lens.size) - 1 - MARGIN_PX
        inside = ((pixels[name] > low) & (pixels[name] < high)).all(axis=-1)
        held.append((inside & straight).all(axis=1))
    return np.stack(held, axis=1)


def seen_by(head: HeadCalibration, board: Board, views: Views) -> dict[str, Array]:
    """Return by camera the pixels (V, K, 2) of the corners, in the image or not."""
    return _pixels(head, corner_points(board), views)


def _pixels(head: HeadCalibration, corners: Array, views: Views) -> dict[str, Array]:
    """Return by camera the pixels (V, K, 2) of points (K, 3) [m] in frame target."""
    points = transform(views.T_lbase_target[:, None], corners)
    T = eye_poses(head, views.joints)
    return {
        name: project_at(mounted, head.T_rbase_lbase, T[:, EYES.index(mounted.eye)], points)
        for name, mounted in head.cameras.items()
    }


def admissible_views(
    head: HeadCalibration,
    board: Board,
    limits_rad: Array,
    rng: np.random.Generator,
    *,
    places: int,
    gazes: int,
) -> Views:
    """Return random admissible views: at each of some places of the board, some directions of gaze.

    Args:
        head: with a camera in each eye.
        board: that is shown.
        limits_rad: (r,) the largest reading of each joint, to either side.
        rng: of all that is random.
        places: how many places of the board.
        gazes: how many views of each.

    Raises:
        VergenceError: the head has one eye, or the board fits into no pair of images.
    """
    pair = [list(head.cameras).index(name) for name in pair_names(head)]
    boards = _boards(head, board, limits_rad, rng, 20 * places)
    found = []
    for T in boards:
        joints = rng.uniform(-limits_rad, limits_rad, (TRIES, len(limits_rad)))
        tried = Views(np.broadcast_to(T, (TRIES, 4, 4)), joints, np.zeros(TRIES, dtype=int))
        good = joints[held_whole(head, board, tried)[:, pair].all(axis=1)][:gazes]
        if len(good) == gazes:
            found.append(Views(np.tile(T, (gazes, 1, 1)), good, np.full(gazes, len(found))))
        if len(found) == places:
            break
    if len(found) < places:
        size = f"{board.columns} x {board.rows} corners of {1e3 * board.square_m:g} mm"
        raise VergenceError(
            f"A board of {size} fits whole into the images of both eyes at {len(found)} of "
            f"{places} places; take a smaller board, or let the joints move farther."
        )
    return Views(
        np.concatenate([each.T_lbase_target for each in found]),
        np.concatenate([each.joints for each in found]),
        np.concatenate([each.placement for each in found]),
    )


def _boards(
    head: HeadCalibration, board: Board, limits_rad: Array, rng: np.random.Generator, count: int
) -> Array:
    """Return random T_lbase_target (count, 4, 4) about the axes of the left eye's main camera."""
    mounted = head.cameras[pair_names(head)[0]]
    corners = corner_points(board)
    gaze = rng.uniform(-limits_rad, limits_rad, (count, len(limits_rad)))
    T_lbase_left = T_lbase_cam(mounted, head.T_rbase_lbase, eye_poses(head, gaze)[:, 0])
    lens = mounted.intrinsics
    size = np.ptp(corners, axis=0).max()
    fills = rng.uniform(*FILLS, count)
    depth = size * lens.matrix[0, 0] / (fills * lens.width)
    # Anywhere in the image: whether it holds the whole board is tested with the other eye's.
    aside = rng.uniform(-0.5, 0.5, (count, 2)) * (1 - fills)[:, None]
    aside *= np.array(lens.size) / lens.matrix[0, 0] * depth[:, None]
    R = rotation(rng.uniform(-LEAN_RAD, LEAN_RAD, (count, 3)))
    centre = np.concatenate([aside, depth[:, None]], axis=1)
    return T_lbase_left @ pose(R, centre - (R @ corners.mean(axis=0)))


def as_seen(head: HeadCalibration, board: Board, views: Views) -> Observations:
    """Return what such a head would record of views without noise, of whole boards only."""
    held, corners, sizes = held_whole(head, board, views), {}, {}
    for c, (name, uv) in enumerate(seen_by(head, board, views).items()):
        corners[name] = np.where(held[:, c, None, None], uv, np.nan)
        lens = head.cameras[name].intrinsics
        sizes[name] = lens.size
    return Observations(
        board=board,
        placement=views.placement,
        eye_angles=views.joints,
        corners=corners,
        sizes=sizes,
        eyes={name: mounted.eye for name, mounted in head.cameras.items()},
        kinematics=head.kinematics,
    )


def T_cam_target(head: HeadCalibration, views: Views) -> dict[str, Array]:
    """Return by camera the poses (V, 4, 4) of the board in it."""
    T, found = eye_poses(head, views.joints), {}
    for name, mounted in head.cameras.items():
        own = T[:, EYES.index(mounted.eye)]
        T_lbase_own = T_lbase_cam(mounted, head.T_rbase_lbase, own)
        found[name] = inverse(T_lbase_own) @ views.T_lbase_target
    return found
