"""Detect the inner corners of a calibration board in an image."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import cv2
import numpy as np
from scipy.ndimage import map_coordinates

from vergence.arrays import Array
from vergence.geometry.board import AprilGrid, Board, Charuco, Chessboard, CircleGrid, opencv_board
from vergence.vision.april_grid import detect_april_grid
from vergence.vision.circle_grid import detect_circle_grid
from vergence.vision.corner_refinement import HALF_WIDTH_PX, edge_distances, refine_corners
from vergence.vision.exposure import grey_levels
from vergence.vision.marker_layout import contradicts, marker_pairs, marker_squares

_NARROW = 0.5
"""Least width of the outermost squares, in squares: that of many printed boards."""
_CLEAR = 0.25
"""Least difference of a white or black grey level from the middle, over the contrast."""
SEARCHED_PX = 2_500_000
"""Largest image in which a chessboard is searched [pixels]: OpenCV's method by sectors takes up to
340 bytes a pixel. Larger images are shrunk for the search, and corners are refined in them."""
_FLAT = 10
"""Range of grey levels of an image that shows no board: less than noise adds to an even wall."""


def detect_board(image: np.ndarray, board: Board, *, thorough: bool = True) -> Array | None:
    """Detect a board in an image (H, W) or (H, W, 3) uint8, RGB, and locate its inner corners.

    A board with markers may be partly visible, others must be visible as a whole. The square
    outside a chessboard's first corner is black if only one of its corner counts is odd; of corners
    that look the same, the first is the one nearest to the image's upper left. A search that is not
    thorough misses every tenth chessboard, and takes a tenth of the time without one.

    Returns pixels (rows * columns, 2) in the order of corner_points, NaN for corners that were not
    found; None where no board was detected.
    """
    grey = grey_levels(image)
    if np.ptp(grey[::4, ::4]) < _FLAT:
        return None
    with suppress(cv2.error):  # in images of a few pixels, for example
        if isinstance(board, Charuco):
            return _detect_charuco(grey, board)
        if isinstance(board, AprilGrid):
            return detect_april_grid(*upsampled(grey), grey, board)
        if isinstance(board, CircleGrid):
            return detect_circle_grid(grey, board)
        return _detect_chessboard(grey, board, thorough=thorough)
    return None


def for_search(grey: np.ndarray) -> tuple[np.ndarray, float]:
    """Shrink an image to SEARCHED_PX if it is larger; return it and the factor."""
    scale = min(1.0, float(np.sqrt(SEARCHED_PX / grey.size)))
    if scale == 1:
        return grey, scale
    return cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), scale


def enlarged(corners: np.ndarray, scale: float) -> np.ndarray:
    """Convert pixels (N, ..., 2) of an image that was shrunk by a factor to those of the whole."""
    return corners if scale == 1 else (corners + 0.5) / scale - 0.5


def upsampled(grey: np.ndarray) -> tuple[np.ndarray, int]:
    """Enlarge an image for reading markers; return it and the factor.

    Markers of 15 px, as in a wide image at arm's length, are read twice as often.
    """
    scale = 2 if grey.size < 1_500_000 else 1  # larger images take too long
    return cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC), scale


def _detect_chessboard(grey: np.ndarray, board: Chessboard, *, thorough: bool) -> Array | None:
    size, (small, scale) = (board.columns, board.rows), for_search(grey)
    # OpenCV's oldest method takes a twentieth of the time of the one by sectors, but misses every
    # tenth board and errs by more than a pixel at some corners of inclined ones.
    found, corners = cv2.findChessboardCorners(small, size, flags=0)
    if found and contrast(small, corners) > 30:  # grey levels, which the other method needs too
        refined = _refine_chessboard(grey, enlarged(corners, scale), board)
        if refined is not None and np.isfinite(refined).all():
            return refined
    # The second one finds more boards in three times as long.
    for flags in (0, cv2.CALIB_CB_ACCURACY) if thorough else ():
        found, corners = cv2.findChessboardCornersSB(small, size, flags=flags)
        if found:
            return _refine_chessboard(grey, enlarged(corners, scale), board)
    return None


def _refine_chessboard(grey: np.ndarray, detected: np.ndarray, board: Chessboard) -> Array | None:
    """Refine and number the corners (N, 2) that OpenCV detected; None: they are another board's."""
    grid = detected.reshape(board.rows, board.columns, 2).astype(float)
    quarters = (0, 1, 2, 3) if board.rows == board.columns else (0, 2)
    rough = _numbered(grey, [np.rot90(grid, quarter) for quarter in quarters])
    distances = edge_distances(rough)
    # Corners within 4 px of another edge would be biased by 0.05 px.
    clear = np.where(distances[..., None] < 4, np.nan, rough)
    grid = refine_corners(grey, clear, distances)
    border = grid[0], grid[-1], grid[:, 0], grid[:, -1]
    if any(np.isnan(line).all() for line in border):
        return None  # OpenCV took the board's outline for a row of corners
    known = np.where(np.isnan(grid), rough, grid)
    if not is_chequered(grey, known) or goes_on(grey, known):
        return None
    return grid.reshape(-1, 2)


def _numbered(grey: np.ndarray, turned: list[Array]) -> Array:
    """Choose among the grids of a turned board the one that begins with the first corner."""
    rows, columns = turned[0].shape[:2]
    if (rows + columns) % 2 or (rows == columns and rows % 2):
        turned = [grid for grid in turned if not _first_square_is_white(grey, grid)]
    return min(turned, key=lambda grid: float(grid[0, 0].sum()))


def _first_square_is_white(grey: np.ndarray, grid: Array) -> bool:
    """Test whether squares of the first one's colour are brighter on average than the others."""
    values = square_levels(grey, grid)
    j, i = np.indices(values.shape)
    like_first = (i + j) % 2 == 0  # the squares inside and outside the first corner are alike
    return bool(values[like_first].mean() > values[~like_first].mean())


def _detect_charuco(grey: np.ndarray, board: Charuco) -> Array | None:
    parameters = cv2.aruco.CharucoParameters()
    parameters.minMarkers = 1  # the refinement rejects false corners
    parameters.tryRefineMarkers = True
    detector = cv2.aruco.CharucoDetector(opencv_board(board), parameters)
    large, scale = upsampled(grey)
    found, numbers, quads, ids = detector.detectBoard(large)
    ids = np.empty(0, int) if ids is None else np.asarray(ids, int).ravel()
    if contradicts(marker_pairs(quads, ids), board):
        return None
    if found is None:  # OpenCV gives up on a board if one marker lies elsewhere
        quads, ids = _markers_of_one_plane(quads, ids, board)
        if len(ids):
            found, numbers, _, _ = detector.detectBoard(large, markerCorners=quads, markerIds=ids)
    if found is None or numbers is None or not len(numbers):
        return None
    corners = np.full((board.rows * board.columns, 2), np.nan)
    corners[np.asarray(numbers, int).ravel()] = (np.reshape(found, (-1, 2)) + 0.5) / scale - 0.5
    grid = corners.reshape(board.rows, board.columns, 2)
    # The strips stay in the white between an edge and the markers, away from the blur of both:
    # 2.4 px are 2.5 standard deviations of a sharp camera's blur and that of the refinement.
    margin = (1 - board.marker_m / board.square_m) / 2
    distances = edge_distances(grid)  # NaN without neighbours
    grid[np.isnan(distances)] = np.nan
    half_widths = np.clip(margin * distances - 2.4, 0.8, HALF_WIDTH_PX)
    corners = refine_corners(grey, grid, distances, half_widths).reshape(-1, 2)
    return corners if np.isfinite(corners).any() else None


def _markers_of_one_plane(
    quads: Sequence[np.ndarray], ids: np.ndarray, board: Charuco
) -> tuple[list[np.ndarray], np.ndarray]:
    """Select the markers that a homography maps from the board; the others were misread.

    The tolerance of half a marker allows for lens distortion.
    """
    squares = marker_squares(board)
    known = np.flatnonzero(ids < len(squares))
    if len(known) < 6:  # a homography through four determines no outlier
        return [], ids[:0]
    read = np.array([quads[int(k)].reshape(4, 2) for k in known])
    side = float(np.median(np.linalg.norm(np.diff(read, axis=1), axis=-1)))
    _, inside = cv2.findHomography(
        squares[ids[known]] + 0.5, read.mean(axis=1), cv2.RANSAC, 0.5 * side
    )
    good = known[:0] if inside is None else known[np.asarray(inside, bool).ravel()]
    return [quads[int(k)] for k in good], ids[good].astype(np.int32)


def contrast(grey: np.ndarray, corners: np.ndarray) -> float:
    """Estimate the grey levels between black and white within corners (..., 2) [px]."""
    corners = corners.reshape(-1, 2).astype(int)
    (left, top), (right, bottom) = np.maximum(corners.min(axis=0), 0), corners.max(axis=0)
    box = grey[top : bottom + 1, left : right + 1]
    return float(np.ptp(np.percentile(box[::2, ::2], [10, 90])))


def square_levels(grey: np.ndarray, grid: Array, at: tuple[float, float] = (0.5, 0.5)) -> Array:
    """Sample the grey levels (rows - 1, columns - 1) at one place in each square of a grid.

    The place is given as parts of the way along a square's row and its column.
    """
    x, y = at
    above = (1 - x) * grid[:-1, :-1] + x * grid[:-1, 1:]
    below = (1 - x) * grid[1:, :-1] + x * grid[1:, 1:]
    places = ((1 - y) * above + y * below).transpose(2, 0, 1)[::-1]
    return np.asarray(map_coordinates(grey, places, float, order=1, mode="nearest"))


def is_chequered(grey: np.ndarray, grid: Array) -> bool:
    """Check that the squares between corners (rows, columns, 2) [px] alternate in colour.

    Only neighbours are compared, since the light may fall off over the board.
    """
    places = 0.2, 0.35, 0.5, 0.65, 0.8  # some lie on the frames of markers
    steps = np.array([_alternation(grey, grid, (x, y)) for x in places for y in places])
    medians = np.median(steps, axis=1)
    clear = _CLEAR * contrast(grey, grid)
    if not ((medians > clear).all() or (medians < -clear).all()):
        return False
    # A reflection may cover a tenth.
    return bool((steps * np.sign(medians[0]) > 0).mean() > 0.9)


def goes_on(grey: np.ndarray, grid: Array) -> bool:
    """Check whether the board has more squares than a grid (rows, columns, 2) [px] of corners.

    Then next to each square outside the outermost corners there is one of the other colour.
    """
    return any(_goes_on_above(grey, np.rot90(grid, quarter)) for quarter in range(4))


def ends_inside(grid: Array, shape: tuple[int, ...]) -> bool:
    """Check that the squares around the corners (rows, columns, 2) [px] lie in an image (H, W)."""
    ends = np.concatenate([_beyond(np.rot90(grid, quarter), 1.0) for quarter in range(4)])
    return bool(((ends >= 0) & (ends <= np.array(shape[1::-1]) - 1)).all())


def _alternation(grey: np.ndarray, grid: Array, at: tuple[float, float]) -> Array:
    """Compute (N,) the brightness of squares of the first one's colour minus each neighbour's."""
    values = square_levels(grey, grid, at)
    sign = np.where(np.indices(values.shape).sum(axis=0) % 2 == 0, 1, -1)
    down, right = sign[1:] * np.diff(values, axis=0), sign[:, 1:] * np.diff(values, axis=1)
    return np.concatenate([down.ravel(), right.ravel()])


def _goes_on_above(grey: np.ndarray, grid: Array) -> bool:
    height, width = grey.shape
    values, inside = [], []
    # Two rows: the outermost squares, and beyond. The outermost squares of many boards are narrow.
    for squares in (_NARROW / 2, 1 + _NARROW / 2):
        corners = _beyond(grid, squares)
        ends = _beyond(corners, _NARROW / 2), _beyond(corners[::-1], _NARROW / 2)
        centres = np.vstack([ends[0], (corners[1:] + corners[:-1]) / 2, ends[1]])
        column, row = np.round(centres).astype(int).T
        inside.append((column >= 0) & (row >= 0) & (column < width) & (row < height))
        values.append(grey[row * inside[-1], column * inside[-1]].astype(float))
    usable = inside[0] & inside[1]
    even = np.arange(len(usable)) % 2 == 0
    if usable[even].sum() < 2 or usable[~even].sum() < 2:
        return False
    # Beyond, the colours are exchanged.
    level = [values[0][usable & each].mean() for each in (even, ~even)]
    from_middle = (values[1] - np.mean(level)) / (level[1] - level[0] or 1.0)
    return bool((np.where(even, from_middle, -from_middle)[usable] > _CLEAR).all())


def _beyond(lines: Array, squares: float) -> Array:
    """Extrapolate lines (n, ..., 2) [px] by a number of squares before the first one.

    A parabola through three lines follows the growth of squares by perspective and lens.
    """
    first, second, third = lines[:3]
    bend = squares * (squares + 1) / 2 * (third - 2 * second + first)
    return np.asarray(first - squares * (second - first) + bend)
