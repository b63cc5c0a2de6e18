"""Choose the frames of a recording that a calibration can use: at rest, and in motion.

What counts as rest follows from the recording itself: joints and images move no more than in its
quietest part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import LEAST_MOVING, MAX_GAP_S
from vergence.recordings.moments import WINDOW_NS, Moments
from vergence.recordings.recording_map import FrameChoice, Span

QUIETEST, LOUDER = 0.1, 4.0
"""Share of all moments at which a recording is assumed to rest at least, whose quantile gives its
noise; and factor that the range of six normal readings exceeds once in a thousand times (that of
nine: 3.3, of four: 6)."""
BRIGHTER = 2.0
"""Factor up to which the noise of images differs between dark parts of a scene and bright ones."""
UNSEEN_RAD, NOISIEST_RAD = 6e-4, 0.042
"""Range of a reading within a window [rad], or of a position [m], that moves an image little (by
0.3 px at a focal length of 500 px); and largest one by noise, that of servos with 0.4 degrees."""
STILL_PX = 0.3
"""Motion of images within scan.LAG_NS [px] that does not matter: at 1.5 px/s none is blurred, and a
hand holds a board still."""
JITTER = 1.1
"""Factor on periods for stamps that vary, as those of USB cameras do."""
MOST_MOVING = 300
"""Most moving frames: ten seconds at 30 Hz, by which an offset is known to a millisecond."""
FASTEST_RAD_S = 1.0
"""Speed [rad/s] from which images count as blurred: by 4 px in 10 ms, at a focal length of 400 px.
"""


def choose_frames(moments: Moments, stated: FrameChoice) -> tuple[np.ndarray, np.ndarray]:
    """Choose one frame of each stretch at rest, and stretches in which the eyes move.

    Returns which moments (F,), in order of time, and whether the eyes moved (F,). What `stated` has
    is taken from there. Moments without all readings are left out.
    """
    known, alone = moments.known, _alone(moments)
    joints, images = joint_motion(moments), image_motion(moments)
    if stated.rest is not None:
        at_rest = _spans(moments, stated.rest)
    else:
        still = known & (joints <= 1).all(axis=1)
        single = list(np.flatnonzero(still & alone)[:, None])  # images that were taken on purpose
        at_rest = [*single, *_runs(still & ~alone & (images <= 1).all(axis=1))]
    unrest = np.nansum(np.concatenate([joints, images], axis=1), axis=1)
    rest = [row for rows in at_rest for row in _stillest(moments, rows[known[rows]], unrest)]
    if stated.moving is None:
        turns = joints > 1
        eyes = turns.shape[1] - moments.neck_angles.shape[1]
        moving = _motions(
            moments, known & ~alone & turns[:, :eyes].any(axis=1) & ~turns[:, eyes:].any(axis=1)
        )
    else:
        moving = np.concatenate([np.zeros(0, int), *_spans(moments, stated.moving)])
        moving = np.unique(moving[known[moving]])
    rows = np.union1d(np.array(rest, int), moving)
    return rows, np.isin(rows, moving)


def join_at_rest(moments: Moments) -> Moments:
    """Join moments of cameras that are not synchronised where the joints are at rest.

    Images of one moment are then up to half a period of the images apart.
    """
    time_ns, images = moments.time_ns, {name: each.copy() for name, each in moments.images.items()}
    change = {name: each.copy() for name, each in moments.change.items()}
    periods = [np.diff(time_ns[rows >= 0]) for rows in images.values()]
    reach_ns = 0.5 * JITTER * min(float(np.median(each)) if len(each) else 0.0 for each in periods)
    still = np.asarray((joint_motion(moments) <= 1).all(axis=1))
    kept, first = np.ones(len(moments), bool), 0
    for k in range(1, len(moments)):
        near = time_ns[k] - time_ns[first] <= reach_ns and still[first : k + 1].all()
        if not near or any(rows[first] >= 0 and rows[k] >= 0 for rows in images.values()):
            first = k
            continue
        for name, rows in images.items():
            if rows[k] >= 0:
                rows[first], change[name][first] = rows[k], change[name][k]
        kept[k] = False
    return replace(moments, images=images, change=change).take(kept)


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


def _stillest(moments: Moments, rows: np.ndarray, unrest: Array) -> np.ndarray:
    """Choose the stillest moment (1,) of a stretch (n,), of those with images of most cameras.

    It lies in the middle half, since motions begin and end slowly; (0,) of an empty stretch.
    """
    rows = rows[len(rows) // 4 : len(rows) - len(rows) // 4]
    shown = np.sum([image[rows] >= 0 for image in moments.images.values()], axis=0)
    return rows[np.lexsort([unrest[rows], -shown])[:1]]


def _motions(moments: Moments, moves: np.ndarray) -> np.ndarray:
    """Choose moments (m,) of the motions from which a time offset can be seen best.

    A constant speed looks like an offset of the joints: what counts is how much it varies.
    """
    time_s, eyes = seconds(moments), -moments.neck_angles.shape[1] or None
    readings = moments.elements[:, :eyes]
    pieces: list[tuple[float, np.ndarray]] = []
    for run in _runs(moves):
        for piece in np.split(run, np.flatnonzero(np.diff(time_s[run]) > MAX_GAP_S) + 1):
            if len(piece) >= LEAST_MOVING:
                speed = np.gradient(readings[piece], time_s[piece], axis=0)
                varies = ((speed - speed.mean(axis=0)) ** 2).sum(axis=1)
                sharp = np.abs(speed).max(axis=1) < FASTEST_RAD_S
                pieces.append((float(varies[sharp].sum()), piece))
    pieces.sort(key=lambda each: -each[0])
    return np.sort(
        np.concatenate([np.zeros(0, int), *(piece for _, piece in pieces)])[:MOST_MOVING]
    )


def joint_motion(moments: Moments) -> Array:
    """Compute the range of each reading around each moment (N, s), relative to that of noise.

    Eyes come first, then the neck's joints. NaN near moments without a reading.
    """
    ranges = np.fmax.reduce(moments.around) - np.fmin.reduce(moments.around)
    s = ranges.shape[1] - moments.neck_angles.shape[1]
    if moments.T_base_eye is not None:  # the noise of a turn may lie along any axis
        of_poses = ranges[:, :s].reshape(-1, 2, 3, 4)
        turns = np.linalg.norm(of_poses[..., :3], axis=(2, 3)) / np.sqrt(2)
        shifts = np.linalg.norm(of_poses[..., 3], axis=2)
        ranges = np.concatenate([turns, shifts, ranges[:, s:]], axis=1)
    noise = np.minimum(LOUDER * np.nanquantile(ranges, QUIETEST, axis=0), NOISIEST_RAD)
    return ranges / np.hypot(noise, UNSEEN_RAD)


def image_motion(moments: Moments) -> Array:
    """Compute the motion of each camera's images around each moment (N, c), relative to noise."""
    change = np.nan_to_num(np.stack([*moments.change.values()], axis=1))
    stream = ~_alone(moments)
    if not stream.any():
        return np.zeros_like(change)
    # A change is that of the time before its image: those of the window end after its middle.
    after = np.searchsorted(moments.time_ns, moments.time_ns + WINDOW_NS) + 1
    ends = np.stack([np.arange(len(after)), np.minimum(after, len(after))], axis=1).ravel()
    motion = np.maximum.reduceat(np.concatenate([change, change[-1:]]), ends, axis=0)[::2]
    return motion / np.hypot(BRIGHTER * np.quantile(motion[stream], QUIETEST, axis=0), STILL_PX)


def _alone(moments: Moments) -> np.ndarray:
    """Find the moments (N,) that are farther than WINDOW_NS from those before and after."""
    far = np.diff(moments.time_ns) > WINDOW_NS
    return np.concatenate([[True], far]) & np.concatenate([far, [True]])
