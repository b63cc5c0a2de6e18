"""Detection of the inner corners of a calibration board in an image."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.geometry.board import Board, Charuco, Chessboard, corner_points, opencv_board
from vergence.vision.chessboard_checks import (
    contrast,
    goes_on,
    is_chequered,
    is_grid,
    square_levels,
)
from vergence.vision.corner_refinement import (
    HALF_WIDTH_PX,
    adjacent_sides,
    edge_distances,
    refine_corners,
)
from vergence.vision.exposure import grey_levels
from vergence.vision.marker_layout import contradicts, marker_pairs

CLEARANCE_FRACTION = 0.4
"""Part of the distance to the nearest other edge along which a corner's edges are sampled. With
more than half of it neighbours share pixels: each errs by a tenth less, but together along a row
(their correlation is 0.35 at 0.6), so that the board's pose is known less well than it seems."""
MIN_CLEARANCE_PX = 4
"""Corners nearer to another edge err by 0.05 px and more, with a bias to one side."""
BLUR_PX = 2.4
"""Distance from an edge within which its blur matters: two and a half standard deviations of that
of a sharp camera and of the refinement together. With half of it corners of squares below 20 px
are off by 0.003 to 0.005 px on average, and noisier."""
MIN_HALF_WIDTH_PX = 0.8
"""Half width of the strips of a ChArUco corner, however near the markers are."""
MIN_CONTRAST = 30
"""Grey levels between black and white squares below which their corners err too much. OpenCV's
method by sectors, which decides there, finds no board either."""
MAX_UPSAMPLED_PX = 1_500_000
"""Images with at least this many pixels are not upsampled for the detection of markers."""


def detect_board(image: np.ndarray, board: Board) -> Array | None:
    """Detect a board in an image (H, W) or (H, W, 3) uint8, RGB, and return its inner corners.

    A ChArUco board may be partly visible. A chessboard must be visible as a whole, although single
    corners without a clear saddle point become NaN. If one of a chessboard's corner counts is odd
    and the other even, its two ends differ, and corners are numbered so that the square outside the
    first one is black. Otherwise several ends look the same, and the first corner is that of these
    which is nearest to the image's upper left. (A square board with an odd count has a black square
    outside of two of its four corners; one of these is the first.)

    Returns pixels (rows * columns, 2) in the order of corner_points, NaN for corners that were not
    found; None where no board was detected.
    """
    grey = grey_levels(image)
    if isinstance(board, Charuco):
        return _detect_charuco(grey, board)
    return _detect_chessboard(grey, board)


def _detect_chessboard(grey: np.ndarray, board: Chessboard) -> Array | None:
    size = (board.columns, board.rows)
    # OpenCV's oldest method takes a twentieth of the time, misses every tenth board, and errs by
    # more than a pixel at a few corners of inclined ones, which then cannot be refined.
    found, corners = cv2.findChessboardCorners(grey, size, flags=0)
    if found and contrast(grey, corners) > MIN_CONTRAST:
        refined = _refined(grey, corners, board)
        if refined is not None and np.isfinite(refined).all():
            return refined
    # Without CALIB_CB_ACCURACY, which takes three times as long and also errs by more than a pixel
    # at a few corners, but detects boards that are missed without it.
    found, corners = cv2.findChessboardCornersSB(grey, size, flags=0)
    if not found:
        found, corners = cv2.findChessboardCornersSB(grey, size, flags=cv2.CALIB_CB_ACCURACY)
    return _refined(grey, corners, board) if found and corners is not None else None


def _refined(grey: np.ndarray, detected: np.ndarray, board: Chessboard) -> Array | None:
    """Return the refined corners (N, 2) of a board that OpenCV detected; None: it is another."""
    grid = detected.reshape(board.rows, board.columns, 2).astype(float)
    quarters = (0, 1, 2, 3) if board.rows == board.columns else (0, 2)
    grid = rough = _numbered(grey, [np.rot90(grid, quarter) for quarter in quarters])
    distances = edge_distances(grid)
    grid = np.where(distances[..., None] < MIN_CLEARANCE_PX, np.nan, grid)
    grid = refine_corners(grey, grid, CLEARANCE_FRACTION * distances)
    border = grid[0], grid[-1], grid[:, 0], grid[:, -1]
    if any(np.isnan(line).all() for line in border):
        return None  # the board's outline was taken for a row; its other end is outside the image
    known = np.where(np.isnan(grid), rough, grid)  # single rough ones are off by pixels
    if not is_grid(grid) or not is_chequered(grey, known) or goes_on(grey, known):
        return None
    return grid.reshape(-1, 2)


def _detect_charuco(grey: np.ndarray, board: Charuco) -> Array | None:
    parameters = cv2.aruco.CharucoParameters()
    parameters.minMarkers = 1  # next to a corner; corners that are no saddle points go below
    parameters.tryRefineMarkers = True
    detector = cv2.aruco.CharucoDetector(opencv_board(board), parameters)
    large, scale = upsampled(grey)
    found, numbers, quads, ids = detector.detectBoard(large)
    ids = np.empty(0, int) if ids is None else np.asarray(ids, int).ravel()
    if contradicts(marker_pairs(quads, ids, board), board):
        return None
    if found is None:  # OpenCV gives up on a board if a marker of its family is read elsewhere
        quads, ids = _markers_of_one_plane(quads, ids, board)
        if len(ids):
            found, numbers, _, _ = detector.detectBoard(large, markerCorners=quads, markerIds=ids)
    if found is None or numbers is None or not len(numbers):
        return None
    corners = np.full((board.rows * board.columns, 2), np.nan)
    valid = np.asarray(numbers, dtype=int).ravel()
    corners[valid] = (np.reshape(found, (-1, 2)) + 0.5) / scale - 0.5
    grid = corners.reshape(board.rows, board.columns, 2)
    shortest = _shortest_diagonals(grid)
    if not np.isfinite(shortest).any():
        return None
    grid[~np.isfinite(shortest)] = np.nan  # their scale is unknown
    # Strips stay in the white between an edge and the markers, away from the blur of both.
    margin = (1 - board.marker_m / board.square_m) / 2
    distances = edge_distances(grid)
    half_widths = np.clip(margin * distances - BLUR_PX, MIN_HALF_WIDTH_PX, HALF_WIDTH_PX)
    corners = refine_corners(grey, grid, CLEARANCE_FRACTION * distances, half_widths).reshape(-1, 2)
    _reject_misread(corners, corner_points(board)[:, :2], 0.3 * float(np.nanmedian(shortest)))
    return corners if np.isfinite(corners).any() else None


def upsampled(grey: np.ndarray) -> tuple[np.ndarray, int]:
    """Return an image as markers are read in it, and how many times as large it is.

    Markers of 15 px, as in a wide image at arm's length, are read twice as often if upsampled.
    """
    scale = 2 if grey.size < MAX_UPSAMPLED_PX else 1
    return cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC), scale


def _markers_of_one_plane(
    quads: Sequence[np.ndarray], ids: np.ndarray, board: Charuco
) -> tuple[list[np.ndarray], np.ndarray]:
    """Return those of the markers read that lie as on the board: others were misread.

    The tolerance, half a marker, is for distortion.
    """
    drawn = opencv_board(board)
    numbers = np.asarray(drawn.getIds(), int).ravel()
    known = np.flatnonzero(np.isin(ids, numbers))
    if len(known) < 6:
        return [], ids[:0]
    centres = np.array([np.mean(quad, axis=0)[:2] for quad in drawn.getObjPoints()])
    on_board = centres[np.argmax(ids[known, None] == numbers, axis=1)]
    read = np.array([quads[int(k)].reshape(4, 2) for k in known])
    side = float(np.median(np.linalg.norm(np.diff(read, axis=1), axis=-1)))
    _, inside = cv2.findHomography(on_board, read.mean(axis=1), cv2.RANSAC, 0.5 * side)
    good = known[:0] if inside is None else known[np.asarray(inside, bool).ravel()]
    return [quads[int(k)] for k in good], ids[good].astype(np.int32)


def _shortest_diagonals(grid: Array) -> Array:
    """Return the shortest diagonal [px] of the squares at each corner; NaN: no neighbours."""
    diagonals = [
        np.linalg.norm(along + sign * across, axis=-1)
        for along, across in adjacent_sides(grid)
        for sign in (-1, 1)
    ]
    return np.asarray(np.fmin.reduce(diagonals))


def _reject_misread(corners: Array, points: Array, tolerance_px: float) -> None:
    """Set corners (K, 2) that no homography (up to distortion) fits to NaN: misread markers."""
    valid = np.flatnonzero(np.isfinite(corners[:, 0]))
    if len(valid) < 6:  # too few to identify an outlier
        return
    _, inside = cv2.findHomography(points[valid], corners[valid], cv2.RANSAC, tolerance_px)
    if inside is not None:
        corners[valid[~np.asarray(inside, dtype=bool).ravel()]] = np.nan


def _numbered(grey: np.ndarray, turned: list[Array]) -> Array:
    """Return that one of the grids of a turned board whose first corner is the board's.

    The square outside it is black, if those outside the corners of the board differ in colour; of
    several, it is the one nearest to the upper left, whichever method found the board.
    """
    rows, columns = turned[0].shape[:2]
    if (rows + columns) % 2 or (rows == columns and rows % 2):
        turned = [grid for grid in turned if not _first_square_is_white(grey, grid)]
    return min(turned, key=lambda grid: float(grid[0, 0].sum()))


def _first_square_is_white(grey: np.ndarray, grid: Array) -> bool:
    """Return whether squares of the first one's colour are brighter on average than the others."""
    values = square_levels(grey, grid)
    j, i = np.indices(values.shape)
    like_first = (i + j) % 2 == 0  # the square inside the first corner is like the one outside
    return bool(values[like_first].mean() > values[~like_first].mean())
