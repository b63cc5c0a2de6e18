"""Which view of the board a capture needs next, and how to show it.

The first views are drawn for an assumed head. From these a calibration is made, and the next views
are chosen by their information about it (accuracy.plan).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from vergence.accuracy.plan import Candidates, design_costs, information_of
from vergence.accuracy.plan_information import largest_std, total_information
from vergence.accuracy.plan_views import (
    Views,
    admissible_views,
    joined,
    shows_whole_board,
    views_at,
)
from vergence.arrays import Array
from vergence.data.description import DatasetCamera, Description
from vergence.errors import VergenceError
from vergence.geometry.board import Board, corner_points
from vergence.geometry.camera import Camera
from vergence.geometry.head import (
    R_EYE_CAM,
    HeadCalibration,
    MountedCamera,
    base_pose,
    camera_pose_in_base,
    lenses_of,
    main_camera,
)
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import angle, inverse, pose, transform

FOCAL_PER_WIDTH = 0.7
"""Assumed focal length of the first camera of an eye, in image widths: a field of view of 71
degrees, between those of usual lenses."""
TURNED_PLACES = 8
"""Places of the board at rest that are tried; that where the eyes can turn farthest is shown."""
LONGER_FOCAL = (6.0, 4.0, 2.5)
"""Assumed focal lengths of an eye's other cameras, in that of its first, tried in turn: far boards
first, which fit into more images. The lenses of this project's head have 3 to 4.3."""
BASELINE_M = 0.1
"""Assumed distance of the eyes [m]; heads have 0.06 to 0.3."""
STRAIGHT_VIEWS, TURNED_VIEWS, OTHER_VIEWS = 8, 10, 2
"""First views: with straight gaze; of a board at rest by turned eyes; and, for a camera that is not
its eye's first, at each focal length. The paper's method starts from three of each kind."""
STAY = 0.7
"""Gain of a view for which the board stays, relative to the best one's, from which it comes first:
moving a board takes a person longer than turning eyes."""
MEAN_POWER = 1 / 8
"""Inverse power of the mean that the plan reduces (see accuracy.plan)."""
SAME_RAD = 0.02
"""Difference of readings up to which two directions of gaze count as the same [rad]: the noise of
readings, and errors of servos."""
GAZES = 12
"""Directions of gaze that are tried before a board where it stands."""


Outlines = Mapping[str, Array]
"""Corners (4, 2) [px] of a board by camera."""


@dataclass(frozen=True, eq=False)
class View:
    """A view of the board to show."""

    T_lbase_target: Array
    """(4, 4) pose of the board."""
    joints: Array
    """(r,) readings of the eyes [rad]."""
    board_stays: bool
    """Whether the board stays where it was in the view before."""


def assumed_head(description: Description) -> HeadCalibration:
    """Assume a head before anything is measured: its design, and usual lenses and mountings."""
    cameras: dict[str, MountedCamera] = {}
    for name, stated in description.cameras.items():
        first = all(mounted.eye != stated.eye for mounted in cameras.values())
        lens = _lens(stated, FOCAL_PER_WIDTH * (1.0 if first else LONGER_FOCAL[0]))
        cameras[name] = MountedCamera(stated.eye, lens, pose(R_EYE_CAM))
    T_rbase_lbase = pose(t=[0, BASELINE_M, 0])
    return HeadCalibration(cameras, T_rbase_lbase, kinematics=description.head_kinematics)


def first_views(description: Description, limits_rad: Array, *, seed: int) -> tuple[View, ...]:
    """Draw the views from which a first calibration is made, by the first camera of each eye.

    `limits_rad` (r,) are the largest readings to either side. VergenceError if the eyes cannot see
    the board whole.
    """
    head, rng = assumed_head(description), np.random.default_rng([seed, 1])
    views = _straight(head, description, limits_rad, rng, STRAIGHT_VIEWS)
    if not len(limits_rad):
        return views
    turned = admissible_views(
        head, board_of(description), limits_rad, rng, places=TURNED_PLACES, gazes=TURNED_VIEWS
    )
    places = [turned.take(turned.placement == place) for place in range(TURNED_PLACES)]
    turned = max(places, key=lambda views: float(views.joints.std(axis=0).min()))
    rows = zip(turned.T_lbase_target, turned.joints, strict=True)
    return (*views, *(View(T, joints, k > 0) for k, (T, joints) in enumerate(rows)))


def views_of_camera(
    head: HeadCalibration,
    description: Description,
    camera: str,
    limits_rad: Array,
    *,
    seed: int,
    focal_px: float | None = None,
) -> tuple[View, ...]:
    """Draw views for a camera that has shown the board too seldom.

    It is assumed where the head has the main camera of its eye. Its focal length is assumed, too,
    where none is given.
    """
    rng, views, assumed = np.random.default_rng([seed, 2]), [], assumed_head(description)
    stated, T_eye_cam = description.cameras[camera], pose(R_EYE_CAM)
    focal = [longer * FOCAL_PER_WIDTH for longer in LONGER_FOCAL]
    if any(mounted.eye == stated.eye for mounted in head.cameras.values()):
        main = head.camera(main_camera(lenses_of(head, stated.eye)))
        T_eye_cam, lens = main.T_eye_cam, main.intrinsics
        focal = [longer * float(lens.matrix[0, 0]) / lens.width for longer in LONGER_FOCAL]
    if focal_px is not None:
        focal = [focal_px / stated.width] * len(LONGER_FOCAL)
    for focal_per_width in focal:
        placed = MountedCamera(stated.eye, _lens(stated, focal_per_width), T_eye_cam)
        alone = replace(assumed, cameras={camera: placed}, T_rbase_lbase=head.T_rbase_lbase)
        views += _straight(alone, description, limits_rad, rng, OTHER_VIEWS)
    return tuple(views)


def _lens(camera: DatasetCamera, focal_per_width: float) -> Camera:
    """Look up the known lens of a camera, or assume one of a focal length [image widths]."""
    width, height, f = camera.width, camera.height, focal_per_width * camera.width
    matrix = np.array([[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1.0]])
    return camera.intrinsics or Camera(width=width, height=height, matrix=matrix)


def _straight(
    head: HeadCalibration,
    description: Description,
    limits_rad: Array,
    rng: np.random.Generator,
    count: int,
) -> tuple[View, ...]:
    """Draw views by eyes at rest at zero."""
    views = admissible_views(
        head, board_of(description), 1e-3 * limits_rad, rng, places=count, gazes=1
    )
    return tuple(View(T, 0.0 * limits_rad, False) for T in views.T_lbase_target)


def board_of(description: Description) -> Board:
    """Look up the board that is shown; VergenceError without one."""
    if description.board is None:
        raise VergenceError("A capture needs a board; the driver's description has none.")
    return description.board


@dataclass(frozen=True, eq=False)
class Outlook:
    """What the views since a calibration have added, and what one more may add."""

    candidates: Candidates
    limits_rad: Array
    """(r,) largest readings to either side."""
    taken: Views
    """K views since the calibration."""
    information: Array
    """(K, p + 6, p + 6) of these."""
    nearby: Views
    """Directions of gaze at the board where it stands now."""
    of_nearby: Array
    """Their information."""


def begin_outlook(candidates: Candidates, limits_rad: Array) -> Outlook:
    """Look out from a calibration."""
    none, size = candidates.views.take(np.s_[:0]), candidates.information.shape[1:]
    nothing = np.empty((0, *size))
    return Outlook(candidates, limits_rad, none, nothing, none, nothing)


def with_view(outlook: Outlook, T_lbase_target: Array, joints: Array, placement: int) -> Outlook:
    """Add a view that was kept; the next directions of gaze are at the board where it stands.

    A view of a part of the board adds nothing.
    """
    candidates = outlook.candidates
    head, board, scale = candidates.head, candidates.board, candidates.scale
    view = Views(T_lbase_target[None], joints[None], np.array([placement]))
    if not shows_whole_board(head, board, view).any():
        return outlook
    if not len(outlook.taken.placement) or outlook.taken.placement[-1] != placement:
        rng, limits_rad = np.random.default_rng(placement), outlook.limits_rad
        nearby = views_at(
            head, board, T_lbase_target, limits_rad, rng, gazes=GAZES, placement=placement
        )
    else:
        nearby = outlook.nearby
    near_rad = np.abs(nearby.joints - joints).max(axis=1, initial=0.0)
    nearby = nearby.take(np.flatnonzero(near_rad > SAME_RAD))  # each direction once
    N = information_of(head, board, joined(view, nearby), scale)
    return replace(
        outlook,
        taken=joined(outlook.taken, view),
        information=np.concatenate([outlook.information, N[:1]]),
        nearby=nearby,
        of_nearby=N[1:],
    )


def without_view(outlook: Outlook, view: View) -> Outlook:
    """Remove a place that was asked for in vain, and the directions of gaze at the present one."""
    candidates, views = outlook.candidates, outlook.candidates.views
    left = (views.T_lbase_target != view.T_lbase_target).any(axis=(1, 2))
    if not left.any():
        return outlook
    rows = np.flatnonzero(left)
    fewer = replace(candidates, views=views.take(rows), information=candidates.information[rows])
    return replace(
        outlook,
        candidates=fewer,
        nearby=outlook.nearby.take(np.s_[:0]),
        of_nearby=outlook.of_nearby[:0],
    )


def deviations_m(outlook: Outlook) -> Array:
    """Predict the standard deviation (W,) [m] of each point after the views that were taken."""
    candidates, known = outlook.candidates, outlook.candidates.known
    if len(outlook.information):
        known = known + total_information(outlook.information, outlook.taken.placement)
    covariance: Array = np.linalg.inv(known).astype(float)
    return largest_std(candidates.by_parameters, covariance)


def next_view(outlook: Outlook) -> tuple[View, float]:
    """Choose the next view; also predict the mean deviation [m] of the points with it.

    The mean is that of the plan, of the eighth powers: large ones count most.
    """
    candidates, taken, nearby = outlook.candidates, outlook.taken, outlook.nearby
    elsewhere = candidates.views.placement - candidates.views.placement.max() - 1  # below zero
    views = joined(taken, nearby, replace(candidates.views, placement=elsewhere))
    N = np.concatenate([outlook.information, outlook.of_nearby, candidates.information])
    place = np.unique(views.placement, return_inverse=True)[1]
    first, far = len(taken.placement), len(taken.placement) + len(nearby.placement)
    costs = design_costs(candidates.known, N, place, candidates.by_parameters, [*range(first)])
    after_m = costs**MEAN_POWER
    best = first + int(after_m[first:].argmin())
    if far > first:
        near = first + int(after_m[first:far].argmin())
        now_m = mean_deviation_m(outlook)
        if now_m - after_m[near] > STAY * (now_m - after_m[best]):
            best = near
    view = View(views.T_lbase_target[best], views.joints[best], best < far)
    return view, float(after_m[best])


def mean_deviation_m(outlook: Outlook) -> float:
    """Compute the mean deviation [m] that `next_view` reduces."""
    return float((deviations_m(outlook) ** (1 / MEAN_POWER)).mean() ** MEAN_POWER)


def outlines(head: HeadCalibration, board: Board, T_lbase_target: Array, joints: Array) -> Outlines:
    """Project the board's outer corners (4, 2) [px] into each camera; NaN behind it."""
    grid = corner_points(board).reshape(board.rows, board.columns, 3)
    corners = transform(T_lbase_target, grid[[0, 0, -1, -1], [0, -1, -1, 0]])
    return {name: project_point(head, name, joints, corners) for name in head.cameras}


def instruction(head: HeadCalibration, view: View, T_lbase_now: Array | None) -> str:
    """Describe in words how the board gets to a view, from where it is seen now."""
    if view.board_stays:
        return "leave the board where it is, and let the eyes turn"
    if T_lbase_now is None:
        x, y, z = transform(base_pose(head, "left"), view.T_lbase_target[:3, 3])
        return f"show the board {100 * x:.0f} cm ahead, {_aside(y)}, {_above(z)}"
    x, y, z = view.T_lbase_target[:3, 3] - T_lbase_now[:3, 3]
    turn = np.degrees(angle(T_lbase_now[:3, :3].T @ view.T_lbase_target[:3, :3]))
    return (
        f"move the board {abs(100 * x):.0f} cm {'away' if x > 0 else 'nearer'}, {_aside(y)}, "
        f"{_above(z)}; turn it by {turn:.0f} degrees"
    )


def _aside(y: float) -> str:
    return f"{abs(100 * y):.0f} cm to the robot's {'left' if y > 0 else 'right'}"


def _above(z: float) -> str:
    return f"{abs(100 * z):.0f} cm {'up' if z > 0 else 'down'}"


def board_in_left_base(
    head: HeadCalibration, camera: str, joints: Array, T_cam_target: Array
) -> Array:
    """Compute the pose (4, 4) in the left eye's base of a board that a camera sees."""
    T_base_target = camera_pose_in_base(head, camera, joints) @ T_cam_target
    if head.camera(camera).eye == "left":
        return T_base_target
    return inverse(head.T_rbase_lbase) @ T_base_target
