"""Choose the frames of a recording that a calibration can use: at rest, and in motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import LEAST_MOVING, MAX_GAP_S
from vergence.recordings.moments import Moments
from vergence.recordings.recording_map import FrameChoice, Span
from vergence.recordings.stillness import WINDOW_NS, eye_readings, image_motion, joint_motion

MOST_MOVING = 300
"""Most moving frames: ten seconds at 30 Hz, by which an offset is known to a millisecond."""
PIECE_S = 2.0
"""Longest motion that is taken or left as a whole [s]."""
FASTEST_RAD_S = 1.0
"""Speed [rad/s] from which images count as blurred: by 4 px in 10 ms, at a focal length of 400 px.
"""


@dataclass(frozen=True, eq=False)
class ChosenFrames:
    """F frames of a recording, in order of time."""

    rows: np.ndarray
    """(F,) of int: which moments."""
    moving: np.ndarray
    """(F,) of bool: whether the eyes moved."""


def choose_frames(moments: Moments, stated: FrameChoice) -> ChosenFrames:
    """Choose one frame of each stretch at rest, and stretches in which the eyes move.

    What `stated` has is taken from there. Moments without all readings are left out.
    """
    known, joints, images = moments.known, joint_motion(moments), image_motion(moments)
    if stated.rest is not None:
        at_rest = _spans(moments, stated.rest)
    elif np.median(np.diff(moments.time_ns, prepend=0)) > WINDOW_NS:
        at_rest = list(np.arange(len(moments))[:, None])  # each image was taken on purpose
    else:
        still = (joints <= 1).all(axis=1) & (np.nan_to_num(images) <= 1).all(axis=1)
        at_rest = _runs(known & still)
    unrest = np.nansum(np.concatenate([joints, images], axis=1), axis=1)
    rest = [row for rows in at_rest for row in _stillest(moments, rows[known[rows]], unrest)]
    if stated.moving is None:
        turns = joints > 1
        eyes = turns.shape[1] - moments.neck_angles.shape[1]
        moving = _motions(
            moments, known & turns[:, :eyes].any(axis=1) & ~turns[:, eyes:].any(axis=1)
        )
    else:
        moving = np.concatenate([np.zeros(0, int), *_spans(moments, stated.moving)])
        moving = np.unique(moving[known[moving]])
    rows = np.union1d(np.array(rest, int), moving)
    return ChosenFrames(rows, np.isin(rows, moving))


def seconds(moments: Moments) -> Array:
    """Compute the times (N,) [s] since the first image."""
    return (moments.time_ns - moments.time_ns[0]) * 1e-9


def _spans(moments: Moments, spans: Sequence[Span]) -> list[np.ndarray]:
    time_s = seconds(moments)
    return [np.flatnonzero((time_s >= begin) & (time_s <= end)) for begin, end in spans]


def _runs(wanted: np.ndarray) -> list[np.ndarray]:
    """List the indices of each run of moments (N,) that are wanted."""
    rows = np.flatnonzero(wanted)
    return np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if len(rows) else []


def _stillest(moments: Moments, rows: np.ndarray, unrest: Array) -> list[int]:
    """Choose the stillest moment of a stretch, one with images of all cameras if there is one.

    It lies in the middle half, since motions begin and end slowly. Where cameras take turns, each
    has its own.
    """
    rows = rows[len(rows) // 4 : len(rows) - len(rows) // 4]
    shown = np.stack([image[rows] >= 0 for image in moments.images.values()], axis=1)
    chosen: list[int] = []
    missing = shown.any(axis=0)
    while missing.any():
        best = np.lexsort([unrest[rows], -(shown & missing).sum(axis=1)])[0]
        chosen.append(int(rows[best]))
        missing &= ~shown[best]
    return chosen


def _motions(moments: Moments, moves: np.ndarray) -> np.ndarray:
    """Choose moments (m,) of the motions from which a time offset can be seen best.

    A constant speed looks like an offset of the joints: what counts is how much it varies.
    """
    time_s, readings = seconds(moments), eye_readings(moments)
    scored: list[tuple[float, np.ndarray]] = []
    for run in _runs(moves):
        late = np.flatnonzero(np.diff(time_s[run]) > MAX_GAP_S) + 1
        long = np.searchsorted(time_s[run], np.arange(time_s[run[0]], time_s[run[-1]], PIECE_S))
        for piece in np.split(run, np.union1d(late, long[1:])):
            if len(piece) >= LEAST_MOVING:
                speed = np.gradient(readings[piece], time_s[piece], axis=0)
                varies = ((speed - speed.mean(axis=0)) ** 2).sum(axis=1)
                blurred = np.abs(speed).max(axis=1) > FASTEST_RAD_S
                scored.append((float(varies[~blurred].sum()), piece))
    scored.sort(key=lambda each: -each[0])
    taken = np.cumsum([len(piece) for _, piece in scored]) <= MOST_MOVING
    kept = [piece for (_, piece), take in zip(scored, taken, strict=True) if take]
    return np.sort(np.concatenate([np.zeros(0, int), *kept]))
