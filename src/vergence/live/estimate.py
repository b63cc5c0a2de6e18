"""Calibrate the views that a capture has so far, and find those that would improve it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from vergence.accuracy.plan import Candidates, candidate_views, choose
from vergence.accuracy.plan_information import largest_std, total_information
from vergence.arrays import Array, single_blas_thread
from vergence.calibration.bundle_adjustment import bundle_adjust
from vergence.calibration.initial import calibrate_sequentially
from vergence.calibration.prepared_views import prepare
from vergence.data.description import Description
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration
from vergence.live.guide import board_of
from vergence.live.kept import Kept, observations

CANDIDATES = (24, 8)
"""Places of the board and directions of gaze at each that are tried: they take a second."""
LEAST_SEEN = 5
"""Views in which a camera has to show the board at rest: three determine its lens (Zhang), and two
more leave something to check it by."""
AHEAD = 6
"""Views by which the gain of going on is predicted."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """What the calibration of the first rows of a capture has brought."""

    rows: int
    """Number of rows that it used."""
    head: HeadCalibration | None = None
    """None: they do not suffice."""
    missing: tuple[str, ...] = ()
    """Cameras that have seen the board too seldom, which the head lacks."""
    problem: str = ""
    """Why there is no head, or no plan; empty: there are both."""
    candidates: Candidates | None = None
    """Views to choose from; None: there is no plan."""
    accuracy_m: Array = field(default_factory=lambda: np.zeros(0))
    """Largest deviation of a point by this head, and predicted with AHEAD further views (2,) [m].
    """


@single_blas_thread()
def estimate(
    description: Description,
    kept: tuple[Kept, ...],
    *,
    limits_rad: Array,
    distance_m: float,
    seed: int = 0,
) -> Estimate:
    """Calibrate by bundle adjustment, without the choice of lenses and held-out views.

    `limits_rad` (r,) are the largest readings to either side that the next views may have, and
    `distance_m` is that of the points whose accuracy counts.
    """
    board, rows = board_of(description), len(kept)
    head, missing = None, ()
    try:
        seen = observations(description, board, kept, least_views=LEAST_SEEN)
        missing = tuple(name for name in description.cameras if name not in seen.corners)
        views = prepare(seen, "bundle", "radial-tangential")
        at_rest, T_cam_target = views.at_rest
        start = calibrate_sequentially(
            at_rest, intrinsics=views.intrinsics, T_cam_target=T_cam_target
        )
        found = bundle_adjust(start.head, views.observations, T_cam_target=views.T_cam_target)
        head = replace(found.head, accuracy=found.accuracy)
        tried = candidate_views(
            head,
            board,
            limits_rad=limits_rad,
            distances_m=(distance_m,),
            seed=seed + rows,
            count=CANDIDATES,
        )
    except VergenceError as error:
        return Estimate(rows, head, missing, str(error))
    place, by = tried.views.placement, tried.by_parameters
    best = choose(tried.known, tried.information, place, by, AHEAD)
    after = tried.known + total_information(tried.information[best], place[best])
    covariances: Array = np.linalg.inv(np.array([tried.known, after])).astype(float)
    accuracy_m = largest_std(by, covariances).max(axis=1)
    return Estimate(rows, head, missing, "", tried, accuracy_m)
