"""Number the placements of the board: frames share one as long as it stood still in the head."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from itertools import pairwise

import numpy as np

from vergence.arrays import Array
from vergence.data.description import Description
from vergence.recordings.board_motion import WRONG, number_boards
from vergence.recordings.board_views import BoardViews, board_views, eye_views
from vergence.recordings.frame_choice import ChosenFrames, seconds
from vergence.recordings.moments import Moments
from vergence.recordings.recording_map import FrameChoice
from vergence.recordings.stillness import joints_still
from vergence.vision.board_pose import LEAST_CORNERS, seen_corners

SAME_PX = 1.0
"""Root mean square distance of corners [px] in two images from which a board before an eye at rest
has moved, and below which images are alike."""
NECK_RAD = 0.01
"""Turn of a neck's joint that ends a placement [rad]: half of what a dataset allows."""
LEAVE_OUT = -1


def number_placements(
    description: Description,
    moments: Moments,
    chosen: ChosenFrames,
    corners: Mapping[str, Array],
    stated: FrameChoice | None = None,
) -> np.ndarray:
    """Number the placements (F,) of int of chosen frames, from 0; -1: to be left out.

    Left out are frames at rest in which no camera sees the board, or which show what an earlier one
    shows, and moving ones unless the board stood still. `corners` by camera are (F, K, 2) [px], NaN
    where not seen. Placements that are `stated` are taken from there.
    """
    shown = np.any(
        [seen_corners(each).sum(axis=1) >= LEAST_CORNERS for each in corners.values()], axis=0
    )
    if stated is not None and stated.placements is not None:
        return _stated(moments, chosen, shown, stated)
    return _found(description, moments, chosen, corners, shown)


def _stated(
    moments: Moments, chosen: ChosenFrames, shown: np.ndarray, stated: FrameChoice
) -> np.ndarray:
    time_s, spans = seconds(moments)[chosen.rows], stated.placements or ()
    number = np.full(len(shown), LEAVE_OUT)
    for k, (begin, end) in enumerate(spans):
        number[(shown | chosen.moving) & (time_s >= begin) & (time_s <= end)] = k
    outside = shown & ~chosen.moving & (number < 0)
    number[outside] = len(spans) + np.arange(outside.sum())
    return number


def _found(
    description: Description,
    moments: Moments,
    chosen: ChosenFrames,
    corners: Mapping[str, Array],
    shown: np.ndarray,
) -> np.ndarray:
    rest = np.flatnonzero(shown & ~chosen.moving)
    views = {
        name: board_views(description.cameras[name], description.board, each, rest)
        for name, each in corners.items()
        if np.isfinite(each[rest]).any()
    }
    number = np.full(len(shown), LEAVE_OUT)
    segment, alone = _stood(description, moments, chosen, views, rest)
    # A frame that does not agree with those around it has a number of its own.
    number[rest] = np.where(alone, segment.max(initial=0) + 1 + np.arange(len(rest)), segment)
    after = np.searchsorted(rest, np.arange(len(shown)))
    between = chosen.moving & (after > 0) & (after < len(rest))
    k = after[between]
    number[between] = np.where(segment[k - 1] == segment[k], segment[k], LEAVE_OUT)
    neck, first = moments.neck_angles[chosen.rows], np.searchsorted(segment, segment)
    for row in np.flatnonzero(between & (number >= 0)):
        begun = rest[first[after[row]]]
        if np.abs(neck[row] - neck[begun]).max(initial=0.0) > NECK_RAD:
            number[row] = LEAVE_OUT
    number[_alike(views, number, rest)] = LEAVE_OUT
    return number


def _stood(
    description: Description,
    moments: Moments,
    chosen: ChosenFrames,
    views: Mapping[str, BoardViews],
    rest: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Number the stretches (m,) of frames at rest in which the board stood still.

    Returns also which frames (m,) do not agree with those around them. Between two successive
    frames the board stood still if a camera shows it by views before and after, and none shows that
    it moved; a camera that shows it by views farther apart does not contradict one that shows when.
    """
    m = len(rest)
    stood = np.zeros(max(m - 1, 0), bool)
    wrong, agrees = np.zeros(m, bool), np.zeros(m, bool)
    moved: list[tuple[int, int]] = []
    disturbed = np.cumsum(~joints_still(moments))[chosen.rows]
    readings = moments.eye_angles if moments.T_base_eye is None else moments.T_base_eye
    for name, seen in views.items():
        if not len(seen.rows):
            continue
        turning = eye_views(
            seen,
            description.head_kinematics,
            description.cameras[name].eye,
            readings[chosen.rows[seen.rows]],
        )
        stands = partial(_stands, seen, disturbed[seen.rows])
        number, placed = number_boards(turning, stands)
        at = np.searchsorted(rest, seen.rows)
        wrong[at[number == WRONG]] = True
        agrees[at[np.isin(number, number[:-1][number[1:] == number[:-1]])]] = True
        for i, k in pairwise(np.flatnonzero(number != WRONG).tolist()):
            if number[i] == number[k]:
                stood[at[i] : at[k]] = True
            elif placed or stands(i, k) is False:
                moved.append((at[i], at[k]))
    for a, b in moved:
        if not any(a <= c and d <= b and (a, b) != (c, d) for c, d in moved):
            stood[a:b] = False
    neck = moments.neck_angles[chosen.rows[rest]]
    segment, first = np.zeros(m, int), 0
    for k in range(1, m):
        ends = not stood[k - 1] or np.abs(neck[k] - neck[first]).max(initial=0.0) > NECK_RAD
        segment[k] = segment[k - 1] + ends
        first = k if ends else first
    return segment, wrong & ~agrees


def _stands(seen: BoardViews, disturbed: np.ndarray, i: int, k: int) -> bool | None:
    """Tell whether the board stood between views i and k of an eye at rest; None: it moved.

    `disturbed` (n,) counts the moments before at which the head did not rest.
    """
    return None if disturbed[i] != disturbed[k] else _distance_px(seen, i, k) < SAME_PX


def _distance_px(seen: BoardViews, i: int, k: int) -> float:
    squares = ((seen.pixels[i] - seen.pixels[k]) ** 2).sum(axis=1)
    return float(np.sqrt(np.mean(squares)))  # NaN, which is never near, outside of the lens


def _alike(views: Mapping[str, BoardViews], number: np.ndarray, rest: np.ndarray) -> list[int]:
    """List the frames whose images all look like those of an earlier frame of the placement."""
    at = {
        name: {row: k for k, row in enumerate(seen.rows.tolist())} for name, seen in views.items()
    }
    kept: dict[int, list[int]] = {}
    alike = []
    for row in rest.tolist():
        cameras = [name for name in views if row in at[name]]
        before = kept.setdefault(int(number[row]), [])
        if cameras and any(
            all(
                other in at[name]
                and _distance_px(views[name], at[name][other], at[name][row]) < SAME_PX
                for name in cameras
            )
            for other in before
        ):
            alike.append(row)
        else:
            before.append(row)
    return alike
