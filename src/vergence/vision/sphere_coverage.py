"""Which part of each pixel a coloured sphere covers.

A lit sphere is brighter on one side, and what is behind it may have some of its colour. The part of
a pixel that it covers is therefore taken from the shading that its inner pixels show, continued to
its rim, and from the background that is seen beside it. What lies behind the rim itself is not
seen; the three colours of a pixel of the rim are therefore weighted so that the background beside
it is as even as possible (generalised least squares, with the covariance of its colours).
"""

from __future__ import annotations

from math import pi, sqrt

import cv2
import numpy as np

from vergence.arrays import Array

EDGE_PX = 1.6
"""Distance from the outline beyond which a pixel is wholly covered, or not at all, until the blur
of the image is known from its coverage."""
_NARROWEST_PX, _WIDEST_PX = 1.0, 3.5  # limits of it: sharp images, and what the margin leaves
CONTRAST = np.array([1.0, -0.5, -0.5])  # of the sphere's own colour to the mean of the others
_COVER_STD = 0.5
"""Prior standard deviation of a pixel's coverage about that of the previous outline."""
_NEARBY = (9, 9)  # pixels across: as far as the edge's outer side is seen from its inner one
_NEARBY_STD_PX = 1.0  # of their weights: the nearest count, since backgrounds are not even
_GREY_NOISE = 3.0
"""Noise of a pixel in each plane [grey levels], with rounding and textures too fine to be seen."""
_SHARE = 0.15
"""Share of the spread of all that surrounds the sphere, by which the background of a pixel of its
rim may differ from what is seen beside it."""
_SHADING_PIXELS = 2.0
"""Ridge on the slopes of the shading, in pixels: even brightness is expected."""
_FITTED_PIXELS = 1000  # about how many inner pixels of a large sphere are enough


def coverage(window: np.ndarray, outward: Array, normals: np.ndarray, edge_px: float) -> Array:
    """Return the part (H, W) of each pixel that the sphere covers, from its colours (H, W, 3)."""
    inside = _inside(outward, edge_px)
    # One pixel at least, of what is no sphere too.
    outside = outward >= min(edge_px, float(outward.max()))
    rim = np.abs(outward) < edge_px
    light = _shading(window, normals, inside)
    light = (light + _nearby(window - light, inside))[rim].astype(float)
    background, spread = _background(window, outside, rim)
    expected = np.clip(0.5 - outward[rim] / (2 * edge_px), 0, 1)
    covariance = (1 - expected)[:, None, None] ** 2 * spread + _GREY_NOISE**2 * np.eye(3)
    apart = light - background
    pull = np.linalg.solve(covariance, apart[..., None])[..., 0]
    seen = ((window[rim] - background) * pull).sum(axis=1)
    cover = (outward < 0).astype(float)
    cover[rim] = (seen + expected / _COVER_STD**2) / ((apart * pull).sum(axis=1) + _COVER_STD**-2)
    return cover


def misfit(
    window: np.ndarray, outward: Array, normals: np.ndarray, edge_px: float, usual: float
) -> float:
    """Return by how much the pixels (H, W, 3) of the sphere's colour do not fill its outline.

    As the width, in pixels, of a ring along the outline that has as many pixels as are on its wrong
    side by more than one: beyond it with the colour, or within it without. A pixel has the colour
    from half of the contrast that the sphere has there by its shading, or of the usual one.
    """
    light = _shading(window, normals, _inside(outward, edge_px)) @ CONTRAST
    inner = outward < 0
    wanted = np.where(inner, np.minimum(light, usual), usual) / 2
    wrong = ((window @ CONTRAST > wanted) != inner) & (np.abs(outward) > 1)
    return float(wrong.sum()) / (2 * sqrt(pi * max(float(inner.sum()), 1.0)))


def _inside(outward: Array, edge_px: float) -> np.ndarray:
    """Return which pixels (H, W) the sphere covers wholly: at least its innermost one."""
    return np.asarray(outward <= max(-edge_px, float(outward.min())))


def _background(window: np.ndarray, outside: np.ndarray, rim: np.ndarray) -> tuple[Array, Array]:
    """Return mean (N, 3) and covariance (N, 3, 3) of what is behind the N pixels of the rim.

    Of what is seen beside it; a share of the spread of all that surrounds the sphere is added,
    since the few pixels that are near tell their own spread badly.
    """
    products = (window[..., :, None] * window[..., None, :]).reshape(*window.shape[:2], 9)
    near = _nearby(np.concatenate([window, products], axis=-1), outside)[rim].astype(float)
    mean = near[:, :3]
    spread = near[:, 3:].reshape(-1, 3, 3) - mean[:, :, None] * mean[:, None]
    around = window[outside][:: 1 + np.count_nonzero(outside) // _FITTED_PIXELS]
    around = around - around.mean(axis=0)
    return mean, spread + _SHARE * around.T @ around / len(around)


def _nearby(values: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Return the mean (H, W, K) of the values near each pixel that are somewhere; 0: none is."""
    weight = where.astype(np.float32)[..., None]
    total = cv2.GaussianBlur(weight, _NEARBY, _NEARBY_STD_PX)[..., None]
    return cv2.GaussianBlur(values * weight, _NEARBY, _NEARBY_STD_PX) / np.maximum(total, 1e-12)


def _shading(window: np.ndarray, normals: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Return the colours (H, W, 3) of the sphere where it covers a pixel, continued outwards.

    Light that comes from one side, or from everywhere, makes a matt surface's brightness a linear
    function of its normal, which is fitted to the inner pixels. The fewer they are, the more it
    is held back: those of a small sphere show little of what the rim is like.
    """
    some = np.flatnonzero(inside)
    some = some[:: 1 + len(some) // _FITTED_PIXELS]
    seen, terms = window.reshape(-1, 3)[some], normals.reshape(-1, 3)[some]
    mean, middle = seen.mean(axis=0), terms.mean(axis=0)
    terms = terms - middle
    held = _SHADING_PIXELS * np.eye(3, dtype=np.float32)
    slopes = np.linalg.solve(terms.T @ terms + held, terms.T @ (seen - mean))
    return normals @ slopes + (mean - middle @ slopes)


def edge_width_px(cover: Array) -> float:
    """Return how far the outline is blurred to either side [px], from the coverage (H, W).

    With a Gaussian blur, c (1 - c) sums up to its standard deviation times the outline's length,
    2 (pi area)^(1/2), over pi^(1/2). Two standard deviations hold all that matters.
    """
    cover = np.clip(cover, 0, 1)
    std = float((cover * (1 - cover)).sum()) / (2 * sqrt(max(float(cover.sum()), 1.0)))
    return min(max(2 * std, _NARROWEST_PX), _WIDEST_PX)
