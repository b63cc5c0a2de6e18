"""Calibration and board for which views are planned: of a file, or of a dataset."""

from __future__ import annotations

import os
from pathlib import Path

from numpy.typing import ArrayLike

from vergence.accuracy.plan import largest_readings
from vergence.calibration.calibrate import calibrate
from vergence.data.description import MAX_SQUARE_M
from vergence.data.reader import load_dataset
from vergence.errors import VergenceError
from vergence.geometry.board import Board, Chessboard
from vergence.geometry.head import HeadCalibration, load_head
from vergence.progress import Progress


def head_and_board(
    source: Path,
    board: tuple[int, int, float] | None,
    limits_rad: ArrayLike,
    progress: Progress,
) -> tuple[HeadCalibration, Board]:
    """Load the calibration of a file, or calibrate a dataset, and find the board to show.

    VergenceError if the source is neither, its calibration is void, or nothing can be planned.
    """
    shown = None if board is None else _chessboard(*board)
    if os.path.isdir(source):
        data = load_dataset(source)
        largest_readings(data.description.head_kinematics, limits_rad)
        found = calibrate(data, progress=progress)
        if found.accuracy.void:
            raise VergenceError(f"The calibration from {source} is VOID: {found.accuracy.void[0]}")
        return found.head, shown or data.description.board
    head = load_head(source)
    if shown is None:
        raise VergenceError(
            f"{source} does not say which board will be shown; say it with --board COLUMNS ROWS "
            "SQUARE_M, such as --board 9 6 0.03, or name the folder of the dataset."
        )
    return head, shown


def _chessboard(columns: int, rows: int, square_m: float) -> Chessboard:
    if min(columns, rows) < 3 or max(columns, rows) > 100 or not 0 < square_m <= MAX_SQUARE_M:
        raise VergenceError(
            "--board takes 3 to 100 inner corners each way and the side of a square up to 1 m, "
            f"found {columns} {rows} {square_m:g}."
        )
    return Chessboard(columns, rows, square_m)
