"""The flat calibration pattern: its corners in space, and finding them in an image.

Frame `target`: origin at the first inner corner, x along a row, y along a column, z into the
board; corner (i, j) is at (i, j, 0) times the size of a square.
"""

from __future__ import annotations

import cv2
import numpy as np
from pydantic import ConfigDict, PositiveFloat, PositiveInt
from pydantic.dataclasses import dataclass

from vergence.arrays import Array


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Chessboard:
    """A chessboard, counted in inner corners."""

    columns: PositiveInt
    rows: PositiveInt
    square_m: PositiveFloat
    """Side of a square [m]; a board of unknown size has 1, and lengths come in squares."""


def corner_points(board: Chessboard) -> Array:
    """Return the inner corners (rows * columns, 3) [m] in frame target, row by row."""
    j, i = np.mgrid[: board.rows, : board.columns]
    return np.stack([i, j, np.zeros_like(i)], axis=-1).reshape(-1, 3) * board.square_m


def find_corners(image: np.ndarray, board: Chessboard) -> Array | None:
    """Return the inner corners (rows * columns, 2) [px] in the order of corner_points.

    A chessboard whose corner counts differ in parity looks different from its two ends, and is
    numbered so that the square outside the first corner is black. Other boards keep the order
    in which OpenCV found them, which may be turned by 180 degrees.

    Args:
        image: (H, W) or (H, W, 3) uint8.
        board: what to look for.

    Returns:
        The corners, or None where the whole board was not found.
    """
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    size = (board.columns, board.rows)
    found, corners = cv2.findChessboardCornersSB(grey, size, flags=cv2.CALIB_CB_ACCURACY)
    if not found or corners is None:
        return None
    corners = corners.reshape(-1, 2).astype(float)
    grid = corners.reshape(board.rows, board.columns, 2)
    spacing = min(np.linalg.norm(np.diff(grid, axis=k), axis=2).min() for k in (0, 1))
    corners = refine_corners(grey, corners, radius_px=int(np.clip(spacing / 4, 2, 5)))
    if (board.columns + board.rows) % 2 and _first_square_is_white(grey, corners, board):
        corners = corners[::-1]
    return np.ascontiguousarray(corners)


def refine_corners(grey: np.ndarray, corners: Array, *, radius_px: int) -> Array:
    """Move corners (K, 2) onto the saddle points of the grey levels around them.

    Around a corner the slightly blurred image is a saddle; a quadratic is fitted to a disc and
    its stationary point taken, three times over (after Lucchese and Mitra, 2002). On rendered
    boards that lean or are near this is free of the errors of up to half a pixel that single
    corners of OpenCV's detector have there.

    Args:
        grey: (H, W) uint8.
        corners: (K, 2) px, right to about a pixel.
        radius_px: of the disc; it must stay clear of the neighbouring corners.

    Returns:
        (K, 2) px; a corner around which there is no saddle within a pixel and a half stays.
    """
    blurred = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), 0.7)
    v, u = np.mgrid[-radius_px : radius_px + 1, -radius_px : radius_px + 1]
    disc = u * u + v * v <= (radius_px + 0.2) ** 2
    u, v = u[disc].astype(float), v[disc].astype(float)
    fit = np.linalg.pinv(np.stack([u * u, u * v, v * v, u, v, np.ones_like(u)], axis=-1))
    refined = corners.copy()
    for _ in range(3):
        at = (refined[:, None] + np.stack([u, v], axis=-1)).astype(np.float32)
        grey_levels = cv2.remap(blurred, at[..., 0], at[..., 1], cv2.INTER_CUBIC)
        a, b, c, d, e, _ = (grey_levels @ fit.T).T
        det = 4 * a * c - b * b  # negative at a saddle
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.stack([b * e - 2 * c * d, b * d - 2 * a * e], axis=-1) / det[:, None]
        step[(det >= 0) | (np.abs(step).max(axis=1) > 1.5)] = np.nan
        refined += step
    lost = ~(np.abs(refined - corners).max(axis=1) < 1.5)
    return np.where(lost[:, None], corners, refined)


def _first_square_is_white(grey: np.ndarray, corners: Array, board: Chessboard) -> bool:
    """Compare the mean grey of the squares that share the first square's colour with the rest."""
    grid = corners.reshape(board.rows, board.columns, 2)
    centres = (grid[:-1, :-1] + grid[:-1, 1:] + grid[1:, :-1] + grid[1:, 1:]) / 4
    column, row = np.round(centres).astype(int).transpose(2, 0, 1)
    values = grey[row, column].astype(float)
    j, i = np.indices(values.shape)
    like_first = (i + j) % 2 == 0  # the square inside the first corner is like the one outside
    return bool(values[like_first].mean() > values[~like_first].mean())
