"""Compare the layout of the markers in an image with that of a ChArUco board.

If the description of a board has wrong counts or the wrong first colour, some markers still agree
with it, and OpenCV returns wrongly numbered corners. So all pairs of neighbours are compared with
the description, at distances measured by their own sides.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial import KDTree

from vergence.geometry.board import Charuco, marker_family

_CLEAR_SHARE = 0.8
"""Least share of pairs that agree with a right description: a misread marker in the middle of a
small board spoils a tenth; with one square too many in a row half of them agree."""


@dataclass(frozen=True, eq=False)
class MarkerPairs:
    """Pairs of neighbouring markers, whose squares touch at a corner."""

    ids: np.ndarray
    """(P, 2) of int: numbers of the first and the second marker."""
    steps: np.ndarray
    """(P, 2) squares along x and y from the first to the second, each about 1 or -1."""


def read_markers(
    grey: np.ndarray, dictionary: str, most: int | None = None, *, border: int = 1
) -> tuple[list[np.ndarray], np.ndarray]:
    """Read the markers of a family in an image (H, W): corners (4, 2) [px] and numbers (N,).

    `most` restricts the family to its first markers, to save time; a marker's black frame is
    `border` modules wide.
    """
    family = marker_family(dictionary)
    first = cv2.aruco.Dictionary(
        family.bytesList[:most], family.markerSize, family.maxCorrectionBits
    )
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border
    quads, ids, _ = cv2.aruco.ArucoDetector(first, parameters).detectMarkers(grey)
    numbers = np.empty(0, int) if ids is None else np.asarray(ids, int).ravel()
    return [np.reshape(quad, (4, 2)) for quad in quads], numbers


def marker_pairs(quads: Sequence[np.ndarray], ids: np.ndarray) -> MarkerPairs:
    """Find the neighbours among markers with corners (4, 2) [px] and numbers (N,)."""
    if len(quads) < 2:
        return MarkerPairs(np.empty((0, 2), int), np.empty((0, 2), int))
    corners = np.reshape(quads, (-1, 4, 2)).astype(float)
    centres = corners.mean(axis=1)
    # The sides of each marker along its own x and y, which are the axes of the board.
    a, b, c, d = corners.swapaxes(0, 1)
    sides = np.stack([b + c - a - d, d + c - a - b], axis=-1) / 2
    # Itself, its four neighbours, and the next ones.
    near = np.asarray(KDTree(centres).query(centres, k=min(9, len(corners)))[1])
    first, second = np.repeat(np.arange(len(near)), near.shape[1] - 1), near[:, 1:].ravel()
    offsets = np.einsum(
        "pij,pj->pi", np.linalg.pinv(sides)[first], centres[second] - centres[first]
    )
    length = np.abs(offsets).max(axis=1)
    # The nearest marker is a square away.
    square = float(np.median(length.reshape(len(near), -1).min(axis=1)))
    steps = offsets / square
    # Perspective moves a neighbour by 0.2 squares from its place.
    neighbours = np.abs(steps - np.sign(steps)).max(axis=1) < 0.35
    return MarkerPairs(np.stack([ids[first], ids[second]], axis=1)[neighbours], steps[neighbours])


def contradicts(pairs: MarkerPairs, board: Charuco) -> bool:
    """Check whether too many pairs of markers disagree with the layout of a board."""
    agree, compared = _agreement(pairs, marker_squares(board))
    # With an odd number of squares in a row the other pattern differs only at the ends.
    other, _ = _agreement(pairs, marker_squares(replace(board, legacy=not board.legacy)))
    return agree < max(_CLEAR_SHARE * compared, other)


def marker_squares(board: Charuco) -> np.ndarray:
    """Compute the squares (M, 2) of a board's markers, as x and y from its first one."""
    last = board.squares_x * board.squares_y // 2 - 1
    return _squares(board.squares_x, _begins_white(board), last)


def board_of(pairs: MarkerPairs, board: Charuco) -> Charuco | None:
    """Find the board nearest to the described one that has these pairs of markers.

    It has as many rows as the described board, or more if their markers are seen. None if too few
    pairs agree with any board.
    """
    if len(pairs.ids) < 6:  # chance would decide
        return None
    last = int(pairs.ids.max())
    described = board.squares_x, _begins_white(board)
    others = [(x, white) for white in (False, True) for x in range(3, 101)]

    def share(layout: tuple[int, bool]) -> float:
        agree, compared = _agreement(pairs, _squares(*layout, last))
        return agree / max(compared, 1)

    best = max((described, *others), key=share)  # the first of equals
    if share(best) < _CLEAR_SHARE:
        return None
    rows = 1 + int(_squares(*best, last)[last][1])
    return _nearest_to(board, *best, rows)


def _nearest_to(board: Charuco, squares_x: int, begins_white: bool, rows: int) -> Charuco | None:
    """Find the board with this layout that differs least from the described one."""
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


def _begins_white(board: Charuco) -> bool:
    return board.legacy and board.squares_y % 2 == 0


def _squares(squares_x: int, begins_white: bool, last: int) -> np.ndarray:
    """List the squares (last + 1, 2) of markers 0 to last, as x and y: the white ones, by rows."""
    y, x = np.indices((2 * (last + 1) // squares_x + 2, squares_x))
    white = (x + y) % 2 == (0 if begins_white else 1)
    return np.stack([x[white], y[white]], axis=1)[: last + 1]


def _agreement(pairs: MarkerPairs, squares: np.ndarray) -> tuple[int, int]:
    """Count the pairs that agree with the squares (M, 2) of markers, and those compared."""
    known = (pairs.ids < len(squares)).all(axis=1)
    first, second = pairs.ids[known].T
    steps = pairs.steps[known]
    deviation = np.abs(squares[second] - squares[first] - steps).max(axis=1)
    return int((deviation < 1).sum()), int(known.sum())
