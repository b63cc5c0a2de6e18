"""Refine chessboard corners to subpixel accuracy: saddle points of the grey levels.

A quadratic fitted to the grey levels of the slightly blurred image gives the stationary point (by
Lucchese and Mitra, 2002). Two crossing edges look the same after a half-turn, so a neighbourhood
with this symmetry gives no bias: two strips along the edges, bent like the lines of the grid.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from vergence.arrays import Array

HALF_WIDTH_PX = 2.0
"""Half width of the strips [px]: on drawn boards 3 errs more, and 1 is more sensitive to noise."""
MAX_SHIFT_PX = 1.5
"""Largest distance of a saddle point from the initial corner, and largest step [px]."""


def refine_corners(
    grey: np.ndarray,
    grid: Array,
    edges_px: Array,
    half_widths_px: Array | float = HALF_WIDTH_PX,
    places: Array | None = None,
) -> Array:
    """Move a board's corners (rows, columns, 2) [px] to nearby saddle points of the grey levels.

    Corners are right to about a pixel, NaN where unknown. Given are `edge_distances` (rows,
    columns), and half widths of the strips (rows, columns), or one for all. Corners lie on the
    board at places (rows, columns, 2), None: one apart. NaN for a corner without a clear saddle
    point, near the image's border, or without a neighbour in its row or its column.
    """
    shape = grid.shape
    # With strips longer than half the distance to the next edge neighbours would share pixels.
    lengths = np.clip(np.nan_to_num(0.4 * edges_px), 2, 10).ravel()
    half_widths = np.broadcast_to(half_widths_px, shape[:2]).ravel()
    strips = _strips(grid, lengths, half_widths)
    no_curvature = np.zeros((lengths.size, 2, 3))
    first = _saddle_points(grey, grid.reshape(-1, 2), strips, no_curvature)
    # The curvature needs more accurate corners than the initial ones.
    curvature = curvatures(first.reshape(shape), places).reshape(-1, 2, 3)
    return _saddle_points(grey, first, strips, curvature).reshape(shape)


def edge_distances(grid: Array) -> Array:
    """Compute the distance (rows, columns) of each corner of a grid to the nearest other edge."""
    heights = []
    for along, across in adjacent_sides(grid):
        area = np.abs(along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0])
        sides = np.maximum(np.linalg.norm(along, axis=-1), np.linalg.norm(across, axis=-1))
        heights.append(area / sides)
    return np.asarray(np.fmin.reduce(heights))


def adjacent_sides(grid: Array) -> list[tuple[Array, Array]]:
    """List the sides of the four squares around each corner, as vectors from it.

    Four pairs (rows, columns, 2), along the row and the column; NaN without a neighbour.
    """
    padded = np.pad(grid, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    centre = padded[1:-1, 1:-1]
    horizontal = (padded[1:-1, :-2] - centre, padded[1:-1, 2:] - centre)
    vertical = (padded[:-2, 1:-1] - centre, padded[2:, 1:-1] - centre)
    return [(along, across) for along in horizontal for across in vertical]


def curvatures(grid: Array, places: Array | None = None) -> Array:
    """Estimate the second-order terms (rows, columns, 2, 3) of the bend of a board's lines.

    Coefficients of u^2, u v and v^2 in the deviation of x and y [px] from straight lines, at an
    offset (u, v) [px] from a corner: finite differences of a smooth map of the whole board. Zero
    with too few corners.
    """
    offsets = np.stack(np.meshgrid((-1, 0, 1), (-1, 0, 1)), axis=-1) / 4  # squares
    if places is None:
        j, i = np.indices(grid.shape[:2], dtype=float)
        places = np.stack([i, j], axis=-1)
    around = places[:, :, None, None] + offsets
    mapped = smooth_map(places.reshape(-1, 2), grid.reshape(-1, 2), around.reshape(-1, 2))
    mapped = mapped.reshape(around.shape)
    if not np.isfinite(mapped).all():
        return np.zeros((*grid.shape[:2], 2, 3))
    above, here, below = (mapped[:, :, k, 1] for k in range(3))
    left, right = mapped[:, :, 1, 0], mapped[:, :, 1, 2]
    cross = mapped[:, :, 2, 2] + mapped[:, :, 0, 0] - mapped[:, :, 2, 0] - mapped[:, :, 0, 2]
    # Derivatives by the board's coordinates, then by those of the image: (..., xy, i, j).
    J = np.stack([right - left, below - above], axis=-1) / 2
    H = np.stack([left + right - 2 * here, cross / 4, cross / 4, above + below - 2 * here], axis=-1)
    M = np.linalg.pinv(J)
    # Only the components across each line: an edge is blurred alike to both sides, also where the
    # squares there differ in size.
    bent = M @ H
    bent[..., 0, :3], bent[..., 1, 1:] = 0.0, 0.0
    H = J @ bent
    K = np.swapaxes(M, -1, -2)[:, :, None] @ H.reshape(*J.shape, 2) @ M[:, :, None] / 2
    return np.stack([K[..., 0, 0], K[..., 0, 1] + K[..., 1, 0], K[..., 1, 1]], axis=-1)


def smooth_map(known: Array, corners: Array, places: Array) -> Array:
    """Map places (N, 2) on the board, in squares, to pixels (N, 2).

    It is fitted to corners (K, 2) [px], NaN where not seen, at known places (K, 2): a homography
    and a polynomial for lens distortion, of the largest degree up to five with 1.5 corners a
    coefficient; degree four moves focal lengths of fisheye lenses by four standard deviations. NaN
    with too few corners.
    """
    valid = np.isfinite(corners[:, 0])
    known, corners = known[valid].astype(float), corners[valid]
    degree = max((d for d in range(6) if 3 * (d + 1) * (d + 2) <= 4 * len(known)), default=0)
    H = None if degree < 2 else cv2.findHomography(known, corners, 0)[0]
    if H is None:
        return np.full(places.shape, np.nan)
    straight, wanted = (cv2.perspectiveTransform(at[None], H)[0] for at in (known, places))
    if not np.isfinite(straight).all():
        return np.full(places.shape, np.nan)
    middle, size = straight.mean(axis=0), np.ptp(straight, axis=0).max()
    powers = [(a, b) for a in range(degree + 1) for b in range(degree + 1 - a)]

    def terms(at: Array) -> Array:
        x, y = ((at - middle) / size).T
        return np.stack([x**a * y**b for a, b in powers], axis=-1)

    added = np.linalg.lstsq(terms(straight), corners - straight)[0]
    return wanted + terms(wanted) @ added


def _strips(grid: Array, lengths_px: Array, half_widths_px: Array) -> Array:
    """Compute the offsets (K, 2 P, 2) [px] of the samples of two strips along each corner's edges.

    A half-turn maps the first of the P samples of a strip to its last, and so on. NaN for a corner
    without a neighbour in its row or its column.
    """
    (left, above), _, _, (right, below) = adjacent_sides(grid)
    strips = []
    for before, after in ((left, right), (above, below)):
        edge = np.nan_to_num(after) - np.nan_to_num(before)
        length = np.linalg.norm(edge, axis=-1, keepdims=True)
        edge = (edge / np.where(length > 0, length, np.nan)).reshape(-1, 1, 1, 2)
        along = lengths_px[:, None, None, None] * np.linspace(-1, 1, 15)[:, None, None] * edge
        across = half_widths_px[:, None, None, None] * np.linspace(-1, 1, 5)[:, None]
        aside = across * edge[..., ::-1] * (-1, 1)
        strips.append((along + aside).reshape(len(edge), -1, 2))
    return np.concatenate(strips, axis=1)


def _saddle_points(grey: np.ndarray, corners: Array, strips: Array, curvature: Array) -> Array:
    """Find saddle points (K, 2) [px] near corners (K, 2) in strips (K, P, 2); NaN: not found."""
    refined, asymmetry = np.full(corners.shape, np.nan), np.full(len(corners), np.nan)
    margin = np.abs(strips).max(axis=1) + 2  # NaN is not inside
    size = np.array(grey.shape[::-1])
    inside = ((corners >= margin) & (corners <= size - 1 - margin)).all(axis=1)
    if not inside.any():
        return refined
    # A border affects the blur and the spline over 12 px.
    reach = int(np.ceil(margin[inside].max())) + 12
    low = np.maximum(np.floor(corners[inside].min(axis=0)).astype(int) - reach, 0)
    high = np.ceil(corners[inside].max(axis=0)).astype(int) + reach + 1
    part = grey[low[1] : high[1], low[0] : high[0]].astype(np.float32)
    # cv2.remap's cubic interpolation errs by 0.03 px, even on a linear ramp.
    spline = spline_filter(cv2.GaussianBlur(part, (0, 0), 0.7), order=3, mode="mirror")
    found, asymmetry[inside] = _fit_saddle_points(
        spline, corners[inside] - low, strips[inside], curvature[inside]
    )
    refined[inside] = found + low
    # Partly occluded corners differ from their half-turned copy by a tenth of the contrast.
    refined[asymmetry > max(0.1, 4 * float(np.nanmedian(asymmetry)))] = np.nan
    return refined


def _fit_saddle_points(
    spline: Array, corners: Array, strips: Array, curvature: Array
) -> tuple[Array, Array]:
    """Fit saddle points (K, 2), or NaN, to a spline; return the asymmetry (K,) around them, too."""
    u, v = strips[..., 0], strips[..., 1]
    squares = np.stack([u * u, u * v, v * v], axis=-1)
    fit = np.linalg.pinv(np.concatenate([squares, strips, np.ones_like(strips[..., :1])], axis=-1))
    bent = strips + squares @ np.swapaxes(curvature, 1, 2)
    refined: Array = corners.copy()
    step: Array = np.zeros_like(corners)
    asymmetry: Array = np.zeros(len(corners))
    for _ in range(5):  # Newton steps, from within a pixel
        at = (refined[:, None] + bent).transpose(2, 0, 1)[::-1]
        grey_levels = map_coordinates(spline, at, order=3, prefilter=False, mode="mirror")
        in_strips = grey_levels.reshape(len(grey_levels), 2, -1)
        asymmetry = np.abs(in_strips - in_strips[..., ::-1]).mean(axis=(1, 2))
        asymmetry /= np.maximum(np.ptp(grey_levels, axis=1), 1)
        a, b, c, d, e, _ = np.einsum("kip,kp->ik", fit, grey_levels)
        det = 4 * a * c - b * b  # negative at a saddle
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.stack([b * e - 2 * c * d, b * d - 2 * a * e], axis=-1) / det[:, None]
        step[(det >= 0) | ~(np.abs(step).max(axis=1) <= MAX_SHIFT_PX)] = np.nan
        refined += step
    lost = ~(np.abs(refined - corners).max(axis=1) < MAX_SHIFT_PX)
    lost |= ~(np.abs(step).max(axis=1) < 0.05)  # px; no clear saddle point
    return np.where(lost[:, None], np.nan, refined), asymmetry
