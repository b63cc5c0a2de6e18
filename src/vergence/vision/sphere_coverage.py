"""Estimate which part of each pixel a coloured sphere covers.

The sphere's shading is fitted to its inner pixels and extrapolated to its rim; the background is
that of the pixels next to the rim. The coverage of a pixel of the rim follows by generalised least
squares over its three colours, with the covariance of the background's colours.
"""

from __future__ import annotations

from math import pi, sqrt

import cv2
import numpy as np

from vergence.arrays import Array

EDGE_PX = 1.6
"""Half width of the rim before the blur of the image is estimated [px]: that of a sharp camera."""
CONTRAST = np.array([1.0, -0.5, -0.5])
"""Weights of the colours in the contrast of the sphere's colour to the mean of the others."""
_COVER_STD = 0.5
"""Prior standard deviation of a pixel's coverage about that of the previous outline."""
_NEARBY_PX, _NEARBY_STD_PX = (9, 9), 1.0
"""Support and standard deviation of the Gaussian average of the background next to the rim [px]."""
_FITTED_PIXELS = 1000
"""Number of inner pixels to which the shading is fitted at most; limits the time."""


def coverage(window: np.ndarray, outward: Array, normals: np.ndarray, edge_px: float) -> Array:
    """Estimate the part (H, W) of each pixel that the sphere covers.

    The window (H, W, 3) has the sphere's colour first, `outward` (H, W) are distances [px] from the
    outline, positive outside, and `normals` (H, W, 3) those of the surface.
    """
    inside = _inside(outward, edge_px)
    outside = outward >= min(edge_px, float(outward.max()))  # at least one pixel
    rim = np.abs(outward) < edge_px
    light = _shading(window, normals, inside)
    light = (light + _nearby(window - light, inside))[rim].astype(float)
    background, spread = _background(window, outside, rim)
    expected = np.clip(0.5 - outward[rim] / (2 * edge_px), 0, 1)
    noise = 3.0**2 * np.eye(3)  # grey levels^2, with rounding and fine texture
    covariance = (1 - expected)[:, None, None] ** 2 * spread + noise
    step = light - background
    weights = np.linalg.solve(covariance, step[..., None])[..., 0]
    measured = ((window[rim] - background) * weights).sum(axis=1)
    cover = (outward < 0).astype(float)
    information = (step * weights).sum(axis=1)
    cover[rim] = (measured + expected / _COVER_STD**2) / (information + _COVER_STD**-2)
    return cover


def misfit(
    window: np.ndarray, outward: Array, normals: np.ndarray, edge_px: float, usual: float
) -> float:
    """Measure how far the pixels (H, W, 3) of the sphere's colour deviate from a disc [px].

    It is the width of a ring along the outline with as many pixels as lie on its wrong side by more
    than one: with the colour outside, or without it inside. A pixel has the colour from half of the
    contrast that the shading predicts, or of the `usual` one.
    """
    light = _shading(window, normals, _inside(outward, edge_px)) @ CONTRAST
    inner = outward < 0
    limit = np.where(inner, np.minimum(light, usual), usual) / 2
    wrong = ((window @ CONTRAST > limit) != inner) & (np.abs(outward) > 1)
    return float(wrong.sum()) / (2 * sqrt(pi * max(float(inner.sum()), 1.0)))


def edge_width_px(cover: Array) -> float:
    """Estimate the half width of the rim [px] from the coverage (H, W): two deviations of the blur.

    With a Gaussian blur, c (1 - c) sums up to its standard deviation times the outline's length,
    2 (pi area)^(1/2), over pi^(1/2).
    """
    cover = np.clip(cover, 0, 1)
    std = float((cover * (1 - cover)).sum()) / (2 * sqrt(max(float(cover.sum()), 1.0)))
    return float(np.clip(2 * std, 1.0, 3.5))  # a sharp image, and the window's margin


def _inside(outward: Array, edge_px: float) -> np.ndarray:
    """Find which pixels (H, W) the sphere covers wholly, the innermost one in any case."""
    return np.asarray(outward <= max(-edge_px, float(outward.min())))


def _background(window: np.ndarray, outside: np.ndarray, rim: np.ndarray) -> tuple[Array, Array]:
    """Estimate mean (N, 3) and covariance (N, 3, 3) of the background near each rim pixel."""
    products = (window[..., :, None] * window[..., None, :]).reshape(*window.shape[:2], 9)
    near = _nearby(np.concatenate([window, products], axis=-1), outside)[rim].astype(float)
    mean = near[:, :3]
    spread = near[:, 3:].reshape(-1, 3, 3) - mean[:, :, None] * mean[:, None]
    around = window[outside][:: 1 + np.count_nonzero(outside) // _FITTED_PIXELS]
    around = around - around.mean(axis=0)
    # The few nearest pixels underestimate their own spread.
    return mean, spread + 0.15 * around.T @ around / len(around)


def _nearby(values: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Average values (H, W, K) over the pixels of a mask (H, W) near each pixel; 0 without any."""
    weight = where.astype(np.float32)[..., None]
    total = cv2.GaussianBlur(weight, _NEARBY_PX, _NEARBY_STD_PX)[..., None]
    return cv2.GaussianBlur(values * weight, _NEARBY_PX, _NEARBY_STD_PX) / np.maximum(total, 1e-12)


def _shading(window: np.ndarray, normals: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Fit the sphere's colours (H, W, 3) to its inner pixels and extrapolate them.

    Directed and ambient light make a matt surface's brightness a linear function of its normal.
    """
    inner = np.flatnonzero(inside)
    inner = inner[:: 1 + len(inner) // _FITTED_PIXELS]
    colours, terms = window.reshape(-1, 3)[inner], normals.reshape(-1, 3)[inner]
    mean, middle = colours.mean(axis=0), terms.mean(axis=0)
    terms = terms - middle
    ridge = 2 * np.eye(3, dtype=np.float32)  # a prior for even brightness, of two pixels' weight
    slopes = np.linalg.solve(terms.T @ terms + ridge, terms.T @ (colours - mean))
    return normals @ slopes + (mean - middle @ slopes)
