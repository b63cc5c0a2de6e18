"""Boards that a hand holds, and moves between the images of the two eyes.

Such a motion looks like a turn of the eyes: a millimetre in depth, at a baseline of 70 mm, like a
degree of both pans. So the right eye's images get a board of their own, and how far it stands from
the left eye's is a measurement of zero, with noise of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle_start import BundleProblem
from vergence.calibration.postures import Index
from vergence.calibration.priors import boards_block
from vergence.estimation.adjustment import Adjustment
from vergence.estimation.noise import Level
from vergence.estimation.residual import Residual, Rows
from vergence.estimation.variables import Variables
from vergence.geometry.kinematics import EYES
from vergence.geometry.se3 import boxminus

TURNS, SHIFTS = "turns of held boards", "shifts of held boards"
"""Noise levels [rad], [m]."""
FIRST_MOTION, FLOOR = (0.003, 0.001), 1e-7
"""First levels, of a hand that is held still, and least ones [rad], [m]."""
LEAST_HELD = 8
"""Fewest held boards by whose motion its levels are estimated, from three numbers of each kind."""
SUSPECT = 2.0
"""Mean square of the errors of readings before held boards, relative to others, from which the
motion is estimated. One image a board and eye determines differences of readings only, so that half
of a square is expected. Of simulated boards at rest 30 had 1.15 at most (40 recordings), 10 had 2.0
(60 recordings); boards that moved by 1 to 3 mm had 19 or more in 11 of 12 (bad_views.py)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class HeldBoards(Residual):
    """Motion of H boards between the image of the left eye and that of the right one."""

    before: Index
    """(H,) the boards of the left eye."""
    after: Index
    """(H,) the boards of the right eye."""
    level: tuple[str, ...] = (TURNS,) * 3 + (SHIFTS,) * 3

    def error(self, x: Variables) -> Array:
        """Compute the motions (H, 6): rotation [rad], then translation [m]."""
        return boxminus(x["boards"][self.after], x["boards"][self.before])

    def rows(self, x: Variables) -> Rows:
        """Compute the derivatives, for turns far below 1 rad."""
        H = len(self.before)
        columns = x.columns("boards").reshape(-1, 6)
        by_both = np.tile(np.concatenate([-np.eye(6), np.eye(6)], axis=1), (H, 1, 1))
        return Rows(by_both, np.concatenate([columns[self.before], columns[self.after]], axis=1))


def held_boards(problem: BundleProblem, *, least: int = LEAST_HELD) -> BundleProblem | None:
    """Give boards that both eyes see, in one view only, another pose before the right eye.

    None: there are fewer than `least`, no board at rest tells their motion from that of the eyes,
    or poses of the eyes were measured, which no motion of a board passes for.
    """
    of, x, P = problem.measured.detections, problem.start, len(problem.placements)
    views, eyes = (
        np.bincount(np.unique([of.board, other], axis=1)[0], minlength=P)
        for other in (of.views, of.eyes)
    )
    held = (views == 1) & (eyes == len(EYES))
    if held.sum() < least or held.all() or of.postures.T_base_eye_read is not None:
        return None
    before = np.flatnonzero(held)
    after = np.full(P, -1)
    after[before] = P + np.arange(len(before))
    board = np.where(held[of.board] & (of.eyes == 1), after[of.board], of.board)
    boards = boards_block(np.concatenate([x["boards"], x["boards"][before]]))
    return replace(
        problem,
        measured=replace(problem.measured, detections=replace(of, board=board)),
        priors=(*problem.priors, HeldBoards(before=before, after=after[before])),
        start=replace(x, shared={**x.shared, "boards": boards}),
    )


def motion_levels(stds: Sequence[float], *, given: bool) -> list[Level]:
    """List the noise levels of the motion, [rad] and [m]."""
    return [
        Level(name, std, given, floor=FLOOR)
        for name, std in zip((TURNS, SHIFTS), stds, strict=True)
    ]


def moved_boards(problem: BundleProblem, found: Adjustment) -> BundleProblem | None:
    """Take boards apart that seem to have moved; None: readings err no more before held ones.

    Without a minimum, `found` shows nothing: boards may have moved, and may then be part of one.
    """
    apart = held_boards(problem)
    if apart is None or not found.converged:
        return apart
    motion, of = apart.priors[-1], apart.measured.detections
    assert isinstance(motion, HeldBoards)
    on_held = np.isin(of.board, [*motion.before, *motion.after])
    held = np.isin(np.arange(len(of.postures.view)), of.posture[on_held])
    squares = found.errors[1] ** 2
    suspect = squares[held].mean(axis=0) > SUSPECT * squares[~held].mean(axis=0)
    return apart if suspect.any() else None
