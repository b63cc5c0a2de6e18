"""Detect a coloured sphere and locate its centre without the bias of its outline.

Off the optical axis the centre of the outline, an ellipse, is not the image of the sphere's centre.
Area and centroid of the ellipse in the plane z = 1, with pixels weighted by the part that the
sphere covers, determine the cone of rays that touch the sphere, and the axis of
the cone passes through the sphere's centre.
"""

from __future__ import annotations

from math import pi, sqrt
from typing import Literal

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera, pixel_area, project, unproject
from vergence.vision.detector import Detection, Detector, pixel_or_nan, windows

COLOURS = ("red", "blue")
STD_PX = 0.1
"""Standard deviation of a sphere's centre [px]: noise, blur and soft shadows."""
_THRESHOLD = 100
"""Colour contrast of a pixel of the sphere [grey levels]: that of a shaded red before wood is
150."""
_MARGIN_PX = 5
"""Width of the background around the sphere that must be visible [px]; edges take two."""
_ERROR_PER_MISFIT = 5.0
"""Error of an occluded sphere's centre over its misfit; at most 5 in tests/test_sphere.py."""
_WHOLE_STD_PX = float(np.hypot(STD_PX, 0.1 * _ERROR_PER_MISFIT))
"""Deviation above which a sphere counts as occluded [px]. The misfit is 0 for drawn whole spheres,
and 0.3 px where 15 % of the diameter are hidden (tests/test_sphere.py)."""
_CONTRAST = np.array([1.0, -0.5, -0.5])
"""Weights of the colours in the contrast of the sphere's colour to the mean of the others."""
_FITTED_PIXELS = 1000
"""Number of inner pixels to which the shading is fitted at most; limits the time."""


def sphere_detector(colour: Literal["red", "blue"] = "red", *, std_px: float = STD_PX) -> Detector:
    """Make a detector of the largest sphere of a colour.

    It reports `std_px`, or for occluded spheres a larger standard deviation. VergenceError for
    another colour.
    """
    if colour not in COLOURS:
        raise VergenceError(f"Spheres are {' or '.join(COLOURS)}, found {colour!r}.")
    planes = (0, 1, 2) if colour == "red" else (2, 1, 0)  # the sphere's colour first

    def detect(image: np.ndarray, camera: Camera, near: Array | None) -> Detection | None:
        for rows, columns in windows(image, near):
            window = _sphere_window(image, planes, rows, columns)
            if window is not None:
                pixel, misfit_px = _centre(image, planes, *window, camera)
                error_px = float(np.hypot(std_px, _ERROR_PER_MISFIT * misfit_px))
                return Detection(pixel, error_px) if np.isfinite(pixel).all() else None
        return None

    return detect


def find_sphere(image: np.ndarray, camera: Camera) -> Array:
    """Locate the centre (2,) [px] of the largest red sphere in an image (H, W, 3) uint8, RGB.

    NaN: not seen as a whole.
    """
    found = sphere_detector()(image, camera, None)
    whole = found is not None and found.std_px <= _WHOLE_STD_PX
    return pixel_or_nan(found if whole else None)


def _sphere_window(
    image: np.ndarray, planes: tuple[int, int, int], rows: slice, columns: slice
) -> tuple[slice, slice] | None:
    """Find rows and columns of the largest region of a colour, with a margin; None: no region."""
    split = cv2.split(image[rows, columns])
    main, second, third = (split[plane] for plane in planes)
    contrast = cv2.subtract(main, cv2.addWeighted(second, 0.5, third, 0.5, 0))
    mask = cv2.threshold(contrast, _THRESHOLD, 255, cv2.THRESH_BINARY)[1]
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    if not outlines:
        return None
    u, v, width, height = cv2.boundingRect(max(outlines, key=cv2.contourArea))
    u0, v0 = columns.start + u - _MARGIN_PX, rows.start + v - _MARGIN_PX
    u1, v1 = u0 + width + 2 * _MARGIN_PX, v0 + height + 2 * _MARGIN_PX
    inside = columns.start <= u0 and rows.start <= v0 and u1 <= columns.stop and v1 <= rows.stop
    enough = cv2.countNonZero(mask[v : v + height, u : u + width]) >= 4  # a cone has 3 unknowns
    return (slice(v0, v1), slice(u0, u1)) if inside and enough else None


def _centre(
    image: np.ndarray, planes: tuple[int, int, int], rows: slice, columns: slice, camera: Camera
) -> tuple[Array, float]:
    """Locate the centre (2,) [px] of the sphere in these rows and columns, and its misfit [px].

    NaN where the region is beyond the lens model or too thin for a sphere.
    """
    nowhere = np.full(2, np.nan), 0.0
    size = max(columns.stop - columns.start, rows.stop - rows.start)
    # Large windows are averaged over 2 x 2 pixels, which is accurate enough and faster.
    block = 1 if size <= 64 else 2
    height, width = ((side.stop - side.start) // block for side in (rows, columns))
    v, u = (
        side.start + block * index + (block - 1) / 2
        for side, index in zip((rows, columns), np.indices((height, width)), strict=True)
    )
    rays = unproject(camera, np.stack([u, v], axis=-1))
    if not np.isfinite(rays).all():
        return nowhere
    areas = block**2 * pixel_area(camera, rays[..., :2])

    def cone(cover: Array) -> tuple[Array, float]:
        weights = cover * areas
        area = float(weights.sum())
        return _cone(np.einsum("ij,ijk->k", weights, rays[..., :2]) / area, area)

    unit = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    pixels = image[rows, columns, planes][: block * height, : block * width]
    window = cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA)
    window = window.astype(np.float32)
    contrast = window @ _CONTRAST
    coloured = contrast > _THRESHOLD
    if not coloured.any():  # the region is thinner than a block
        return nowhere
    usual = float(np.median(contrast[coloured]))
    cover = (contrast > 0.5 * usual).astype(float)
    # Half width of the rim in the image of a sharp camera [px].
    blur_px, outline = 1.6, _outline(unit, *cone(cover))
    for _ in range(2):  # a third time moves the centre by some thousandths of a pixel
        cover = _coverage(window, *outline, blur_px)
        if cover.sum() < 1:
            return nowhere
        blur_px, outline = _edge_width_px(cover), _outline(unit, *cone(cover))
    misfit_px = block * _misfit(window, *outline, blur_px, usual)
    return project(camera, cone(cover)[0]), misfit_px


def _outline(rays: Array, axis: Array, sine: float) -> tuple[Array, np.ndarray]:
    """Compute distances (H, W) [px] of pixels from a sphere's outline, and normals (H, W, 3).

    Distances are positive outside. Normals are those of the surface where rays (H, W, 3) meet it,
    and of its rim where they pass it. `axis` (3,) and `sine`, that of half the opening angle,
    describe the cone of rays that touch the sphere.
    """
    along = rays @ axis
    distance = np.sqrt(np.maximum(1 - along**2, 0))  # the sine of the angle to the axis
    outward = (distance - sine) / np.maximum(np.hypot(*np.gradient(distance)), 1e-9)
    across = 1 / np.maximum(distance, sine)
    towards = np.sqrt(np.maximum(1 - (distance / sine) ** 2, 0)) + along * across
    across, towards = (each.astype(np.float32)[..., None] for each in (across, towards))
    return outward, rays.astype(np.float32) * across - axis.astype(np.float32) * towards


def _cone(centroid: Array, area: float) -> tuple[Array, float]:
    """Compute axis (3,) and sine of half the opening angle of a cone, by its section with z = 1.

    With c the unit axis and s the sine, the section with this centroid and area is an ellipse of
    centre c_xy c_z / (c_z^2 - s^2) and area pi s^2 sqrt(1 - s^2) / (c_z^2 - s^2)^(3/2).
    """
    s2, c_z2, m2 = 0.0, 1.0, float(centroid @ centroid)
    for _ in range(50):  # a contraction by about s^2, which is far below one
        before = s2
        # |c| = 1 makes the first of the two a quadratic equation in c_z^2.
        c_z2 = (1 + 2 * m2 * s2 + sqrt(1 + 4 * m2 * s2 * (1 - s2))) / (2 * (1 + m2))
        s2 = min(area / pi * (c_z2 - s2) ** 1.5 / sqrt(1 - s2), 0.5 * c_z2)
        if abs(s2 - before) < 1e-15:
            break
    c_z = sqrt(c_z2)
    return np.array([*(centroid * (c_z2 - s2) / c_z), c_z]), sqrt(s2)


def _coverage(window: np.ndarray, outward: Array, normals: np.ndarray, edge_px: float) -> Array:
    """Estimate the part (H, W) of each pixel that the sphere covers, by generalised least squares.

    The window (H, W, 3) has the sphere's colour first, `outward` (H, W) are distances [px] from the
    outline, positive outside, and `normals` (H, W, 3) those of the surface. Shading is extrapolated
    from the sphere's inner pixels to its rim; the background is that next to the rim.
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
    prior = 0.5**-2  # of the coverage about that of the previous outline
    cover[rim] = (measured + prior * expected) / (information + prior)
    return cover


def _misfit(
    window: np.ndarray, outward: Array, normals: np.ndarray, edge_px: float, usual: float
) -> float:
    """Measure how far the pixels (H, W, 3) of the sphere's colour deviate from a disc [px].

    It is the width of a ring along the outline with as many pixels as lie on its wrong side by more
    than one: with the colour outside, or without it inside. A pixel has the colour from half of the
    contrast that the shading predicts, or of the `usual` one.
    """
    light = _shading(window, normals, _inside(outward, edge_px)) @ _CONTRAST
    inner = outward < 0
    limit = np.where(inner, np.minimum(light, usual), usual) / 2
    wrong = ((window @ _CONTRAST > limit) != inner) & (np.abs(outward) > 1)
    return float(wrong.sum()) / (2 * sqrt(pi * max(float(inner.sum()), 1.0)))


def _edge_width_px(cover: Array) -> float:
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
    """Average values (H, W, K) with a Gaussian of 1 px over a mask (H, W); 0 beyond its support."""
    weight = where.astype(np.float32)[..., None]
    total, sums = (cv2.GaussianBlur(each, (9, 9), 1.0) for each in (weight, values * weight))
    return sums / np.maximum(total[..., None], 1e-12)


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
