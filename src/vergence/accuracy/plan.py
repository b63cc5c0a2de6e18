"""The next best views: which places of the board and which eye angles to record next.

From what a calibration knows already, views are chosen one by one, each so that the points of the
workspace become as accurate as one more view can make them; then each is exchanged for a better
one, as long as there is any (Fedorov's exchange). What is to become small is the largest standard
deviation of a point, over the workspace and over directions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from vergence.accuracy.plan_information import (
    gained,
    information,
    known_of,
    linearised_views,
    without_place,
)
from vergence.accuracy.plan_views import Views, admissible_views
from vergence.accuracy.plan_workspace import WorkspacePoints, largest_std, workspace
from vergence.arrays import Array
from vergence.calibration.summary import DISTANCES_M
from vergence.errors import VergenceError
from vergence.geometry.board import Board
from vergence.geometry.head import HeadCalibration, pair_names, pixel_stds, reading_stds
from vergence.geometry.kinematics import Kinematics
from vergence.progress import Progress, silent

LIMIT_RAD = float(np.radians(20.0))
"""Largest turn of a joint. Many heads can do more; boards are then hard to hold."""
PLACES, GAZES = 40, 12
"""Candidates: places of the board, and directions of gaze at each."""
LEAST_PX = 1e-3
"""Noise of corners [px] where a calibration states none."""
POWER = 8
"""Views are chosen by a mean of this power over the points' standard deviations, which their
largest dominates; of the largest alone most views would seem to be of no use."""
EXCHANGES = 2
"""Rounds of exchanges; more have changed nothing worth the time."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Views to record next, and what they bring."""

    head: HeadCalibration
    """The calibration that they are to improve."""
    board: Board
    views: Views
    """N of them, ordered by their place."""
    before_m: Array
    """(W,) standard deviation of each point in its worst direction, by the calibration alone."""
    after_m: Array
    """(W,) the same once the views are recorded: what is predicted."""
    steps_m: Array
    """(N,) the largest of these after the first, first two, ... of the views."""
    workspace: WorkspacePoints
    covariance: Array
    """(p, p) of the head's estimated parameters after the views."""


def plan(
    head: HeadCalibration,
    board: Board,
    *,
    views: int = 10,
    limits_rad: ArrayLike = LIMIT_RAD,
    distances_m: tuple[float, ...] = DISTANCES_M,
    candidates: tuple[int, int] = (PLACES, GAZES),
    seed: int = 0,
    progress: Progress = silent,
) -> Plan:
    """Return the views that make points of the workspace most accurate.

    Args:
        head: a calibration that states its covariance.
        board: that will be shown.
        views: how many to plan.
        limits_rad: to either side, one number: how far each reading may turn its joint; or (r,) the
            largest value of each reading, which differs before a gear.
        distances_m: of the points from the middle of the head.
        candidates: how many places of the board are tried, and directions of gaze at each.
        seed: of the candidates, which are random.
        progress: see vergence.progress.

    Raises:
        VergenceError: no covariance is stated, the head has one eye, no board can be seen, the
            workspace is out of the eyes' reach, or fewer views than wanted are candidates.
    """
    places, gazes = candidates
    if not 1 <= views <= places * gazes:
        raise VergenceError(
            f"A plan has one view or more, of the {places} places of the board x {gazes} "
            f"directions of gaze that are tried; found {views}."
        )
    known = known_of(head)
    pair = pair_names(head)
    limits = largest_readings(head.kinematics, limits_rad)
    progress("choosing views", 0, views)  # candidates of a large board take a while
    points = workspace(head, pair, limits, names=known.names, distances_m=distances_m)
    rng = np.random.default_rng(seed)
    tried = admissible_views(head, board, limits, rng, places=places, gazes=gazes)
    if len(tried.placement) < views:
        raise VergenceError(
            f"In {len(tried.placement)} of the candidates the board is seen, fewer than the "
            f"{views} views to plan: try more candidates."
        )
    linear = linearised_views(head, board, tried, known.names, known.scale)
    of_pair = float(np.sqrt(np.mean(pixel_stds(head, None) ** 2)))
    N = information(linear, of_pair or LEAST_PX, reading_stds(head))
    by_scaled = points.by_parameters * known.scale
    chosen = choose(known.information, N, tried.placement, by_scaled, views, progress)
    chosen = chosen[np.argsort(tried.placement[chosen], kind="stable")]
    taken = tried.take(chosen)
    steps = [
        known.information + gained(N[chosen[: k + 1]], taken.placement[: k + 1])
        for k in range(views)
    ]
    covariances: Array = np.linalg.inv(np.array([known.information, *steps])).astype(float)
    std = largest_std(by_scaled, covariances)
    unit = np.outer(known.scale, known.scale)
    return Plan(
        head, board, taken, std[0], std[-1], std[1:].max(axis=1), points, covariances[-1] * unit
    )


def largest_readings(kinematics: Kinematics, limits_rad: ArrayLike) -> Array:
    """Return the largest readings (r,) [rad] within limits, which are those of `plan`.

    VergenceError if these are not one for each of the readings, or for all.
    """
    names, limits = kinematics.readings, np.asarray(limits_rad, dtype=float)
    if limits.ndim == 0:
        return limits / kinematics.factors
    if limits.shape != (len(names),):
        raise VergenceError(
            f"Limits are one for each of {', '.join(names)}, or one for all; found {limits.size}."
        )
    return limits


def choose(
    before: Array,
    of_views: Array,
    place: np.ndarray,
    by_parameters: Array,
    count: int,
    progress: Progress = silent,
) -> np.ndarray:
    """Return which views (count,) to take: one by one, then exchanged for better ones.

    Args:
        before: (p, p) information on the head that there is.
        of_views: (V, p + 6, p + 6) information of the candidates.
        place: (V,) of the board.
        by_parameters: (W, 3, p) of the points, in the same units.
        count: how many views to take, each once.
        progress: see vergence.progress.
    """
    task, total = "choosing views", count * (1 + EXCHANGES)
    chosen: list[int] = []
    progress(task, 0, total)
    for done in range(total):
        leaves = chosen.pop(0) if done >= count else -1  # the oldest is exchanged next
        costs = _costs(before, of_views, place, by_parameters, chosen)
        costs[chosen] = np.inf
        best = int(costs.argmin())
        stays = leaves >= 0 and costs[leaves] <= costs[best] * (1 + 1e-9)
        chosen.append(leaves if stays else best)
        progress(task, done + 1, total)
    return np.array(chosen)


def _costs(
    before: Array, of_views: Array, place: np.ndarray, by_parameters: Array, chosen: list[int]
) -> Array:
    """Return (V,) how inaccurate points are once each candidate is added to the chosen views."""
    at_place = np.zeros((place.max() + 1, *of_views.shape[1:]))
    np.add.at(at_place, place[chosen], of_views[chosen])
    used = np.unique(place[chosen])
    of_places = np.zeros((len(at_place), *before.shape))
    of_places[used] = without_place(at_place[used]) if len(used) else 0.0
    rest = before + of_places.sum(axis=0) - of_places
    together = rest[place] + without_place(at_place[place] + of_views)
    std = largest_std(by_parameters, np.linalg.inv(together))
    return (std**POWER).mean(axis=-1)
