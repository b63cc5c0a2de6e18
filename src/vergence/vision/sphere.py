"""Detection of a coloured sphere in an image, without the bias of its outline's centre.

The outline of a sphere is an ellipse whose centre is not the image of the sphere's centre: off the
optical axis they differ by a fraction of the sphere's size. Measured are the area and the centroid
of the ellipse in the undistorted plane z = 1, with each pixel weighted by the part of it that the
sphere covers. They determine the cone of rays that touch the sphere, whose axis passes through the
sphere's centre.

A lit sphere is brighter on one side, and what is behind it may have some of its colour. The part of
a pixel that it covers is therefore taken from the shading that its inner pixels show, continued to
its rim, and from the background that is seen beside it. What lies behind the rim itself is not
seen; colours are therefore mixed so that the background around is as even as possible beside the
sphere (Fisher's linear discriminant).

Undistorting every pixel would be slow. The undistorted position is a smooth function of the pixel,
so it is interpolated between Chebyshev points of the sphere's window: each point gets the coverage
of the pixels around it as a weight, and only these points are undistorted.
"""

from __future__ import annotations

from math import pi, sqrt
from typing import Literal

import cv2
import numpy as np
from numpy.polynomial.chebyshev import chebpts2, chebvander

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera, normalise, normalise_area, project
from vergence.vision.detector import Detection, Detector, windows

COLOURS = ("red", "blue")
STD_PX = 0.1
"""Standard deviation of a sphere's centre: more than noise makes, for blur and soft shadows."""
_THRESHOLD = 100  # grey levels of colour contrast above which a pixel belongs to the sphere
_BAND_ROWS = 96  # processed at a time: allocating memory for a whole image is slow
_CONTRAST = np.array([1.0, -0.5, -0.5])  # of the sphere's own colour to the mean of the others
_MARGIN_PX = 3  # for soft edges: blur and anti-aliasing extend over two pixels, plus a reserve
_MIN_PIXELS = 4
_EDGE_PX = 1.9
"""Distance from the outline beyond which a pixel is wholly covered, or not at all."""
_NEARBY = (9, 9)  # pixels across: as far as the edge's outer side is seen from its inner one
_NEARBY_STD_PX = 1.0  # of their weights: the nearest count, since backgrounds are not even
_GREY_NOISE = 3.0
"""Of a pixel in each plane [grey levels], with rounding and textures too fine to be seen."""
_SHADED_PIXELS = 12
"""Least number of inner pixels for which shading is fitted: a smaller sphere is taken as even."""
_FITTED_PIXELS = 1000  # about how many inner pixels of a large sphere are enough
_POINTS = np.asarray(chebpts2(16), dtype=float)
"""Chebyshev points along each side of a window. Near the corner of a wide lens's image they
interpolate windows of 120 px to 1e-10 px, and the whole image to 3e-4 px."""
_COEFFICIENTS = np.linalg.inv(chebvander(_POINTS, len(_POINTS) - 1))
"""Matrix from values at the points to the coefficients of their Chebyshev polynomial."""


def sphere_detector(colour: Literal["red", "blue"] = "red", *, std_px: float = STD_PX) -> Detector:
    """Return a detector of the largest sphere of a colour.

    Args:
        colour: of the sphere.
        std_px: standard deviation of its centre to report.

    Raises:
        VergenceError: spheres of this colour are not detected, or the standard deviation is not
            positive.
    """
    if colour not in COLOURS:
        raise VergenceError(f"Spheres are {' or '.join(COLOURS)}, found {colour!r}.")
    if not std_px > 0:
        raise VergenceError(f"The standard deviation must be above 0 px, found {std_px:g}.")

    def detect(image: np.ndarray, camera: Camera, near: Array | None) -> Detection | None:
        pixel = find_sphere(image, camera, colour=colour, near=near)
        return Detection(pixel, std_px) if np.isfinite(pixel).all() else None

    return detect


def find_sphere(
    image: np.ndarray,
    camera: Camera,
    *,
    colour: Literal["red", "blue"] = "red",
    near: Array | None = None,
) -> Array:
    """Return the pixel (2,) of the centre of a coloured sphere, distortion included.

    For a matt sphere of one colour the centroid is exact, however the camera averages over a pixel,
    since colour contrast is proportional to coverage.

    Args:
        image: (H, W, 3) uint8, RGB.
        camera: intrinsics of the camera that took it.
        colour: of the sphere.
        near: (2,) pixel around which the search begins, which is faster; None or NaN: not known.

    Returns:
        The centre of the largest region of this colour, of those around `near` if one lies
        completely there; NaN if no region of at least four pixels lies completely in the image.
    """
    planes = (0, 1, 2) if colour == "red" else (2, 1, 0)  # the sphere's own colour first
    for rows, columns in windows(image, near):
        window = _sphere_window(image, planes, rows, columns)
        if window is not None:
            return _centre(image, planes, *window, camera)
    return np.full(2, np.nan)


def _sphere_window(
    image: np.ndarray, planes: tuple[int, int, int], rows: slice, columns: slice
) -> tuple[slice, slice] | None:
    """Return the window, with a margin, of the largest region of a colour within these rows."""
    boxes = []
    for top in range(rows.start, rows.stop, _BAND_ROWS):
        band = image[top : min(top + _BAND_ROWS, rows.stop), columns]
        u, v, width, height = cv2.boundingRect(_colour_mask(band, planes))
        if width:
            boxes.append((u, top + v, u + width, top + v + height))
    if not boxes:
        return None
    lefts, tops, rights, bottoms = zip(*boxes, strict=True)
    left, top = columns.start + min(lefts), min(tops)
    mask = _colour_mask(image[top : max(bottoms), left : columns.start + max(rights)], planes)
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    u, v, width, height = cv2.boundingRect(max(outlines, key=cv2.contourArea))
    u0, v0 = left + u - _MARGIN_PX, top + v - _MARGIN_PX
    u1, v1 = left + u + width + _MARGIN_PX, top + v + height + _MARGIN_PX
    whole = columns.start <= u0 and rows.start <= v0 and u1 <= columns.stop and v1 <= rows.stop
    enough = cv2.countNonZero(mask[v : v + height, u : u + width]) >= _MIN_PIXELS
    return (slice(v0, v1), slice(u0, u1)) if whole and enough else None


def _colour_mask(image: np.ndarray, planes: tuple[int, int, int]) -> np.ndarray:
    """Return a mask (H, W) of the pixels whose first plane exceeds the mean of the others."""
    split = cv2.split(image)
    own, *others = (split[plane] for plane in planes)
    contrast = cv2.subtract(own, cv2.addWeighted(others[0], 0.5, others[1], 0.5, 0))
    return cv2.threshold(contrast, _THRESHOLD, 255, cv2.THRESH_BINARY)[1]


def _centre(
    image: np.ndarray, planes: tuple[int, int, int], rows: slice, columns: slice, camera: Camera
) -> Array:
    """Return the centre (2,) [px] of the sphere in these rows and columns; NaN: beyond the lens."""
    cover = _coverage(image[rows, columns, planes].astype(float))
    u, by_u = _interpolation(columns.start, columns.stop)
    v, by_v = _interpolation(rows.start, rows.stop)
    xy = normalise(camera, np.stack(np.broadcast_arrays(u, v[:, None]), axis=-1))
    if not np.isfinite(xy).all():
        return np.full(2, np.nan)
    weights = (by_v.T @ cover @ by_u) * normalise_area(camera, xy)
    area = float(weights.sum())
    if not area > 0:
        return np.full(2, np.nan)
    centroid = weights.ravel() @ xy.reshape(-1, 2) / area
    return project(camera, _cone_axis(centroid, area))


def _coverage(window: Array) -> Array:
    """Return the part (H, W) of each pixel that the sphere covers, from its colours (H, W, 3)."""
    contrast = window @ _CONTRAST
    typical = float(np.median(contrast[contrast > _THRESHOLD]))
    mask = (contrast > 0.5 * typical).astype(np.uint8)
    inside = cv2.distanceTransform(mask, cv2.DIST_L2, 5) > _EDGE_PX
    outside = cv2.distanceTransform(1 - mask, cv2.DIST_L2, 5) > _EDGE_PX
    if inside.any() and outside.any():
        contrast = typical * _discriminant(window, inside, outside)
    light = _shading(contrast, mask, inside, typical)
    light = np.maximum(light + _nearby(contrast - light, inside), 0.5 * typical)
    background = _nearby(contrast, outside)
    edge = (contrast - background) / (light - background)
    return np.where(inside, 1.0, np.where(outside, 0.0, edge))


def _discriminant(window: Array, inside: np.ndarray, outside: np.ndarray) -> Array:
    """Return the mixture (H, W) of the colours (H, W, 3) that tells sphere from background best.

    About 1 on the sphere and 0 in the mean of what surrounds it; linear in the colours, so that it
    is proportional to the coverage as they are.
    """
    around = window[outside][:: 1 + np.count_nonzero(outside) // _FITTED_PIXELS]
    mean = around.mean(axis=0)
    spread = around - mean
    covariance = spread.T @ spread / len(around) + _GREY_NOISE**2 * np.eye(3)
    apart = np.median(window[inside], axis=0) - mean
    weights = np.linalg.solve(covariance, apart)
    return (window - mean) @ (weights / (weights @ apart))


def _nearby(values: Array, where: np.ndarray) -> Array:
    """Return the mean (H, W) of the values near each pixel that are somewhere; 0: none is."""
    weight = cv2.GaussianBlur(where.astype(float), _NEARBY, _NEARBY_STD_PX)
    return cv2.GaussianBlur(values * where, _NEARBY, _NEARBY_STD_PX) / np.maximum(weight, 1e-9)


def _shading(contrast: Array, mask: np.ndarray, inside: np.ndarray, typical: float) -> Array:
    """Return the contrast (H, W) that the sphere has where it covers a pixel, continued outwards.

    Light that comes from one side, or from everywhere, makes a matt surface's brightness a linear
    function of its normal, which is fitted to the inner pixels.
    """
    v, u = (where.astype(float) for where in np.nonzero(inside))
    if len(v) < _SHADED_PIXELS:
        return np.full(contrast.shape, typical)
    moments = cv2.moments(mask, binaryImage=True)
    centre_u, centre_v = moments["m10"] / moments["m00"], moments["m01"] / moments["m00"]
    radius = sqrt(moments["m00"] / pi)

    def normals(v: Array, u: Array) -> Array:
        x, y = (u - centre_u) / radius, (v - centre_v) / radius
        z = np.sqrt(np.maximum(1 - x * x - y * y, 0))
        return np.stack([np.ones_like(x), x, y, z], axis=-1)

    some = slice(None, None, 1 + len(v) // _FITTED_PIXELS)
    v, u = v[some], u[some]
    light = np.linalg.lstsq(normals(v, u), contrast[inside][some], rcond=None)[0]
    rows, columns = np.indices(contrast.shape).astype(float)
    return normals(rows, columns) @ light


def _interpolation(begin: int, end: int) -> tuple[Array, Array]:
    """Return Chebyshev points (K,) of the pixels from begin to end, and weights (N, K).

    They give a polynomial's values at the pixels from those at the points, for degrees below K.
    """
    middle, half = (begin + end - 1) / 2, (end - 1 - begin) / 2
    pixels = (np.arange(begin, end) - middle) / half
    return middle + half * _POINTS, chebvander(pixels, len(_POINTS) - 1) @ _COEFFICIENTS


def _cone_axis(centroid: Array, area: float) -> Array:
    """Return the unit axis (3,) of the cone whose section with z = 1 has this centroid and area.

    With c the axis and s the sine of half the opening angle, the ellipse has the centre
    c_xy c_z / (c_z^2 - s^2) and the area pi s^2 sqrt(1 - s^2) / (c_z^2 - s^2)^(3/2).
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
    return np.array([*(centroid * (c_z2 - s2) / c_z), c_z])
