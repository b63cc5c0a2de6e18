"""Plan the next best views: places of the board and readings of the eyes to record next.

Views are added one by one to the information of a calibration, each the one that makes the points
of the workspace most accurate. Then each is exchanged for a better one (Fedorov 1972). The design
is nearly G-optimal: it minimises the largest standard deviation of a point over the workspace.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from vergence.accuracy.plan_information import (
    WorkspacePoints,
    largest_std,
    marginalise_place,
    scaled_information,
    total_information,
    view_information,
    workspace,
)
from vergence.accuracy.plan_views import Views, admissible_views
from vergence.arrays import Array
from vergence.calibration.calibrate import calibrate
from vergence.calibration.summary import DISTANCES_M
from vergence.data.description import MAX_SQUARE_M
from vergence.data.reader import load_dataset
from vergence.errors import VergenceError, check_seed
from vergence.geometry.board import Board, Chessboard
from vergence.geometry.head import HeadCalibration, load_head, pair_names, pixel_stds, reading_stds
from vergence.geometry.kinematics import Kinematics, check_moves
from vergence.progress import Progress, silent

LIMIT_RAD = float(np.radians(20.0))
"""Maximum turn of a joint [rad]; beyond, a board is hard to hold."""
CANDIDATES = (40, 12)
"""Places of the board that are tried, and directions of gaze at each."""
FARTHEST_STD = 1 / 3
"""Largest standard deviation of a point, in distances: beyond, three of them reach from the eyes
to infinity, and no covariance describes a located point."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Views to record next, and the accuracy that they are predicted to bring."""

    head: HeadCalibration
    """The calibration to improve."""
    board: Board
    views: Views
    """N views, ordered by their place."""
    before_m: Array
    """(W,) standard deviation of each point in its worst direction, by the calibration alone."""
    after_m: Array
    """(W,) the same after the views."""
    steps_m: Array
    """(N,) the largest standard deviation after the first, first two, ... of the views."""
    workspace: WorkspacePoints


def plan(
    head: HeadCalibration,
    board: Board,
    *,
    views: int = 10,
    limits_rad: ArrayLike = LIMIT_RAD,
    distances_m: tuple[float, ...] = DISTANCES_M,
    seed: int = 0,
    progress: Progress = silent,
) -> Plan:
    """Choose the views that make points of the workspace most accurate.

    Args:
        head: a calibration that states its covariance.
        board: to show.
        views: number of views to plan.
        limits_rad: to either side, one number: the maximum turn of each joint; or (r,) the largest
            value of each reading, which differs before a gear.
        distances_m: of the points from the middle of the head.
        seed: of the random candidates.
        progress: see vergence.progress.

    Raises:
        VergenceError: no covariance is stated, the head has one eye, no board can be seen, the
            workspace is out of the eyes' reach, points are too far away to be located, or more
            views than candidates are asked for.
    """
    check_seed(seed)
    places, gazes = CANDIDATES
    if not 1 <= views <= places * gazes:
        raise VergenceError(
            f"A plan has one view or more, of the {places} places of the board x {gazes} "
            f"directions of gaze that are tried; found {views}."
        )
    progress("choosing views", 0, views)  # candidates of a large board take a while
    tried = candidate_views(head, board, limits_rad=limits_rad, distances_m=distances_m, seed=seed)
    known, N, by_scaled = tried.known, tried.information, tried.by_parameters
    placement = tried.views.placement
    chosen = choose(known, N, placement, by_scaled, views, progress)
    chosen = chosen[np.argsort(placement[chosen], kind="stable")]
    taken = tried.views.take(chosen)
    steps = [
        known + total_information(N[chosen[: k + 1]], taken.placement[: k + 1])
        for k in range(views)
    ]
    covariances: Array = np.linalg.inv(np.array([known, *steps])).astype(float)
    std = largest_std(by_scaled, covariances)
    distance = np.linalg.norm(tried.workspace.points, axis=1)
    if (std[-1] > FARTHEST_STD * distance).any():
        k = int((std[-1] / distance).argmax())
        reach = FARTHEST_STD * distance[k] ** 2 / std[-1][k]  # the deviation grows by the square
        raise VergenceError(
            f"Points at {distance[k]:.3g} m are out of reach: {views} views leave a standard "
            f"deviation of {std[-1][k]:.3g} m; name distances up to about {reach:.1g} m, or more "
            "views."
        )
    return Plan(head, board, taken, std[0], std[-1], std[1:].max(axis=1), tried.workspace)


@dataclass(frozen=True, eq=False)
class Candidates:
    """Views that may be recorded next, and the information of each. Parameters p are scaled."""

    head: HeadCalibration
    board: Board
    scale: Array
    """(p,) standard deviations of the head's parameters, their units."""
    known: Array
    """(p, p) information of the calibration."""
    views: Views
    information: Array
    """(V, p + 6, p + 6) of each view about the parameters and the board's place."""
    workspace: WorkspacePoints
    by_parameters: Array
    """(W, 3, p) derivatives of the workspace's points."""


def candidate_views(
    head: HeadCalibration,
    board: Board,
    *,
    limits_rad: ArrayLike = LIMIT_RAD,
    distances_m: tuple[float, ...] = DISTANCES_M,
    seed: int = 0,
    count: tuple[int, int] = CANDIDATES,
) -> Candidates:
    """Draw places of the board, and directions of gaze at each; arguments and errors as `plan`."""
    check_moves(head.kinematics, "A plan of views")
    if not distances_m or not min(distances_m) > 0:
        raise VergenceError(f"Distances of points are above 0 m, found {distances_m}.")
    scale, known = scaled_information(head)
    names = head.accuracy.parameters if head.accuracy else ()
    limits = largest_readings(head.kinematics, limits_rad)
    points = workspace(head, pair_names(head), limits, names=names, distances_m=distances_m)
    rng = np.random.default_rng(seed)
    views = admissible_views(head, board, limits, rng, places=count[0], gazes=count[1])
    N = information_of(head, board, views, scale)
    return Candidates(head, board, scale, known, views, N, points, points.by_parameters * scale)


def information_of(head: HeadCalibration, board: Board, views: Views, scale: Array) -> Array:
    """Compute the information (V, p + 6, p + 6) of views about a head, as in `Candidates`."""
    pixel_px = float(np.sqrt(np.mean(pixel_stds(head, None) ** 2)))
    (N,) = view_information(
        head,
        board,
        views,
        head.accuracy.parameters if head.accuracy else (),
        scale=scale,
        pixel_std_px=pixel_px or 1e-3,  # for a calibration that states no noise
        joint_stds=reading_stds(head)[None],
    )
    return N


def largest_readings(kinematics: Kinematics, limits_rad: ArrayLike) -> Array:
    """Convert the limits of `plan` to the largest readings (r,) [rad].

    Raises VergenceError unless there is one limit above 0 for each reading, or one for all.
    """
    names, limits = kinematics.readings, np.asarray(limits_rad, dtype=float)
    if limits.shape not in ((), (len(names),)) or not ((limits > 0) & (limits < np.inf)).all():
        raise VergenceError(
            f"Limits are one for each of {', '.join(names)}, or one for all, above 0; found "
            f"{np.degrees(limits)} degrees."
        )
    return limits if limits.ndim else limits / kinematics.gear_ratios


def choose(
    before: Array,
    of_views: Array,
    place: np.ndarray,
    by_parameters: Array,
    count: int,
    progress: Progress = silent,
) -> np.ndarray:
    """Select views (count,) one by one, then exchange each for a better one.

    `before` (p, p) is the information about the head without them, `of_views` (V, p + 6, p + 6)
    that of the candidates, `place` (V,) the number of each one's place, and `by_parameters`
    (W, 3, p) are derivatives of the points.
    """
    task, total = "choosing views", 3 * count  # two rounds of exchanges; more gain nothing
    chosen: list[int] = []
    progress(task, 0, total)
    for done in range(total):
        leaves = chosen.pop(0) if done >= count else -1  # the oldest is exchanged next
        costs = design_costs(before, of_views, place, by_parameters, chosen)
        costs[chosen] = np.inf
        best = int(costs.argmin())
        stays = leaves >= 0 and costs[leaves] <= costs[best] * (1 + 1e-9)
        chosen.append(leaves if stays else best)
        progress(task, done + 1, total)
    return np.array(chosen)


def design_costs(
    before: Array, of_views: Array, place: np.ndarray, by_parameters: Array, chosen: list[int]
) -> Array:
    """Compute the cost (V,) of the chosen views with each candidate added."""
    at_place = np.zeros((place.max() + 1, *of_views.shape[1:]))
    np.add.at(at_place, place[chosen], of_views[chosen])
    used = np.unique(place[chosen])
    of_places = np.zeros((len(at_place), *before.shape))
    of_places[used] = marginalise_place(at_place[used]) if len(used) else 0.0
    rest = before + of_places.sum(axis=0) - of_places
    together = rest[place] + marginalise_place(at_place[place] + of_views)
    std = largest_std(by_parameters, np.linalg.inv(together))
    return (std**8).mean(axis=-1)  # their maximum would rate most views as useless


def head_and_board(
    source: Path,
    board: tuple[int, int, float] | None,
    limits_rad: ArrayLike,
    progress: Progress,
) -> tuple[HeadCalibration, Board]:
    """Load the calibration of a file, or calibrate a dataset, and find the board to show.

    VergenceError if the source is neither, its calibration is void, or nothing can be planned.
    """
    shown = None
    if board is not None:
        columns, rows, square_m = board
        if min(columns, rows) < 3 or max(columns, rows) > 100 or not 0 < square_m <= MAX_SQUARE_M:
            raise VergenceError(
                "--board takes 3 to 100 inner corners each way and the side of a square up to 1 m, "
                f"found {columns} {rows} {square_m:g}."
            )
        shown = Chessboard(columns, rows, square_m)
    if os.path.isdir(source):
        data = load_dataset(source)
        largest_readings(data.description.head_kinematics, limits_rad)
        found = calibrate(data, progress=progress)
        if found.accuracy.void:
            raise VergenceError(f"The calibration from {source} is VOID: {found.accuracy.void[0]}")
        return found.head, shown or data.board
    head = load_head(source)
    if shown is None:
        raise VergenceError(
            f"{source} does not say which board will be shown; say it with --board COLUMNS ROWS "
            "SQUARE_M, such as --board 9 6 0.03, or name the folder of the dataset."
        )
    return head, shown
