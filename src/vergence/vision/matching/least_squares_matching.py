"""Least-squares matching of windows in two images, to a few hundredths of a pixel, with covariance.

What a window shows is seldom at one depth: on an inclined surface the displacement changes across
the window, and a tracker that only shifts it takes part of that change for a shift across the
epipolar line. So the displacement is a linear function of the place in the window, along the
direction in which depth displaces (Gruen, "Adaptive least squares correlation", 1985). Slopes are
those of the mean of both images: neither is preferred, and the noise of the slopes does not share
that of the difference.

Pixels that differ by something other than noise, as behind the edge of a nearer thing, differ in
groups. The covariance is therefore the mean of two: that of independent pixels times the usual
variance inflation, and the window's own by the sums over its nine parts (the sandwich formula for
clusters), which alone would be too uncertain.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from vergence.arrays import Array

WINDOW_PX = 15
"""Large, since noise falls with the size, and the linear change allows for most of the relief."""
_HALF = WINDOW_PX // 2
_PARTS = 3
"""Clusters of pixels along each side of a window."""
_IN_PARTS = np.kron(*2 * [np.eye(_PARTS, dtype=np.float32).repeat(WINDOW_PX // _PARTS, axis=0)])
"""(n, 9): which part of a window each of its pixels is in."""
REACH = _HALF + 1
"""From the middle of a window to its edge, with one pixel more for the slopes."""
_DIFFERENCES = np.array(
    [
        [0, 0, 0, 0, 1, 0, 0, 0, 0],
        [0, 0, 0, -1 / 2, 0, 1 / 2, 0, 0, 0],
        [0, -1 / 2, 0, 0, 0, 0, 0, 1 / 2, 0],
        [0, 0, 0, 1 / 2, -1, 1 / 2, 0, 0, 0],
        [1 / 4, 0, -1 / 4, 0, 0, 0, -1 / 4, 0, 1 / 4],
        [0, 1 / 2, 0, 0, -1, 0, 0, 1 / 2, 0],
    ],
    np.float32,
) / np.array([1, REACH, REACH, *3 * [REACH**2]], np.float32).reshape(-1, 1)
"""(6, 9): the polynomial of 1, x, y, x^2, x y and y^2 by its values at the middle of a window, the
middles of its edges and its corners, row by row."""
_INFLATION = 4.0
"""Variance inflation of a window's displacement by correlated differences (design effect): the
images' errors are smooth over about two pixels, by interpolation and by blur."""
_LARGEST_CHANGE_PX = 1.0
"""From where tracking ended: beyond, something else was found."""
_SLOPE_STD = 0.1
"""Change of the displacement per pixel: of a surface inclined by 45 degrees, ten baselines away."""
_LEAST_GREY = 0.5
"""Standard deviation of the difference of two pixels [grey levels], of rounding alone."""
_FLOOR_PX = 0.01
"""Standard deviation that interpolation and perspective leave of a match without any noise."""
_SLOPE_NOISE = 1 / 8
"""Variance of a slope of the mean image, per variance of the difference of two pixels."""


@dataclass(frozen=True, eq=False)
class Matched:
    """Where N windows of the left view were found."""

    pixels: Array
    """(N, 2) in the right view; of no meaning where not `good`."""
    covariance: Array
    """(N, 2, 2) [px^2] of them."""
    good: np.ndarray
    """(N,) bool: lie in the image, moved little, and show more than noise."""


def match_windows(
    left: np.ndarray,
    right: np.ndarray,
    right_map: tuple[np.ndarray, np.ndarray],
    *,
    at: Array,
    found: Array,
    direction: Array,
    enlargement: Array,
) -> Matched:
    """Return where windows of the left view are in the right one.

    Args:
        left: (H, W) the left view, grey.
        right: (H, W) the right image, not turned, grey: interpolated once only.
        right_map: u and v (H, W) float32 in it, where the pixels of the right view lie.
        at: (N, 2) middles of the windows in the left view, which shows all of each; whole pixels.
        found: (N, 2) about where they are in the right view, to half a pixel.
        direction: (N, 2) unit vectors along which depth displaces in the view.
        enlargement: (N,) by what share the windows are larger in the right view, for being nearer.
    """
    if not len(at):
        return Matched(np.empty((0, 2)), np.empty((0, 2, 2)), np.zeros(0, bool))
    x, y = _offsets(REACH)
    along = direction.astype(np.float32)
    larger = enlargement.astype(np.float32)[:, None, None] * np.eye(2, dtype=np.float32)
    template, right = _cut_out(left, at), right.astype(np.float32)
    maps, inside = _local_maps(right_map, found.astype(np.float32), right.shape)
    maps[:, :, 1:3] += maps[:, :, 1:3] @ larger
    powers = np.stack([np.ones_like(x), x, y, x**2, x * y, y**2])
    shown = _sampled(right, *(np.swapaxes(maps, 0, 1) @ powers))
    grey, other = _inner(template), _inner(shown)
    contrast = _contrast(grey, other)
    # With slopes of both windows one step is exact to the second order. In rendered rooms more make
    # depth no steadier; a wall at three baselines would be matched a quarter more exactly.
    by_state = _slopes((template + contrast * shown) / 2, along)
    H = by_state @ np.swapaxes(by_state, 1, 2)
    prior = np.diag(np.array([0, 0, 1, 1], np.float32)) / _SLOPE_STD**2
    apart = contrast * other - grey
    whole = H + _variance(apart)[..., None] * prior + 1e-3 * np.eye(4, dtype=np.float32)
    # A shift (2), and its change per pixel in x and y.
    state = -np.linalg.solve(whole, by_state @ apart[..., None])
    apart += (by_state.swapaxes(1, 2) @ state)[..., 0]
    covariance, clear = _covariance(by_state, H, apart, prior)
    shift = state[:, :2, 0]
    good = inside & clear & (np.linalg.norm(shift, axis=1) < _LARGEST_CHANGE_PX)
    return Matched(found + shift, covariance, good)


def _cut_out(image: np.ndarray, at: Array) -> np.ndarray:
    """Return the windows (N, n) float32 of an image about whole pixels (N, 2)."""
    column, row = at.astype(int).T - REACH
    windows = sliding_window_view(image, 2 * (2 * REACH + 1,))[row, column]
    return windows.reshape(len(at), -1).astype(np.float32)


def _offsets(half: int) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y (n,) of the pixels of a square window from its middle, float32."""
    reach = np.arange(-half, half + 1, dtype=np.float32)
    x, y = np.meshgrid(reach, reach)
    return x.ravel(), y.ravel()


def _local_maps(
    maps: tuple[np.ndarray, np.ndarray], middles: np.ndarray, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return polynomials (N, 2, 6) of u and v about points (N, 2) of a view, and which are inside.

    By 1, x, y, x^2, x y and y^2 of the offsets from these: through their middles, where matches are
    taken back, and with differences to the ends of the windows. Inside (N,) are those whose windows
    are in the view, and in an image (H, W), as a whole.
    """
    x, y = (REACH * each for each in _offsets(1))
    last = np.array(maps[0].shape[::-1]) - 1
    in_view = np.all((middles >= REACH) & (middles <= last - REACH), axis=1)
    values = [_sampled(each, middles[:, :1] + x, middles[:, 1:] + y) for each in maps]
    lowest, highest = (np.stack([end(each, axis=1) for each in values]) for end in (np.min, np.max))
    inside = (lowest >= 0) & (highest <= np.array(shape[::-1])[:, None] - 1)
    inside = np.asarray(in_view & inside.all(axis=0))
    return np.stack([each @ _DIFFERENCES.T for each in values], axis=1), inside


def _sampled(image: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the values (N, n) of an image at u and v (N, n), between its pixels."""
    return cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _contrast(template: np.ndarray, other: np.ndarray) -> np.float32:
    """Return the contrast of templates (N, n) over that of other windows (N, n), less their means.

    One ratio for all of them: cameras expose a whole image alike.
    """
    variances = [np.einsum("ni,ni->n", each, each) for each in (template, other)]
    return np.median(np.sqrt(variances[0] / np.maximum(variances[1], _LEAST_GREY**2)))


def _square(windows: np.ndarray) -> np.ndarray:
    """Return windows (N, n) row by row (N, side, side)."""
    side = round(windows.shape[1] ** 0.5)
    return windows.reshape(-1, side, side)


def _inner(windows: np.ndarray) -> np.ndarray:
    """Return windows (N, n) without their outermost pixels, less their means."""
    inner = _square(windows)[:, 1:-1, 1:-1].reshape(len(windows), -1)
    return inner - inner.mean(axis=1, keepdims=True)


def _variance(apart: np.ndarray) -> np.ndarray:
    """Return the variance (N, 1) of the differences of the pixels of windows (N, n)."""
    squares = np.einsum("ni,ni->n", apart, apart)[:, None]
    return np.maximum(squares / (WINDOW_PX**2 - 5), _LEAST_GREY**2)


def _slopes(windows: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return derivatives (N, 4, n) of windows (N, n) by their displacement and its change.

    Less their means, since the windows' brightness is free.
    """
    grey, (x, y) = _square(windows), _offsets(_HALF)
    # In place, since memory takes the time.
    slopes = np.empty((4, len(windows), WINDOW_PX**2), np.float32)
    np.subtract(grey[:, 1:-1, 2:], grey[:, 1:-1, :-2], out=_square(slopes[0]))
    np.subtract(grey[:, 2:, 1:-1], grey[:, :-2, 1:-1], out=_square(slopes[1]))
    slopes[:2] *= np.float32(0.5)
    by_depth = along[:, :1] * slopes[0] + along[:, 1:] * slopes[1]
    np.multiply(by_depth, x, out=slopes[2])
    np.multiply(by_depth, y, out=slopes[3])
    slopes -= slopes.mean(axis=2, keepdims=True)
    return np.swapaxes(slopes, 0, 1)


def _covariance(
    by_state: np.ndarray,
    H: np.ndarray,
    apart: np.ndarray,
    prior: np.ndarray,
) -> tuple[Array, np.ndarray]:
    """Return covariances (N, 2, 2) [px^2] of the displacements, and which are determined."""
    variance = _variance(apart)
    far = float((np.arange(-_HALF, _HALF + 1) ** 2).mean())
    of_noise = WINDOW_PX**2 * _SLOPE_NOISE * np.diag([1, 1, far, far])
    # The slopes of noise determine nothing.
    information = H + variance[..., None] * (prior - of_noise)
    clear = _positive_definite(information)
    information[~clear] = np.eye(4)
    inverse = np.linalg.inv(information)[:, :2]
    independent = inverse[:, :, :2] * variance[..., None]
    by_pixel = (inverse.astype(np.float32) @ by_state) * apart[:, None]
    moved = (by_pixel.reshape(-1, len(_IN_PARTS)) @ _IN_PARTS).reshape(len(H), 2, -1)
    # Nine sums, of which the estimate and the mean have taken five.
    of_parts = moved @ np.swapaxes(moved, 1, 2) * (_PARTS**2 / (_PARTS**2 - 5))
    covariance = (_INFLATION * independent + of_parts) / 2
    return covariance.astype(float) + _FLOOR_PX**2 * np.eye(2), clear


def _positive_definite(matrices: np.ndarray) -> np.ndarray:
    """Return which symmetric matrices (N, n, n) are: those all of whose pivots are positive.

    Their eigenvalues would take three times as long.
    """
    left: np.ndarray = matrices.copy()
    definite = np.ones(len(left), bool)
    for _ in range(left.shape[1]):
        pivot = left[:, :1, :1]
        definite &= pivot[:, 0, 0] > 0
        row: np.ndarray = left[:, :1, 1:] / np.where(definite[:, None, None], pivot, 1.0)
        left = left[:, 1:, 1:] - left[:, 1:, :1] @ row
    return definite
