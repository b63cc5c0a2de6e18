"""Views that a capture has kept, as observations and from a dataset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.calibration.detection import described_observations, detect_target
from vergence.calibration.observations import Observations
from vergence.data.dataset import Dataset, Frame
from vergence.data.description import Description
from vergence.data.timing import Timing
from vergence.geometry.board import Board
from vergence.vision.board_pose import seen_corners


@dataclass(frozen=True, eq=False)
class Kept:
    """A view that was kept."""

    frame: Frame
    """Without images."""
    corners: Mapping[str, Array]
    """By camera that saw the board (K, 2) [px], NaN where not seen."""
    placement: int
    moving: bool = False


def kept_in(dataset: Dataset) -> tuple[Kept, ...]:
    """Find the board again in the images of a dataset; VergenceError as of `detect_target`."""
    corners, kept = detect_target(dataset).corners, []
    for row in range(len(dataset)):
        frame = Frame(
            float(dataset.time_s[row]),
            float(dataset.joint_time_s[row]),
            dataset.eye_angles[row],
            dataset.neck_angles[row],
            {},
        )
        seen = {name: c[row] for name, c in corners.items() if seen_corners(c[row]).any()}
        kept.append(Kept(frame, seen, int(dataset.placement[row]), bool(dataset.moving[row])))
    return tuple(kept)


def observations(
    description: Description, board: Board, kept: tuple[Kept, ...], *, least_views: int
) -> Observations:
    """Collect the kept views, of the cameras that saw the board at rest in some of them."""
    nothing = np.full((board.columns * board.rows, 2), np.nan)
    at_rest = [view for view in kept if not view.moving]
    corners = {
        name: np.array([view.corners.get(name, nothing) for view in kept])
        for name in description.cameras
        if sum(name in view.corners for view in at_rest) >= least_views
    }
    timing = None
    if len(at_rest) < len(kept):
        run = np.array([view.moving for view in kept], int)  # one sweep is all that moves
        timing = Timing(np.array([view.frame.joint_time_s for view in kept]), run)
    return described_observations(
        description,
        board,
        placement=np.array([view.placement for view in kept]),
        eye_angles=np.array([view.frame.eye_angles for view in kept]),
        corners=corners,
        timing=timing,
    )
