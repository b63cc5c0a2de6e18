"""The eyes' motion by the readings of all rows, and where sightings of the board are too few.

A trajectory is fitted to the latent angles of the rows in which an eye sees the board. Where these
are far apart a polynomial through them would bridge motions that only the readings show.
"""

from __future__ import annotations

import numpy as np

from vergence.arrays import Array
from vergence.calibration.residuals import Postures
from vergence.data.timing import (
    TRAJECTORY_DEGREE,
    Stencil,
    Timing,
    coefficients,
    pose_coefficients,
    stencil,
)

LEAST_SEEN = 0.5
"""Share of the rows of a motion in which an eye must see the board, among its neighbours in time,
so that these determine the trajectory. An assumption: 2 and 5 of 30 rows are too few."""


def read_motion(
    timing: Timing, readings: Array, postures: Postures, around: Stencil
) -> tuple[Array, np.ndarray]:
    """Fit polynomials in time to the readings around B postures.

    Args:
        timing: of V views.
        readings: (V, r) [rad], or poses (V, 2, 4, 4) of both eyes; not finite: unknown.
        postures: of which views and readings.
        around: the neighbours of each posture among the postures.

    Returns:
        Coefficients (B, n, TRAJECTORY_DEGREE) from the reading's moment on, and (B,) of bool where
        the board is seen in too few rows to determine the trajectory.
    """
    view = postures.view
    motion = np.zeros((*postures.reading.shape, TRAJECTORY_DEGREE))
    seldom = np.zeros(len(view), bool)
    nearby_s = timing.time_s[view][around.neighbours]
    for e in np.unique(postures.eye):
        mine = np.flatnonzero(postures.eye == e)
        wanted = np.isin(np.arange(len(readings)), view[mine])
        poses = readings.ndim > 2
        own = readings[:, e] if poses else readings[:, postures.columns[mine[0]]]
        known = np.asarray(np.isfinite(own).reshape(len(own), -1).all(axis=1))
        run = np.where(known, timing.run, 0)  # unknown rows are no neighbours of known ones
        every = stencil(timing.time_s, run, wanted)
        if poses:
            own = np.where(known[:, None, None], own, np.eye(4))
            motion[mine] = pose_coefficients(every, own)[view[mine]]
        else:
            motion[mine] = coefficients(every, np.nan_to_num(own))[view[mine]]
        for b in mine[run[view[mine]] > 0]:
            near = (timing.time_s >= nearby_s[b].min()) & (timing.time_s <= nearby_s[b].max())
            near &= run == run[view[b]]
            seen = np.isin(np.flatnonzero(near), view[mine]).sum()
            seldom[b] = seen < LEAST_SEEN * near.sum()
    return motion, seldom
