"""Park and Martin's method where some boards are numbered from the wrong end."""

from __future__ import annotations

import numpy as np

from vergence.arrays import Array
from vergence.calibration.sequential.hand_eye import park_martin
from vergence.errors import VergenceError

AGREE_RAD = 0.1
"""Views agree that put the board within this of each other: far beyond any joint noise, far below
what one wrong view does to the closed form."""
DRAWS = 100
SAMPLE = 4
"""Views to a draw; with a third of the views wrong, one draw in five has good ones only."""


def robust_park_martin(T_base_eye: Array, T_cam_target: Array) -> Array:
    """Return T_eye_cam (4, 4) from the largest set of views that agree where the board stands.

    Where all views agree this is park_martin of all, and nothing is drawn.

    Args:
        T_base_eye: (N, 4, 4) eye poses, from the joint readings.
        T_cam_target: (N, 4, 4) board poses, from the images.

    Raises:
        VergenceError: the motion is degenerate, or there are fewer than three views.
    """
    best = park_martin(T_base_eye, T_cam_target)
    agreeing = _agreeing(best, T_base_eye, T_cam_target)
    if agreeing.all():
        return best
    rng = np.random.default_rng(0)
    for _ in range(DRAWS):
        drawn = rng.choice(len(T_base_eye), min(SAMPLE, len(T_base_eye)), replace=False)
        try:
            trial = park_martin(T_base_eye[drawn], T_cam_target[drawn])
        except VergenceError:
            continue
        found = _agreeing(trial, T_base_eye, T_cam_target)
        if found.sum() > agreeing.sum():
            best, agreeing = trial, found
    if agreeing.sum() >= SAMPLE:
        best = park_martin(T_base_eye[agreeing], T_cam_target[agreeing])
    return best


def _agreeing(T_eye_cam: Array, T_base_eye: Array, T_cam_target: Array) -> np.ndarray:
    """Return (N,) which views belong to the largest set that agrees on the board's rotation."""
    R = (T_base_eye @ T_eye_cam @ T_cam_target)[:, :3, :3]
    traces = np.einsum("iab,jab->ij", R, R)
    close = traces > 1 + 2 * np.cos(AGREE_RAD)
    return close[close.sum(axis=1).argmax()]
