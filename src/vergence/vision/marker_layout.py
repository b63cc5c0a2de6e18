"""Whether the markers in an image stand to each other as on a ChArUco board that is described.

OpenCV numbers corners by the markers beside them. If a board has other counts, or begins with the
other colour, some markers still agree with its description, and corners get the numbers of others
without a word. So all pairs of neighbours are compared with the description. Next to each other,
markers need no lens: their own sides measure the distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial import KDTree

from vergence.geometry.board import Charuco, marker_family

_NEAREST = 9
"""Markers that are looked at for each: itself, its four neighbours, and some that are none."""
_TOLERANCE = 0.35
"""Of a neighbour's place, in squares: perspective and small markers make 0.2 of it."""
_MOST_SIDES = 2.1
"""Sides of a marker in that of a square, at most: two squares are more."""
_AS_NEAR = 1.5
"""Distance of a neighbour over that of the nearest one: the next but one is twice as far."""
_FAR_TOLERANCE = 0.35
"""Of the place of one that is farther away, as a part of the distance."""
_MOST_SQUARES = 100
_LEAST_PAIRS = 6
_CLEAR_SHARE = 0.8
"""Of the pairs that are as described where the description is right: a misread marker in the middle
of a small board spoils a tenth. Of a board with one square more in a row half are."""


@dataclass(frozen=True, eq=False)
class MarkerPairs:
    """Pairs of markers whose squares touch at a corner, or of the nearest ones that were read."""

    ids: np.ndarray
    """(P, 2) of int: numbers of the first and the second marker."""
    steps: np.ndarray
    """(P, 2) squares along x and y from the first to the second, about 1 or -1 if they touch."""


def marker_pairs(quads: Sequence[np.ndarray], ids: np.ndarray, board: Charuco) -> MarkerPairs:
    """Return the neighbours among markers, of their corners (4, 2) [px] and numbers (N,)."""
    if len(quads) < 2:
        return MarkerPairs(np.empty((0, 2), int), np.empty((0, 2), int))
    corners = np.reshape(quads, (-1, 4, 2)).astype(float)
    centres = corners.mean(axis=1)
    # Sides of each marker along its own x and y: the axes of the board, wherever it is turned.
    sides = (
        np.stack([corners[:, 1] + corners[:, 2], corners[:, 3] + corners[:, 2]], axis=-1) / 2
        - np.stack([corners[:, 0] + corners[:, 3], corners[:, 0] + corners[:, 1]], axis=-1) / 2
    )
    near = np.asarray(KDTree(centres).query(centres, k=min(_NEAREST, len(corners)))[1])
    first, second = np.repeat(np.arange(len(near)), near.shape[1] - 1), near[:, 1:].ravel()
    offsets = np.einsum(
        "pij,pj->pi", np.linalg.pinv(sides)[first], (centres[second] - centres[first])
    )
    by_marker = np.abs(offsets).max(axis=1).reshape(near.shape[0], -1)
    nearest = by_marker.min(axis=1)
    # The nearest is a square away, whatever part of it a marker fills, unless many were not read.
    square = float(np.median(nearest))
    square = square if square < _MOST_SIDES else board.square_m / board.marker_m
    steps, length = offsets / square, by_marker.ravel() / square
    beside = length < _AS_NEAR * nearest[first] / square
    # What is a neighbour's distance away but not in the place of one is not on the board.
    off = np.abs(steps - np.sign(steps)).max(axis=1)
    beside &= (off < _TOLERANCE) | (length > _AS_NEAR)
    return MarkerPairs(np.stack([ids[first], ids[second]], axis=1)[beside], steps[beside])


def read_markers(
    grey: np.ndarray, dictionary: str, most: int | None = None
) -> tuple[list[np.ndarray], np.ndarray]:
    """Return corners (4, 2) [px] and numbers (N,) of the markers of a family in an image (H, W).

    Of its first ones, which boards have, where `most` limits the time that large families take.
    """
    family = marker_family(dictionary)
    first = cv2.aruco.Dictionary(
        family.bytesList[:most], family.markerSize, family.maxCorrectionBits
    )
    quads, ids, _ = cv2.aruco.ArucoDetector(first).detectMarkers(grey)
    numbers = np.empty(0, int) if ids is None else np.asarray(ids, int).ravel()
    return [np.reshape(quad, (4, 2)) for quad in quads], numbers


def contradicts(pairs: MarkerPairs, board: Charuco) -> bool:
    """Return whether neighbours in an image are none, or other ones, on a board."""
    agree, counted = _agreement(pairs, marker_squares(board))
    # With an odd number in a row the other pattern is the same one but for its ends, and shifted.
    other = replace(board, legacy=not board.legacy)
    best, _ = _agreement(pairs, marker_squares(other))
    return agree < max(_CLEAR_SHARE * counted, best)


def marker_squares(board: Charuco) -> np.ndarray:
    """Return the squares (M, 2) of a board's markers, as x and y from its first one."""
    last = board.squares_x * board.squares_y // 2 - 1
    return _squares(board.squares_x, _begins_white(board), last)


def _begins_white(board: Charuco) -> bool:
    return board.legacy and board.squares_y % 2 == 0


def board_of(pairs: MarkerPairs, board: Charuco) -> Charuco | None:
    """Return the board on which neighbours are as in an image that is nearest to the one described.

    Its rows are those of the described board, or more if markers of more are seen. None where no
    board has these neighbours.
    """
    if len(pairs.ids) < _LEAST_PAIRS:
        return None
    best, fitting = 0.0, None
    described = board.squares_x, _begins_white(board)
    candidates = [
        described,
        *((x, white) for white in (False, True) for x in range(3, _MOST_SQUARES + 1)),
    ]
    for squares_x, begins_white in candidates:
        agree, counted = _agreement(pairs, _squares(squares_x, begins_white, int(pairs.ids.max())))
        if counted and agree / counted > best:
            best, fitting = agree / counted, (squares_x, begins_white)
    if fitting is None or best < _CLEAR_SHARE:
        return None
    rows = 1 + int(_squares(*fitting, int(pairs.ids.max()))[pairs.ids.max()][1])
    return _nearest_to(board, *fitting, rows)


def _nearest_to(board: Charuco, squares_x: int, begins_white: bool, rows: int) -> Charuco | None:
    """Return the board with these squares that differs least from the one described."""
    likely = [board.squares_y] * (squares_x == board.squares_x)
    exchanged = squares_x == board.squares_y and rows >= board.squares_x - 1
    likely += [board.squares_x] * exchanged  # the last row may be out of sight
    for squares_y in (*likely, rows, rows + 1, 3):
        for legacy in (board.legacy, not board.legacy):
            with suppress(ValueError):  # of more markers than the dictionary has
                found = replace(board, squares_x=squares_x, squares_y=squares_y, legacy=legacy)
                if squares_y >= rows and _begins_white(found) == begins_white:
                    return found
    return None


def _squares(squares_x: int, begins_white: bool, last: int) -> np.ndarray:
    """Return as x and y the squares (last + 1, 2) of markers 0 to last: the white ones, by rows."""
    y, x = np.indices((2 * (last + 1) // squares_x + 2, squares_x))
    white = (x + y) % 2 == (0 if begins_white else 1)
    return np.stack([x[white], y[white]], axis=1)[: last + 1]


def _agreement(pairs: MarkerPairs, squares: np.ndarray) -> tuple[int, int]:
    """Return how many pairs agree with the squares (M, 2) of markers, and how many are compared."""
    known = (pairs.ids < len(squares)).all(axis=1)
    first, second = pairs.ids[known].T
    steps = pairs.steps[known]
    off = np.abs(squares[second] - squares[first] - steps).max(axis=1)
    agree = off < np.maximum(1, _FAR_TOLERANCE * np.abs(steps).max(axis=1))
    return int(agree.sum()), int(known.sum())
