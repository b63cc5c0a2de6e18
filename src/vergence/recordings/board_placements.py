"""Number the placements of the board: frames share one as long as it stood still in the head."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vergence.arrays import Array
from vergence.data.description import Description
from vergence.recordings.board_motion import GATE, board_views, squared_distances
from vergence.recordings.frame_choice import joint_motion, seconds
from vergence.recordings.moments import Moments
from vergence.recordings.recording_map import FrameChoice
from vergence.vision.board_pose import LEAST_CORNERS, seen_corners

REACH = 10
"""Frames before one with which it is compared."""
PATIENCE = 3
"""Frames that may not agree with those before, while the next one does."""
SAME_PX = 1.0
"""Root mean square distance of corners [px] in two images from which a board before an eye at rest
has moved, and below which images are alike."""
NECK_RAD = 0.01
"""Turn of a neck's joint that ends a placement [rad]: half of what a dataset allows."""
LEAVE_OUT = -1
"""Number that marks frames to be left out."""


def number_placements(
    description: Description,
    moments: Moments,
    rows: np.ndarray,
    moving: np.ndarray,
    *,
    corners: Mapping[str, Array],
    stated: FrameChoice,
) -> np.ndarray:
    """Number the placements (F,) of int of chosen frames, from 0; -1: to be left out.

    Left out are frames at rest in which no camera sees the board, or which show what an earlier one
    shows, and moving ones unless the board stood still. `corners` by camera are (F, K, 2) [px], NaN
    where not seen. Placements that are `stated` are taken from there.
    """
    seen = [seen_corners(each).sum(axis=1) >= LEAST_CORNERS for each in corners.values()]
    rest = np.flatnonzero(np.any(seen, axis=0) & ~moving)
    number = np.full(len(rows), LEAVE_OUT)
    if stated.placements is not None:
        time_s = seconds(moments)[rows]
        number[rest] = len(stated.placements) + np.arange(len(rest))
        for k, (begin, end) in enumerate(stated.placements):
            number[(time_s >= begin) & (time_s <= end)] = k
        return number
    number[rest], alike = _placements(
        description, moments, rows[rest], {name: each[rest] for name, each in corners.items()}
    )
    after = np.searchsorted(rest, np.arange(len(number)))
    between = moving & (after > 0) & (after < len(rest))
    before, after = number[rest[after[between] - 1]], number[rest[after[between]]]
    number[between] = np.where(before == after, before, LEAVE_OUT)
    number[rest[alike]] = LEAVE_OUT
    return number


def _placements(
    description: Description,
    moments: Moments,
    rows: np.ndarray,
    corners: Mapping[str, Array],
) -> tuple[np.ndarray, np.ndarray]:
    """Number the placements (m,) of frames at rest (m,), and find which look like another.

    Each is compared with those before, by each camera that sees the board in both. Where the eye
    rested in between, its corners show whether the board moved.
    """
    m = len(rows)
    k, back = (each.ravel() for each in np.indices((m, REACH)))
    k, i = k[k > back], (k - back - 1)[k > back]
    vote, alike = np.zeros(len(k), int), np.ones(len(k), bool)
    neck = moments.neck_angles[rows]
    broken = np.abs(np.diff(neck, axis=0)).max(axis=1, initial=0.0) > NECK_RAD
    disturbed = np.cumsum(~(joint_motion(moments) <= 1).all(axis=1))[rows]
    readings = moments.eye_angles if moments.T_base_eye is None else moments.T_base_eye
    for name, found in corners.items():
        views = board_views(description, name, found, readings[rows])
        if views is None:
            continue
        at = np.full(m, -1)
        at[views.rows] = np.arange(len(views.rows))
        both = (at[i] >= 0) & (at[k] >= 0)
        a, b = at[i[both]], at[k[both]]
        apart = ((views.pixels[a] - views.pixels[b]) ** 2).sum(axis=2).mean(axis=1)
        rested, stood = disturbed[i[both]] == disturbed[k[both]], apart < SAME_PX**2
        squared = squared_distances(views, a, b)
        stands = np.where(rested, stood, squared < GATE)
        vote[both] += np.where(stands, 1, -1) * (rested | np.isfinite(squared))
        alike[at[k] >= 0] &= both[at[k] >= 0]
        alike[both] &= stood
        for first, last in np.stack([i[both], k[both]], axis=1)[rested & ~stood & (b == a + 1)]:
            broken[first:last] = True
    votes = np.zeros((m, REACH + 1), int)
    votes[k, k - i] = vote
    number = _stretches(votes, broken)
    alike &= number[i] == number[k]
    return number, np.unique(k[alike])


def _stretches(votes: np.ndarray, broken: np.ndarray) -> np.ndarray:
    """Number stretches of frames (m,) that most of those before in the stretch agree with.

    `votes` (m, REACH + 1) are positive where the board stood since the frame so far before,
    negative where it moved, and 0 where cameras do not show it, or contradict each other. It moved
    after frames that are `broken` (m - 1,). A frame that disagrees while one of the next agrees has
    a number of its own.
    """
    number, last = np.full(len(votes), -1), -1
    for first in range(len(votes)):
        if number[first] >= 0:
            continue
        last = number[first] = last + 1
        latest, unseen = first, []
        for k in range(first + 1, len(votes)):
            if broken[latest:k].any() or k > latest + PATIENCE:
                break
            members = first + np.flatnonzero(number[first:k] == last)
            members = members[members >= k - REACH]
            balance = votes[k, k - members].sum()
            if balance > 0:
                number[[*unseen, k]] = last
                latest, unseen = k, []
            elif balance == 0:
                unseen.append(k)
    return number
