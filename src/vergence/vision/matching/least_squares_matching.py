"""Match windows of two images by least squares, to a few hundredths of a pixel, with covariance.

The displacement is a linear function of the place in the window, along the direction in which depth
displaces (Gruen, "Adaptive least squares correlation", 1985). The covariance is the mean of two:
that of independent pixels times a variance inflation, and the sandwich estimate by clusters of
pixels, the nine parts of the window, since errors other than noise come in groups.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from vergence.arrays import Array

WINDOW_PX = 15
"""Side of a window [px]: noise falls with the size, and the linear change follows most relief."""
_HALF = WINDOW_PX // 2
"""Distance from the middle pixel of a window to its outermost ones [px]."""
_PARTS = 3
"""Clusters of pixels along each side of a window, for the sandwich covariance."""
_IN_PARTS = np.kron(*2 * [np.eye(_PARTS, dtype=np.float32).repeat(WINDOW_PX // _PARTS, axis=0)])
"""(n, 9): the part of a window to which each of its pixels belongs."""
REACH = _HALF + 1
"""Pixels from the middle of a window to its edge, with one more for the slopes."""
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
"""(6, 9): coefficients of 1, x, y, x^2, x y and y^2 from the values at the corners, the middles of
the edges and the middle of a window, row by row."""
_LEAST_GREY = 0.5
"""Standard deviation of the difference of two pixels by rounding [grey levels]."""


@dataclass(frozen=True, eq=False)
class Matched:
    """The positions of N windows of the left view in the right one."""

    pixels: Array
    """(N, 2) in the right view; meaningless where not `good`."""
    covariance: Array
    """(N, 2, 2) [px^2]"""
    good: np.ndarray
    """(N,) bool: the window is in the image, moved little and shows more than noise."""


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
    """Locate windows of the left view in the right image, which is interpolated only once.

    Both are (H, W) grey; right_map is u and v (H, W) of the right view's pixels in the image. The
    middles (N, 2) in the left view are whole pixels; those found in the right view are right to
    half a pixel. Depth displaces along unit vectors (N, 2), and enlarges windows by (N,).
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
    # With the slopes of the mean of both windows one step is exact to the second order.
    by_state = _slopes((template + contrast * shown) / 2, along)
    H = by_state @ np.swapaxes(by_state, 1, 2)
    # The displacement changes by 0.1 px per pixel on a surface at 45 degrees, ten baselines away.
    prior = np.diag(np.array([0, 0, 1, 1], np.float32)) / 0.1**2
    difference = contrast * other - grey
    whole = H + _variance(difference)[..., None] * prior + 1e-3 * np.eye(4, dtype=np.float32)
    # A shift (2), and its change per pixel in x and y.
    state = -np.linalg.solve(whole, by_state @ difference[..., None])
    difference += (by_state.swapaxes(1, 2) @ state)[..., 0]
    covariance, clear = _covariance(by_state, H, difference, prior)
    shift = state[:, :2, 0]
    good = inside & clear & (np.linalg.norm(shift, axis=1) < 1)  # px; else of something else
    return Matched(found + shift, covariance, good)


def _cut_out(image: np.ndarray, at: Array) -> np.ndarray:
    """Cut windows (N, n) float32 about whole pixels (N, 2) out of an image."""
    column, row = at.astype(int).T - REACH
    windows = sliding_window_view(image, 2 * (2 * REACH + 1,))[row, column]
    return windows.reshape(len(at), -1).astype(np.float32)


def _offsets(half: int) -> tuple[np.ndarray, np.ndarray]:
    """Compute x and y (n,) float32 of the pixels of a square window, from its middle."""
    reach = np.arange(-half, half + 1, dtype=np.float32)
    x, y = np.meshgrid(reach, reach)
    return x.ravel(), y.ravel()


def _local_maps(
    maps: tuple[np.ndarray, np.ndarray], middles: np.ndarray, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Approximate the map about points (N, 2) by polynomials of u and v (N, 2, 6).

    Coefficients of 1, x, y, x^2, x y and y^2 of the offsets, exact in the middles. Returns also
    which (N,) windows lie wholly in the view and in an image (H, W).
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
    """Interpolate an image at u and v (N, n)."""
    return cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _contrast(template: np.ndarray, other: np.ndarray) -> np.float32:
    """Estimate the contrast of templates (N, n) over that of other windows (N, n), without means.

    One ratio for all windows, since a camera exposes the whole image alike.
    """
    variances = [np.einsum("ni,ni->n", each, each) for each in (template, other)]
    return np.median(np.sqrt(variances[0] / np.maximum(variances[1], _LEAST_GREY**2)))


def _square(windows: np.ndarray) -> np.ndarray:
    """Reshape windows (N, n) to rows (N, side, side)."""
    side = round(windows.shape[1] ** 0.5)
    return windows.reshape(-1, side, side)


def _inner(windows: np.ndarray) -> np.ndarray:
    """Remove the outermost pixels of windows (N, n), and their means."""
    inner = _square(windows)[:, 1:-1, 1:-1].reshape(len(windows), -1)
    return inner - inner.mean(axis=1, keepdims=True)


def _variance(difference: np.ndarray) -> np.ndarray:
    """Estimate the variance (N, 1) of the differences of pixels of windows (N, n)."""
    squares = np.einsum("ni,ni->n", difference, difference)[:, None]
    return np.maximum(squares / (WINDOW_PX**2 - 5), _LEAST_GREY**2)


def _slopes(windows: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Differentiate windows (N, n) by their displacement and its change: (N, 4, n).

    Without their means, since the windows' brightness is free.
    """
    grey, (x, y) = _square(windows), _offsets(_HALF)
    # In place, since memory access takes most of the time.
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
    by_state: np.ndarray, H: np.ndarray, difference: np.ndarray, prior: np.ndarray
) -> tuple[Array, np.ndarray]:
    """Estimate covariances (N, 2, 2) [px^2] of the displacements; return which are determined."""
    variance = _variance(difference)
    far = float((np.arange(-_HALF, _HALF + 1) ** 2).mean())
    # A slope of the mean image has an eighth of the variance of the difference of two pixels.
    of_noise = WINDOW_PX**2 / 8 * np.diag([1, 1, far, far])
    # The slopes of noise carry no information.
    information = H + variance[..., None] * (prior - of_noise)
    # Sylvester's criterion; eigenvalues take three times as long.
    minors = [np.linalg.det(information[:, :n, :n].astype(float)) for n in range(1, 5)]
    clear = np.min(minors, axis=0) > 0
    information[~clear] = np.eye(4)
    inverse = np.linalg.inv(information)[:, :2]
    independent = inverse[:, :, :2] * variance[..., None]
    by_pixel = (inverse.astype(np.float32) @ by_state) * difference[:, None]
    moved = (by_pixel.reshape(-1, len(_IN_PARTS)) @ _IN_PARTS).reshape(len(H), 2, -1)
    # Nine sums, less the five degrees of freedom of the estimate and the mean.
    of_parts = moved @ np.swapaxes(moved, 1, 2) * (_PARTS**2 / (_PARTS**2 - 5))
    # Interpolation and blur correlate errors over about two pixels each way: variance times 4.
    covariance = (4 * independent + of_parts) / 2
    # Interpolation and perspective leave 0.01 px without noise.
    return covariance.astype(float) + 0.01**2 * np.eye(2), clear
