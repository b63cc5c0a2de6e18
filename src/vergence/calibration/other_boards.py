"""Which board is there where the one that dataset.json describes is not found."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, replace

import cv2
import numpy as np

from vergence.errors import counted
from vergence.geometry.board import (
    DICTIONARIES,
    AprilGrid,
    Board,
    Charuco,
    Chessboard,
    CircleGrid,
    described,
    marker_family,
)
from vergence.vision.april_grid import BORDER
from vergence.vision.board_detection import (
    detect_board,
    ends_inside,
    enlarged,
    for_search,
    upsampled,
)
from vergence.vision.board_pose import LEAST_CORNERS
from vergence.vision.marker_layout import (
    MarkerPairs,
    board_of,
    contradicts,
    marker_pairs,
    read_markers,
)

_MARKERS = 200
"""Number of markers of each family that are sought: those of a board of 20 x 20 squares."""
ANOTHER = "another board is there than the one described"


def why_not_found(grey: np.ndarray, board: Board) -> str:
    """Say why a board is not found in a sharp image (H, W), by what is seen of any board."""
    if isinstance(board, CircleGrid):
        return "the board was not found; all its circles must be visible"
    if isinstance(board, (Charuco, AprilGrid)):
        border = BORDER if isinstance(board, AprilGrid) else 1
        quads, ids = read_markers(upsampled(grey)[0], board.dictionary, border=border)
        if isinstance(board, Charuco) and contradicts(marker_pairs(quads, ids), board):
            return ANOTHER
        count = counted(len(ids), "marker") if len(ids) else "no marker"
        return f"{count} of {board.dictionary} could be read"
    grid = _largest_grid(grey)
    if grid is None:
        return "the board was not found"
    shorter, longer = sorted(grid.shape[:2])
    if shorter > min(board.columns, board.rows) or longer > max(board.columns, board.rows):
        return ANOTHER
    return (
        f"only {longer} x {shorter} of its {board.columns} x {board.rows} corners were found, and "
        "a chessboard must be visible as a whole"
    )


def other_board(images: Sequence[np.ndarray], board: Board, *, least: int = 1) -> str | None:
    """Say what board at least so many of the images (H, W) show instead, and what to set."""
    for other in _candidates(images, board):
        if other != board and sum(_is_seen(each, other) for each in images) >= max(least, 1):
            return _advice(board, other)
    return None


def mirrored(images: Sequence[np.ndarray], board: Board) -> str | None:
    """Say what to do if images (H, W) are mirrored, which only markers show."""
    flipped = [np.ascontiguousarray(image[:, ::-1]) for image in images]
    marked = isinstance(board, (Charuco, AprilGrid))
    if marked and any(_is_seen(image, board) for image in flipped):
        return "its mirror image is there: store the images as the camera sees, not mirrored"
    return None


def _is_seen(grey: np.ndarray, board: Board) -> bool:
    corners = detect_board(grey, board)
    return corners is not None and np.isfinite(corners[:, 0]).sum() >= LEAST_CORNERS


def _largest_grid(grey: np.ndarray) -> np.ndarray | None:
    """Find the corners (rows, columns, 2) of the largest chessboard in an image."""
    small, scale = for_search(grey)
    with suppress(cv2.error):
        found, corners, colours = cv2.findChessboardCornersSBWithMeta(
            small, (3, 3), flags=cv2.CALIB_CB_LARGER
        )
        if found and corners is not None and colours is not None:
            return enlarged(corners.reshape(*colours.shape[:2], 2).astype(float), scale)
    return None


def _candidates(images: Sequence[np.ndarray], board: Board) -> Iterator[Board]:
    """Yield boards that images (H, W) may show: with markers, then without."""
    sides = board.square_m, board.square_y_m, board.square_std_m
    plain, families = Chessboard(board.columns, board.rows, *sides), {}
    for name in sorted(DICTIONARIES, key=lambda name: len(marker_family(name).bytesList)):
        # DICT_4X4_50, DICT_4X4_100 and so on begin alike: the smallest with enough markers.
        with suppress(ValueError):
            families.setdefault(_family(name), _with_markers(board, name))
    if isinstance(board, Charuco):
        families[_family(board.dictionary)] = board
    large = [upsampled(image)[0] for image in images[: None if isinstance(board, Charuco) else 2]]
    for like in families.values():
        pairs = [marker_pairs(*read_markers(each, like.dictionary, _MARKERS)) for each in large]
        together = MarkerPairs(
            np.concatenate([each.ids for each in pairs]),
            np.concatenate([each.steps for each in pairs]),
        )
        other = board_of(together, like)
        if other is not None:
            yield other
    yield plain
    sizes: Counter[tuple[int, ...]] = Counter()
    for image in images:
        grid = _largest_grid(image)
        if grid is not None and ends_inside(grid, image.shape):
            sizes[tuple(sorted(grid.shape[:2], reverse=board.columns >= board.rows))] += 1
    for (columns, rows), _ in sizes.most_common():
        yield replace(plain, columns=columns, rows=rows)


def _family(dictionary: str) -> str:
    return re.sub(r"_\d+$", "", dictionary.upper())


def _with_markers(board: Board, dictionary: str) -> Charuco:
    """Describe a board like another one with markers; ValueError: the family has too few."""
    if isinstance(board, Charuco):
        return replace(board, dictionary=dictionary)
    return Charuco(
        squares_x=board.columns + 1,
        squares_y=board.rows + 1,
        square_m=board.square_m,
        square_y_m=board.square_y_m,
        square_std_m=board.square_std_m,
        marker_m=0.75 * board.square_m,  # as most are; it matters for few markers only
        dictionary=dictionary,
    )


def _advice(board: Board, other: Board) -> str:
    """Say what to set in dataset.json for another board than the one described."""
    current, settings = asdict(board), []
    for name, value in asdict(other).items():
        if name == "marker_m" and board.kind != other.kind:
            settings.append("board.marker_m to the side of a marker")
        elif value != current.get(name):
            shown = str(value).lower() if isinstance(value, bool) else value
            settings.append(f"board.{name} to {shown}")
    if other.kind == "chessboard" == board.kind:
        settings[-1] += "; they count the corners inside the board, not its squares"
    return f"a {described(other)} is there: set {', '.join(settings)}"
