"""The eyes' motion by the readings of all rows, and where sightings of the board cannot tell it.

A trajectory is fitted to the latent angles of the rows in which an eye sees the board. Where these
are far apart a polynomial through them bridges motions that nobody saw, but the readings know.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vergence.arrays import Array
from vergence.data.timing import (
    TRAJECTORY_DEGREE,
    Stencil,
    Timing,
    coefficients,
    pose_coefficients,
    stencil,
)
from vergence.geometry.se3 import known_poses

_LEAST_SEEN = 0.5
"""Share of the rows of a motion in which an eye must see the board, among its neighbours in time,
so that these tell the trajectory. An assumption: 2 and 5 of 30 rows are too few."""


class ReadMotion(NamedTuple):
    """The motion of B blocks of readings."""

    coefficients: Array
    """(B, n, TRAJECTORY_DEGREE) how the readings go on in time, from their own moment on."""
    seldom_seen: np.ndarray
    """(B,) of bool: where the board is seen in too few rows to tell the trajectory."""


def read_motion(
    timing: Timing,
    readings: Array,
    *,
    view: np.ndarray,
    eye: np.ndarray,
    columns: np.ndarray,
    around: Stencil,
) -> ReadMotion:
    """Return the motion of B blocks.

    Args:
        timing: of V views.
        readings: (V, r) [rad], or poses (V, 2, 4, 4) of both eyes; not finite: unknown.
        view: (B,) of each block.
        eye: (B,) whose readings they are.
        columns: (B, n) which of the readings they are; of no meaning for poses.
        around: the neighbours of each block among the blocks.
    """
    n = columns.shape[1]
    found = ReadMotion(np.zeros((len(view), n, TRAJECTORY_DEGREE)), np.zeros(len(view), bool))
    time_s = timing.time_s[view]
    first, last = (end(time_s[around.neighbours], axis=1) for end in (np.min, np.max))
    for e in np.unique(eye):
        mine = np.flatnonzero(eye == e)
        wanted = np.isin(np.arange(len(readings)), view[mine])
        # Rows that are not known are not neighbours of any that is.
        if readings.ndim > 2:
            known = known_poses(readings[:, e])
            every = stencil(timing.time_s, np.where(known, timing.run, 0), wanted)
            poses = np.where(known[:, None, None], readings[:, e], np.eye(4))
            go_on = pose_coefficients(every, poses)
        else:
            own = readings[:, columns[mine[0]]]
            known = np.isfinite(own).all(axis=1)
            every = stencil(timing.time_s, np.where(known, timing.run, 0), wanted)
            go_on = coefficients(every, np.nan_to_num(own))
        found.coefficients[mine] = go_on[view[mine]]
        run = np.where(known, timing.run, 0)
        for number in np.unique(run[run > 0]):
            of_run = mine[run[view[mine]] == number]
            seen, rows = (
                np.searchsorted(times, last[of_run], "right")
                - np.searchsorted(times, first[of_run], "left")
                for times in (np.sort(time_s[of_run]), np.sort(timing.time_s[run == number]))
            )
            found.seldom_seen[of_run] = seen < _LEAST_SEEN * rows
    return found
