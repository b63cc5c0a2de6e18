"""Leave out corners that are not where their neighbours in the image put them.

A board's corners lie evenly on it, and nearly so in a small part of any image. So stray ones are
found before a lens is known, whose fit by least squares they would spoil.
"""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from vergence.arrays import Array
from vergence.calibration.observations import Observations
from vergence.errors import counted
from vergence.findings import note
from vergence.geometry.board import even_grids

LEAST, TYPICAL, CLEAR = 0.35, 6.0, 3.0
"""Minimum distance of a stray corner from where its neighbours put it: in sides of a square (lenses
with k3 make nearly as much at the edge of an image), in units of the median of the image, and of
the disagreement of the neighbours."""


def without_strays(observations: Observations) -> Observations:
    """Return the observations without stray corners, and with a note where there were any."""
    board, corners, said = observations.board, {}, []
    for name, found in observations.corners.items():
        stray = np.zeros(found.shape[:2], dtype=bool)
        for numbers in even_grids(board):
            stray[:, numbers] = strays(found[:, numbers])
        corners[name] = np.where(stray[..., None], np.nan, found)
        images = int(stray.any(axis=1).sum())
        if images:
            said.append(f"{stray.sum()} in {counted(images, 'image')} of {name}")
    if not said:
        return observations
    where = "; ".join(said)
    found = note("stray-corners", f"Corners not where their neighbours say, and left out: {where}.")
    return replace(observations, corners=corners, findings=(*observations.findings, found))


def strays(grid: Array) -> np.ndarray:
    """Return (V, rows, columns) of bool: which corners (V, rows, columns, 2) [px] are stray."""
    stray = np.zeros(grid.shape[:3], dtype=bool)
    for _ in range(3):  # corners beside stray ones may turn out to be good
        expected, apart, side = _by_neighbours(np.where(stray[..., None], np.nan, grid))
        off = np.linalg.norm(grid - expected, axis=-1)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # images without corners
            typical = np.nanmedian(off, axis=(1, 2))
        least = np.maximum(LEAST * side, TYPICAL * typical[:, None, None])
        far = off > np.maximum(least, CLEAR * apart)
        stray = far | (stray & np.isnan(expected[..., 0]))
    return stray


def _by_neighbours(grid: Array) -> tuple[Array, Array, Array]:
    """Return where neighbours put each corner (V, rows, columns, 2) [px].

    It is the median of what pairs of them say along rows and columns, NaN of fewer than two. Also
    how far these disagree, and the side of a square there or, if more, in most of the image: both
    (V, rows, columns) [px].
    """
    padded = np.pad(grid, ((0, 0), (2, 2), (2, 2), (0, 0)), constant_values=np.nan)
    rows, columns = grid.shape[1:3]

    def moved(j: int, i: int) -> Array:
        return padded[:, 2 + j : 2 + j + rows, 2 + i : 2 + i + columns]

    said, sides = [], []
    for j, i in ((0, 1), (1, 0)):
        before, after = moved(-j, -i), moved(j, i)
        said += [
            (before + after) / 2,
            2 * before - moved(-2 * j, -2 * i),
            2 * after - moved(2 * j, 2 * i),
        ]
        sides += [np.linalg.norm(beside - grid, axis=-1) for beside in (before, after)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # corners without neighbours
        expected = np.nanmedian(said, axis=0)
        apart = np.nanmedian(np.linalg.norm(said - expected, axis=-1), axis=0)
        whole = np.nanmedian(sides, axis=(0, 2, 3), keepdims=True)[0]
        side = np.fmax(np.nanmedian(sides, axis=0), whole)
    enough = np.isfinite(said).all(axis=-1).sum(axis=0) >= 2
    return np.where(enough[..., None], expected, np.nan), apart, side
