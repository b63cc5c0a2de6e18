"""Which board is there where the one that dataset.json describes is not found."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import cv2
import numpy as np

from vergence.errors import counted
from vergence.geometry.board import DICTIONARIES, Board, Charuco, Chessboard, marker_family
from vergence.vision.board_detection import detect_board, upsampled
from vergence.vision.board_pose import LEAST_CORNERS
from vergence.vision.chessboard_checks import ends_inside
from vergence.vision.marker_layout import (
    MarkerPairs,
    board_of,
    contradicts,
    marker_pairs,
    read_markers,
)

_MARKERS = 200
"""Of each family that are sought: enough for a board of 20 x 20 squares."""
ANOTHER = "another board is there than the one described"


def why_not_found(grey: np.ndarray, board: Board) -> str:
    """Return why a board is not found in a sharp image (H, W), by what is seen of any board."""
    if isinstance(board, Charuco):
        quads, ids = read_markers(upsampled(grey)[0], board.dictionary)
        if contradicts(marker_pairs(quads, ids, board), board):
            return ANOTHER
        if len(ids):
            return f"only {counted(len(ids), 'marker')} of the board could be read"
        return "the board was not found"
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
    """Return what board images (H, W) show instead, and what to set; None: none that is known.

    At least so many of them show it.
    """
    candidates: Iterator[tuple[Board, str]]
    if isinstance(board, Charuco):
        candidates = _other_charucos(images, board)
    else:
        candidates = _other_chessboards(images, board)
    for other, advice in candidates:
        if sum(_is_seen(image, other) for image in images) >= max(least, 1):
            return advice
    return None


def mirrored(images: Sequence[np.ndarray], board: Board) -> str | None:
    """Return what to do if images (H, W) are mirrored, which only markers show; None: they are not.

    A chessboard and its mirror image look the same.
    """
    if isinstance(board, Charuco) and any(
        _is_seen(np.ascontiguousarray(image[:, ::-1]), board) for image in images
    ):
        return "its mirror image is there: store the images as the camera sees, not mirrored"
    return None


def _is_seen(grey: np.ndarray, board: Board) -> bool:
    with suppress(cv2.error):  # images of a few pixels, for example
        corners = detect_board(grey, board)
        return corners is not None and np.isfinite(corners[:, 0]).sum() >= LEAST_CORNERS
    return False


def _largest_grid(grey: np.ndarray) -> np.ndarray | None:
    """Return the corners (rows, columns, 2) of the largest chessboard in an image; None: none."""
    with suppress(cv2.error):
        found, corners, colours = cv2.findChessboardCornersSBWithMeta(
            grey, (3, 3), flags=cv2.CALIB_CB_LARGER
        )
        if found and corners is not None and colours is not None:
            return corners.reshape(*colours.shape[:2], 2).astype(float)
    return None


def _other_chessboards(
    images: Sequence[np.ndarray], board: Chessboard
) -> Iterator[tuple[Board, str]]:
    """Yield ChArUco boards, of which OpenCV sees parts, then chessboards; and what to set."""
    with suppress(ValueError):  # of more squares than the family has markers
        like = Charuco(
            squares_x=board.columns + 1,
            squares_y=board.rows + 1,
            square_m=board.square_m,
            square_y_m=board.square_y_m,
            marker_m=0.75 * board.square_m,  # as most are; it matters for few markers only
            dictionary="DICT_4X4_1000",
        )
        for other in _charucos(images[:2], _of_each_family(like).values()):
            yield (
                other,
                "a ChArUco board is there: set board.kind to charuco, board.dictionary to "
                f"{other.dictionary}, board.squares_x to {other.squares_x}, board.squares_y to "
                f"{other.squares_y}, and board.marker_m to the side of a marker",
            )
    for other in _chessboards(images, board):
        yield (
            other,
            f"one of {other.columns} x {other.rows} is there: set board.columns to {other.columns} "
            f"and board.rows to {other.rows}; they count the corners inside the board, not its "
            "squares",
        )


def _chessboards(images: Sequence[np.ndarray], board: Chessboard) -> Iterator[Chessboard]:
    """Yield the chessboards that end inside of an image, the most frequent first."""
    sizes: Counter[tuple[int, ...]] = Counter()
    for image in images:
        grid = _largest_grid(image)
        if grid is not None and ends_inside(grid, image.shape):
            sizes[tuple(sorted(grid.shape[:2], reverse=board.columns >= board.rows))] += 1
    for (columns, rows), _ in sizes.most_common():
        yield replace(board, columns=columns, rows=rows)


def _other_charucos(images: Sequence[np.ndarray], board: Charuco) -> Iterator[tuple[Board, str]]:
    """Yield ChArUco boards with markers as in images (H, W), then chessboards; and what to set."""
    boards = _of_each_family(board) | {_family(board.dictionary): board}
    for other in _charucos(images, boards.values()):
        if other != board:
            yield other, _advice(board, other)
    plain = Chessboard(board.columns, board.rows, board.square_m, board.square_y_m)
    for other in (plain, *_chessboards(images, plain)):
        yield (
            other,
            "a chessboard without markers is there: set board.kind to chessboard, board.columns to "
            f"{other.columns} and board.rows to {other.rows}",
        )


def _charucos(images: Sequence[np.ndarray], boards: Iterable[Charuco]) -> Iterator[Charuco]:
    """Yield for each board the one of the same family on which markers lie as in images (H, W)."""
    large = [upsampled(image)[0] for image in images]
    for board in boards:
        pairs = [
            marker_pairs(*read_markers(each, board.dictionary, _MARKERS), board) for each in large
        ]
        together = MarkerPairs(
            np.concatenate([each.ids for each in pairs]),
            np.concatenate([each.steps for each in pairs]),
        )
        other = board_of(together, board)
        if other is not None:
            yield other


def _of_each_family(board: Charuco) -> dict[str, Charuco]:
    """Return by family of markers a board like this one.

    Of DICT_4X4_50, DICT_4X4_100 and so on it has the smallest with enough markers: the larger ones
    begin with the same.
    """
    boards: dict[str, Charuco] = {}
    for name in sorted(DICTIONARIES, key=lambda name: len(marker_family(name).bytesList)):
        with suppress(ValueError):  # of those with too few markers
            boards.setdefault(_family(name), replace(board, dictionary=name))
    return boards


def _family(dictionary: str) -> str:
    return re.sub(r"_\d+$", "", dictionary)


def _advice(board: Charuco, other: Charuco) -> str:
    """Return what to set in dataset.json for another board than the one described."""
    size, described = (other.squares_x, other.squares_y), (board.squares_x, board.squares_y)
    kind, settings = "of the other pattern", []
    if other.dictionary != board.dictionary:
        kind = "with other markers"
        settings.append(f"set board.dictionary to {other.dictionary}")
    if size != described:
        kind = f"of {size[0]} x {size[1]} squares"
        if size == described[::-1]:
            settings.append("exchange board.squares_x and board.squares_y")
        else:
            settings.append(f"set board.squares_x to {size[0]} and board.squares_y to {size[1]}")
    if other.legacy != board.legacy:
        settings.append(f"set board.legacy to {str(other.legacy).lower()}")
    return f"one {kind} is there: {', '.join(settings)}"
