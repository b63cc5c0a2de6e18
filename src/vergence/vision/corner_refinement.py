"""Corners of a chessboard to a hundredth of a pixel: saddle points of the grey levels.

Around a corner the slightly blurred image is a saddle. A quadratic is fitted to it, and its
stationary point taken (after Lucchese and Mitra, 2002). Two edges that cross look the same when
turned by half a turn, from wherever they are seen, so that any neighbourhood will do that looks the
same too. Here it is two strips, one along each edge: there is the light that tells where the edges
run, and further off there is only noise, or a marker. A lens bends the edges: then the strips are
bent likewise, by as much as the grid of corners around them is bent.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from vergence.arrays import Array

LENGTHS_PX = 2, 10
"""Least and greatest length of the strips to either side of a corner."""
HALF_WIDTH_PX = 2.0
"""Of the strips. On drawn boards under blur of 0.5 to 3 px, with and without noise, it errs less
than 3 and 5, and about as 1, which feels noise under strong blur."""
_ALONG, _ASIDE = np.linspace(-1, 1, 15), np.linspace(-1, 1, 5)  # where in a strip grey is read
ITERATIONS = 5
REACH_PX = 1.5
"""A corner is not sought further away than this."""
SETTLED_PX = 0.05
"""A corner that still moves further in the last of the iterations is not a clear saddle."""
UNEVEN = 0.1
"""A corner looks the same turned by half a turn. One that differs by more than this part of its
contrast, and more than its neighbours do for noise, is half hidden."""
_BESIDE = 0.25  # squares, for the differences of the board's map
_SPLINE_REACH_PX = 12  # so far the edge of a picture is felt in its spline, and the blur


def refine_grid(
    grey: np.ndarray, grid: Array, lengths_px: Array, half_widths_px: Array | float = HALF_WIDTH_PX
) -> Array:
    """Move the corners of a board onto the saddle points of the grey levels around them.

    Args:
        grey: (H, W) uint8.
        grid: (rows, columns, 2) the board's inner corners [px], right to about a pixel; NaN where
            one is not known.
        lengths_px: (rows, columns) how far along its edges nothing is met; taken within LENGTHS_PX.
        half_widths_px: (rows, columns) how far beside its edges nothing is met.

    Returns:
        (rows, columns, 2) px; NaN where there is no clear saddle, too near the image's edge, or
        without neighbours in its row and its column.
    """
    shape = grid.shape
    lengths = np.clip(np.nan_to_num(lengths_px), *LENGTHS_PX).ravel()
    half_widths = np.broadcast_to(half_widths_px, shape[:2]).ravel()
    strips = _strips(grid, lengths, half_widths)
    straight = _saddles(grey, grid.reshape(-1, 2), strips, np.zeros((lengths.size, 2, 3)))
    # The bend needs corners that are better than those that were given.
    bend = curvatures(straight.reshape(shape)).reshape(-1, 2, 3)
    return _saddles(grey, straight, strips, bend).reshape(shape)


def clearances(grid: Array) -> Array:
    """Return (rows, columns) how far corners (rows, columns, 2) lie from the nearest other edge."""
    heights = []
    for along, across in quadrants(grid):
        area = np.abs(along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0])
        sides = np.maximum(np.linalg.norm(along, axis=-1), np.linalg.norm(across, axis=-1))
        heights.append(area / sides)
    return np.asarray(np.fmin.reduce(heights))


def quadrants(grid: Array) -> list[tuple[Array, Array]]:
    """Return the sides (rows, columns, 2) of the four squares around each corner, from it.

    NaN where there is no neighbour.
    """
    padded = np.pad(grid, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    centre = padded[1:-1, 1:-1]
    beside = (padded[1:-1, :-2] - centre, padded[1:-1, 2:] - centre)
    below = (padded[:-2, 1:-1] - centre, padded[2:, 1:-1] - centre)
    return [(along, across) for along in beside for across in below]


def curvatures(grid: Array) -> Array:
    """Return how the image of a plane bends around its corners (rows, columns, 2).

    By differences of a smooth map of the whole board, so that corners on its rim, and those that
    were not found, are bent like all others.

    Returns:
        (rows, columns, 2, 3): what u^2, u v and v^2 [px] from a corner add to x and y; zero where
        too few corners were found to tell.
    """
    around = np.stack(np.meshgrid((-1, 0, 1), (-1, 0, 1)), axis=-1) * _BESIDE
    j, i = np.indices(grid.shape[:2])
    places = np.stack([i, j], axis=-1)[:, :, None, None] + around
    mapped = _smooth_map(grid, places.reshape(-1, 2)).reshape(places.shape)
    above, here, below = (mapped[:, :, k, 1] for k in range(3))
    left, right = mapped[:, :, 1, 0], mapped[:, :, 1, 2]
    p, r = left + right - 2 * here, above + below - 2 * here
    q = mapped[:, :, 2, 2] + mapped[:, :, 0, 0] - mapped[:, :, 2, 0] - mapped[:, :, 0, 2]
    along, across = (right - left) / 2, (below - above) / 2
    area = along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0]
    area = np.where(area == 0, np.nan, area)[..., None]
    s_u, s_v = across[..., 1:] / area, -across[..., :1] / area  # of u, v, in steps beside a corner
    t_u, t_v = -along[..., 1:] / area, along[..., :1] / area
    bend = [
        (p * s_u**2 + q / 2 * s_u * t_u + r * t_u**2) / 2,
        p * s_u * s_v + q / 4 * (s_u * t_v + s_v * t_u) + r * t_u * t_v,
        (p * s_v**2 + q / 2 * s_v * t_v + r * t_v**2) / 2,
    ]
    return np.nan_to_num(np.stack(bend, axis=-1))


def _smooth_map(grid: Array, places: Array) -> Array:
    """Return where places (N, 2) on the board, in squares from its first corner, are seen (N, 2).

    A homography, and a polynomial for what the lens adds to it, of a degree for which there are
    twice as many corners as coefficients. NaN where there are too few corners for that.
    """
    seen = np.isfinite(grid[..., 0])
    j, i = np.nonzero(seen)
    known, corners = np.column_stack([i, j]).astype(float), grid[seen]
    degree = max((d for d in range(5) if (d + 1) * (d + 2) <= len(known)), default=0)
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
    """Return where around each corner of a grid grey levels are read (K, 2 P, 2) [px].

    In two strips of P places along its edges; half a turn takes the first of a strip to its last,
    and so on. NaN for a corner without a neighbour in its row or its column.
    """
    (left, above), _, _, (right, below) = quadrants(grid)
    strips = []
    for before, after in ((left, right), (above, below)):
        edge = np.nan_to_num(after) - np.nan_to_num(before)
        length = np.linalg.norm(edge, axis=-1, keepdims=True)
        edge = (edge / np.where(length > 0, length, np.nan)).reshape(-1, 1, 1, 2)
        along = lengths_px[:, None, None, None] * _ALONG[:, None, None] * edge
        aside = half_widths_px[:, None, None, None] * _ASIDE[:, None] * edge[..., ::-1] * (-1, 1)
        strips.append((along + aside).reshape(len(edge), -1, 2))
    return np.concatenate(strips, axis=1)


def _saddles(grey: np.ndarray, corners: Array, strips: Array, bend: Array) -> Array:
    """Return the saddle points (K, 2) near the corners (K, 2); NaN where there is none.

    Each is sought in strips (K, P, 2) and bend (K, 2, 3) of its own; one that leaves the image is
    none.
    """
    refined, uneven = np.full(corners.shape, np.nan), np.full(len(corners), np.nan)
    margin = np.abs(strips).max(axis=1) + 2  # NaN is not inside
    size = np.array(grey.shape[::-1])
    inside = ((corners >= margin) & (corners <= size - 1 - margin)).all(axis=1)
    if not inside.any():
        return refined
    reach = int(np.ceil(margin[inside].max())) + _SPLINE_REACH_PX
    low = np.maximum(np.floor(corners[inside].min(axis=0)).astype(int) - reach, 0)
    high = np.ceil(corners[inside].max(axis=0)).astype(int) + reach + 1
    part = grey[low[1] : high[1], low[0] : high[0]].astype(np.float32)
    # A spline, for cv2.remap's cubic interpolation is off by 0.03 px on a mere ramp of grey.
    spline = spline_filter(cv2.GaussianBlur(part, (0, 0), 0.7), order=3, mode="mirror")
    found, uneven[inside] = _rest(spline, corners[inside] - low, strips[inside], bend[inside])
    refined[inside] = found + low
    refined[uneven > max(UNEVEN, 4 * float(np.nanmedian(uneven)))] = np.nan
    return refined


def _rest(spline: Array, corners: Array, strips: Array, bend: Array) -> tuple[Array, Array]:
    """Return the saddle points (K, 2) of a spline near corners (K, 2), NaN where there is none.

    And (K,) how much the grey levels around each change when turned by half a turn, as a part of
    their contrast.
    """
    u, v = strips[..., 0], strips[..., 1]
    squares = np.stack([u * u, u * v, v * v], axis=-1)
    fit = np.linalg.pinv(np.concatenate([squares, strips, np.ones_like(strips[..., :1])], axis=-1))
    bent = strips + squares @ np.swapaxes(bend, 1, 2)
    refined = corners.copy()
    step = np.zeros_like(corners)
    uneven = np.zeros(len(corners))
    for _ in range(ITERATIONS):
        at = (refined[:, None] + bent).transpose(2, 0, 1)[::-1]
        grey_levels = map_coordinates(spline, at, order=3, prefilter=False, mode="mirror")
        in_strips = grey_levels.reshape(len(grey_levels), 2, -1)
        uneven = np.abs(in_strips - in_strips[..., ::-1]).mean(axis=(1, 2))
        uneven /= np.maximum(np.ptp(grey_levels, axis=1), 1)
        a, b, c, d, e, _ = np.einsum("kip,kp->ik", fit, grey_levels)
        det = 4 * a * c - b * b  # negative at a saddle
        with np.errstate(divide="ignore", invalid="ignore"):
            step = np.stack([b * e - 2 * c * d, b * d - 2 * a * e], axis=-1) / det[:, None]
        step[(det >= 0) | ~(np.abs(step).max(axis=1) <= REACH_PX)] = np.nan
        refined += step
    lost = ~(np.abs(refined - corners).max(axis=1) < REACH_PX)
    lost |= ~(np.abs(step).max(axis=1) < SETTLED_PX)
    return np.where(lost[:, None], np.nan, refined), uneven
