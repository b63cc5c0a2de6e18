"""Sessions in which a person moves a board before a head that rests and turns at will.

The truth of tests and benchmarks of recordings: joints and board as functions of time, and what
was found of the frames at rest and of the placements, held against them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from simulated_recording import facing, inside_image
from vergence.arrays import Array
from vergence.geometry.board import Board, corner_points
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import readings_to_turn
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import boxminus, boxplus, transform

Motion = tuple[float, float, Array]
"""Begin and end [s], and what is reached: readings (r,), or the board's pose (4, 4)."""


@dataclass(frozen=True, eq=False)
class Session:
    """What happens from 0 to `end_s`."""

    joints: Array
    """(r,) readings without errors at the beginning [rad]."""
    T_lbase_target: Array
    """(4, 4) at the beginning."""
    gaze: Sequence[Motion]
    """Motions of the eyes."""
    hand: Sequence[Motion]
    """Motions of the board."""
    end_s: float

    def joints_at(self, time_s: float) -> Array:
        """Return the true readings (r,) [rad] at a time."""
        value = self.joints
        for begin, end, goal in self.gaze:
            value = value + _part(time_s, begin, end) * (goal - value)
        return value

    def board_at(self, time_s: float) -> Array:
        """Return T_lbase_target (4, 4) at a time."""
        T = self.T_lbase_target
        for begin, end, goal in self.hand:
            if time_s >= end:
                T = goal
            elif time_s > begin:
                T = boxplus(T, _part(time_s, begin, end) * boxminus(goal, T))
        return T

    def placement_at(self, time_s: float) -> int:
        """Return how often the board was moved before a time; -1 while it is moved."""
        if any(begin < time_s < end for begin, end, _ in self.hand):
            return -1
        return sum(time_s >= end for _, end, _ in self.hand)

    def rests(self) -> list[tuple[float, float]]:
        """List begin and end [s] of the stretches in which eyes and board stand still."""
        motions = sorted((begin, end) for begin, end, _ in [*self.gaze, *self.hand])
        found, last = [], 0.0
        for begin, end in [*motions, (self.end_s, self.end_s)]:
            if begin > last:
                found.append((last, begin))
            last = max(last, end)
        return found


def _part(time_s: float, begin: float, end: float) -> float:
    """Return the part of a motion of least jerk that is over."""
    s = min(max((time_s - begin) / (end - begin), 0.0), 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2)


def random_session(
    head: HeadCalibration,
    board: Board,
    rng: np.random.Generator,
    *,
    moves: int,
    rests: int,
    nudge: float = 0.3,
) -> Session:
    """Draw a session with `rests` directions of the eyes, in which the board is moved some times.

    A part `nudge` of the moves is of one to three centimetres only, before eyes at rest. Other
    moves begin at any time, and the eyes may turn meanwhile.
    """
    points = corner_points(board)
    straight = np.zeros(len(head.kinematics.readings))
    T = first_T = _visible_board(head, points, rng, straight)
    joints = first = _visible_gaze(head, points, rng, T)
    gaze: list[Motion] = []
    hand: list[Motion] = []
    at_move = set(rng.choice(np.arange(2, rests - 2), moves, replace=False).tolist())
    time_s, free_s = rng.uniform(0.8, 1.5), 0.0
    for k in range(rests):
        if k in at_move:
            small = rng.random() < nudge
            if small:
                away = rng.normal(size=3)
                step = rng.uniform(0.01, 0.03) * away / np.linalg.norm(away)
                T = boxplus(T, np.concatenate([rng.normal(0, 0.05, 3), step]))
            else:
                T = _visible_board(head, points, rng, straight)
            begin = max(time_s, free_s) + rng.uniform(0.0, 0.6)
            free_s = begin + rng.uniform(0.8, 2.0)
            hand.append((begin, free_s, T))
            time_s = free_s + rng.uniform(0.6, 1.0) if small or rng.random() < 0.5 else time_s
        joints = _visible_gaze(head, points, rng, T)
        took = rng.uniform(0.3, 1.0)
        gaze.append((time_s, time_s + took, joints))
        time_s += took + rng.uniform(0.6, 1.3)
    return Session(first, first_T, gaze, hand, max(time_s, free_s) + 0.8)


def _seen(head: HeadCalibration, name: str, joints: Array, points: Array) -> bool:
    pixels = project_point(head, name, joints, points)
    return bool(inside_image(pixels, head.cameras[name].intrinsics).all())


def _visible_board(
    head: HeadCalibration, points: Array, rng: np.random.Generator, joints: Array
) -> Array:
    names = [name for name in head.cameras if not name.endswith("narrow")]
    for _ in range(10_000):
        distance = rng.uniform(0.35, 0.7)
        centre = distance * np.array([1.0, *rng.uniform(-0.35, 0.35, 2)]) - [0, 0.035, 0]
        T = facing(centre, rng.uniform(-0.6, 0.6, 3) * [1, 1, 0.5])
        if all(_seen(head, name, joints, transform(T, points)) for name in names):
            return T
    raise AssertionError("the board fits into no image")


def _visible_gaze(
    head: HeadCalibration, points: Array, rng: np.random.Generator, T: Array
) -> Array:
    """Draw readings at which all wide cameras see the board, or one in one case of seven."""
    names = [name for name in head.cameras if not name.endswith("narrow")]
    most = len(names) if rng.random() < 0.85 else 1
    ratios = head.kinematics.gear_ratios
    for _ in range(10_000):
        turn = np.array([0.0, rng.uniform(-0.3, 0.3), rng.uniform(-0.35, 0.35)])
        joints = readings_to_turn(head.kinematics, turn)
        joints = joints + rng.uniform(-0.04, 0.04, len(joints)) / ratios
        if sum(_seen(head, name, joints, transform(T, points)) for name in names) >= most:
            return joints
    raise AssertionError("no gaze shows the board")


@dataclass(frozen=True)
class Mistakes:
    """What is wrong in the frames that were chosen of a session, one sentence each."""

    rest: tuple[str, ...]
    placements: tuple[str, ...]

    def __bool__(self) -> bool:
        return bool(self.rest or self.placements)


def mistakes(
    session: Session,
    time_s: Array,
    *,
    moving: np.ndarray,
    number: np.ndarray,
    sees: Callable[[float], bool],
) -> Mistakes:
    """Hold frames (F,) with their times, and numbers of placements, -1: left out, against truth.

    `sees` tells whether a camera sees the board at a time. A stretch at rest of 0.6 s or more in
    which one does has one frame, or looks like another.
    """
    rest, wrong, rests = [], [], session.rests()
    kept = number >= 0
    true = np.array([session.placement_at(t) for t in time_s])
    for t in time_s[kept & ~moving]:
        if not any(begin <= t <= end for begin, end in rests):
            rest.append(f"{t:.2f} s is not at rest")
    at_rest = time_s[~moving]
    for begin, end in rests:
        count = ((at_rest >= begin) & (at_rest <= end)).sum()
        if end - begin >= 0.6 and sees((begin + end) / 2) and count == 0:
            rest.append(f"no frame from {begin:.2f} to {end:.2f} s")
        if (kept[~moving] & (at_rest >= begin) & (at_rest <= end)).sum() > 1:
            rest.append(f"several frames from {begin:.2f} to {end:.2f} s")
    merged = {int(n): set(true[number == n].tolist()) for n in np.unique(number[kept])}
    wrong += [f"placement {n} has boards {t}" for n, t in merged.items() if len(t) > 1]
    for t in np.unique(true[kept & ~moving]):
        split = np.unique(number[kept & ~moving & (true == t)])
        if len(split) > 1:
            wrong.append(f"board {t} has placements {split.tolist()}")
    return Mistakes(tuple(rest), tuple(wrong))
