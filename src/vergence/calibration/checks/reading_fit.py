"""How well joint readings explain the turns of a camera before a board at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.geometry.kinematics import Kinematics, Side
from vergence.geometry.se3 import nearest_rotation

OUTLIER, OUTLIER_RAD = 6.0, np.radians(1.0)
"""A view contradicts the others that differs by this many times the median, and by this angle."""
OUTLIERS = 0.25
"""Part of the views that may do so; more say that readings or poses as a whole are in doubt."""
AT_REST = 0.1
"""Part of the largest turn by a reading, below which another says nothing of its own gain."""
AHEAD = 0.3
"""Cosine of the angle between a camera's axis and the eye's x axis, at least: some look aside."""


@dataclass(frozen=True, eq=False)
class ReadingFit:
    """How the u readings of an eye explain the turns of a camera before a board at rest."""

    names: list[str]
    """Names of the readings."""
    gains: Array
    """(u,) of each: by what factor w_r is R_cam_eye d_r."""
    explained: float
    """Part of the turns' variance that the readings explain."""
    left_rad: float
    """Root mean square of what they leave."""
    moved: Array
    """(u,) standard deviations of the readings [rad]."""
    at_rest: np.ndarray
    """(u,) of bool: which readings moved too little to tell their gain, which is then 1."""
    R_cam_eye: Array
    """(3, 3) how the eye stands in frame cam, for the axes to be where the images show them."""

    @property
    def possible(self) -> bool:
        """Whether the camera looks out of its eye, and all readings count as described."""
        return bool(self.R_cam_eye[2, 0] > AHEAD and (self.gains > 0).all())


def fit_readings(kinematics: Kinematics, eye: Side, readings: Array, turn: Array) -> ReadingFit:
    """Return how readings (N, r) of an eye explain turns (N, 3), but for those of a few views."""
    chain, used = kinematics.chains[eye], kinematics.used(eye)
    kept = _explained(readings[:, used], turn)
    read, turn = readings[kept][:, used], turn[kept]
    read, turn = read - read.mean(axis=0), turn - turn.mean(axis=0)
    w = np.linalg.lstsq(read, turn, rcond=None)[0]
    d = chain.mixing[:, used].T @ chain.axes
    left = ((turn - read @ w) ** 2).sum() / (turn**2).sum()
    # The rotation that takes the described axes best to where the images show them.
    lengths = [np.linalg.norm(each, axis=1, keepdims=True) for each in (w, d)]
    moved = read.std(axis=0)
    # By the description, and by the images: one alone may be of another unit.
    turned = moved * np.array([lengths[1][:, 0], lengths[0][:, 0]])
    at_rest = (turned < AT_REST * turned.max(axis=1, initial=0.0)[:, None]).all(axis=0)
    w[at_rest] = 0.0
    R = nearest_rotation((w / np.maximum(lengths[0], 1e-12)).T @ (d / lengths[1]))
    gains = np.where(at_rest, 1.0, (w * (d @ R.T)).sum(axis=1) / lengths[1][:, 0] ** 2)
    names = [kinematics.readings[r] for r in used]
    off = turn - read @ w
    left_rad = float(np.sqrt((off**2).sum(axis=1).mean()))
    return ReadingFit(names, gains, 1 - float(left), left_rad, moved, at_rest, R)


def _explained(readings: Array, turn: Array) -> np.ndarray:
    """Return (N,) of bool: without the few views, if any, whose turns readings explain least.

    A reading that was lost, or a board that moved, is a matter of its view: bundle adjustment gives
    it no weight, and names it.
    """
    away = np.abs(readings - np.median(readings, axis=0))
    away = (away / np.maximum(np.median(away, axis=0), 1e-9)).max(axis=1, initial=0.0)
    everything = np.ones(len(turn), dtype=bool)
    # A wild reading may bend the fit to itself, which then starts without the largest ones.
    without = _left_over(readings, turn, away <= np.quantile(away, 1 - OUTLIERS))
    off = _left_over(readings, turn, everything)
    off = without if np.median(without) < np.median(off) / 2 else off
    few = off > max(OUTLIER * np.median(off), OUTLIER_RAD)
    return ~few if few.mean() <= OUTLIERS else everything


def _left_over(readings: Array, turn: Array, kept: np.ndarray) -> Array:
    """Return (N,) what a fit to those that fit best leaves of turns [rad], starting from `kept`."""
    rows, off = np.column_stack([readings, np.ones(len(readings))]), np.zeros(len(turn))
    for _ in range(10):  # each lowers the sum of squares over the part that is kept
        w = np.linalg.lstsq(rows[kept], turn[kept], rcond=None)[0]
        off = np.linalg.norm(turn - rows @ w, axis=1)
        kept = off <= np.quantile(off, 1 - OUTLIERS)
    return off
