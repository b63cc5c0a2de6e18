"""Planar calibration boards, and their corners in frame target.

Frame `target`: origin at the first inner corner, x along a row, y along a column, z into the
board; corner (i, j) of a chessboard is at (i, j, 0) times the sides of a square.
"""

from __future__ import annotations

from typing import Annotated, Literal

import cv2
import numpy as np
from pydantic import ConfigDict, Field, FiniteFloat, PositiveFloat, PositiveInt
from pydantic.dataclasses import dataclass

from vergence.arrays import Array
from vergence.errors import VergenceError

DICTIONARIES = tuple(
    sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_") and name.isupper())
)
"""Names of OpenCV's marker dictionaries."""


@dataclass(frozen=True, config=ConfigDict(extra="forbid", allow_inf_nan=False))
class Chessboard:
    """A chessboard, described by its inner corners."""

    columns: PositiveInt
    """Inner corners in a row: one less than the squares."""
    rows: PositiveInt
    """Inner corners in a column."""
    square_m: PositiveFloat
    """Side of a square [m]; 1 for a board of unknown size, so that lengths are in squares."""
    square_y_m: PositiveFloat | None = None
    """Its side along a column [m], where the printer has stretched the board; None: the same."""
    square_std_m: PositiveFloat | None = None
    """Standard deviation of the stated side [m]; None: a hundredth of it."""
    kind: Literal["chessboard"] = "chessboard"

    def __post_init__(self) -> None:
        _check_stretch(self)


@dataclass(frozen=True, config=ConfigDict(extra="forbid", allow_inf_nan=False))
class Charuco:
    """A chessboard with a marker in every white square, described by its squares, as in OpenCV.

    The markers identify the corners, so that a partly visible board is enough and the numbering is
    never ambiguous.
    """

    squares_x: PositiveInt
    squares_y: PositiveInt
    square_m: PositiveFloat
    """Side of a square [m]."""
    marker_m: FiniteFloat
    """Side of a marker [m]."""
    dictionary: str
    """OpenCV's name of the marker dictionary, such as DICT_4X4_50."""
    legacy: bool = False
    """Whether the board was made by OpenCV before 4.6, in which boards with an even number of rows
    begin with a white square."""
    square_y_m: PositiveFloat | None = None
    """Side of a square along a column [m], where the printer has stretched the board; None: the
    same."""
    square_std_m: PositiveFloat | None = None
    """Standard deviation of the stated side [m]; None: a hundredth of it."""
    kind: Literal["charuco"] = "charuco"

    def __post_init__(self) -> None:
        _check_stretch(self)
        if min(self.squares_x, self.squares_y) < 3 or max(self.squares_x, self.squares_y) > 100:
            found = f"{self.squares_x} x {self.squares_y}"
            raise ValueError(f"a ChArUco board has 3 to 100 squares each way, found {found}")
        _check_markers(self, self.squares_x * self.squares_y // 2 - 1)

    @property
    def columns(self) -> int:
        """Inner corners in a row."""
        return self.squares_x - 1

    @property
    def rows(self) -> int:
        """Inner corners in a column."""
        return self.squares_y - 1


@dataclass(frozen=True, config=ConfigDict(extra="forbid", allow_inf_nan=False))
class AprilGrid:
    """A grid of markers whose corners touch small black squares, as Kalibr prints it.

    The markers identify the corners, so that a partly visible grid is enough. They are numbered
    from 0 along rows, from the lowest row.
    """

    tags_x: Annotated[int, Field(ge=2, le=50)]
    tags_y: Annotated[int, Field(ge=2, le=50)]
    square_m: PositiveFloat
    """From the corner of a marker to that of the next one [m]: Kalibr's tagSize (1 + tagSpacing).
    """
    marker_m: PositiveFloat
    """Side of a marker [m]: Kalibr's tagSize."""
    dictionary: str = "DICT_APRILTAG_36h11"
    """OpenCV's name of the marker dictionary."""
    square_y_m: PositiveFloat | None = None
    square_std_m: PositiveFloat | None = None
    """As of a chessboard."""
    kind: Literal["aprilgrid"] = "aprilgrid"

    def __post_init__(self) -> None:
        _check_stretch(self)
        _check_markers(self, self.tags_x * self.tags_y - 1)

    @property
    def columns(self) -> int:
        """Corners in a row: two of each marker."""
        return 2 * self.tags_x

    @property
    def rows(self) -> int:
        """Corners in a column."""
        return 2 * self.tags_y


@dataclass(frozen=True, config=ConfigDict(extra="forbid", allow_inf_nan=False))
class CircleGrid:
    """Round spots in rows; their centres are its corners. It must be visible as a whole."""

    columns: Annotated[int, Field(ge=3, le=100)]
    """Spots in a row."""
    rows: Annotated[int, Field(ge=3, le=100)]
    square_m: PositiveFloat
    """Distance of two rows [m]; spots of a row lie as far apart, or twice as far if asymmetric."""
    asymmetric: bool = False
    """Whether every other row is shifted by half the distance of its spots, as OpenCV's 4 x 11."""
    square_y_m: PositiveFloat | None = None
    square_std_m: PositiveFloat | None = None
    """As of a chessboard."""
    kind: Literal["circles"] = "circles"

    def __post_init__(self) -> None:
        _check_stretch(self)


Board = Chessboard | Charuco | AprilGrid | CircleGrid


def described(board: Board) -> str:
    """Name a board by its kind and counts."""
    what = "inner corners"
    if isinstance(board, CircleGrid):
        what = "in asymmetric rows" if board.asymmetric else "in rows"
    return f"{board.kind} of {board.columns} x {board.rows} {what}"


def _check_markers(board: Charuco | AprilGrid, last: int) -> None:
    """Raise ValueError for markers larger than their squares, or that no dictionary has."""
    if not 0 < board.marker_m < board.square_m:
        raise ValueError(
            f"marker_m lies between 0 and square_m = {board.square_m}, found {board.marker_m}"
        )
    try:
        marker_family(board.dictionary, last)
    except VergenceError as error:
        raise ValueError(str(error)) from None


def _check_stretch(board: Board) -> None:
    """Raise ValueError for sides of squares that no printer makes of square ones."""
    x, y = board.square_m, board.square_y_m or board.square_m
    if abs(y / x - 1) > 0.1:
        raise ValueError(
            f"square_y_m is the other side of nearly square squares of {x} m, found {y}"
        )


def marker_family(dictionary: str, marker_id: int = 0) -> cv2.aruco.Dictionary:
    """Look up OpenCV's family of markers; VergenceError if it, or the marker in it, is unknown."""
    if dictionary.upper() not in DICTIONARIES:  # OpenCV also writes 36h11
        raise VergenceError(
            f"No marker dictionary is called {dictionary!r}; there are {', '.join(DICTIONARIES)}."
        )
    family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary.upper()))
    count = len(family.bytesList)
    if not 0 <= marker_id < count:
        raise VergenceError(
            f"Asked for marker {marker_id} of {dictionary}, whose markers are 0 to {count - 1}."
        )
    return family


def opencv_board(board: Charuco) -> cv2.aruco.CharucoBoard:
    """Make OpenCV's object of a board, which detects it and draws it for printing."""
    size, family = (board.squares_x, board.squares_y), marker_family(board.dictionary)
    made = cv2.aruco.CharucoBoard(size, board.square_m, board.marker_m, family)
    made.setLegacyPattern(board.legacy)
    return made


def corner_points(board: Board) -> Array:
    """List the inner corners (rows * columns, 3) [m] in frame target, row by row."""
    j, i = np.mgrid[: board.rows, : board.columns]
    if isinstance(board, AprilGrid):
        i, j = (each // 2 + each % 2 * board.marker_m / board.square_m for each in (i, j))
    elif isinstance(board, CircleGrid) and board.asymmetric:
        i = 2 * i + j % 2
    sides = np.array([board.square_m, board.square_y_m or board.square_m, 0.0])
    return np.stack([i, j, np.zeros_like(i)], axis=-1).reshape(-1, 3) * sides


def even_grids(board: Board) -> list[np.ndarray]:
    """List the parts of a board in which corners lie evenly: their numbers (rows, columns)."""
    numbers = np.arange(board.rows * board.columns).reshape(board.rows, board.columns)
    right = 2 if isinstance(board, AprilGrid) else 1
    down = 2 if isinstance(board, CircleGrid) and board.asymmetric else right
    return [numbers[j::down, i::right] for j in range(down) for i in range(right)]
