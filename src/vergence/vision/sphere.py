"""Detection of a coloured sphere in an image, without the bias of its outline's centre.

The outline of a sphere is an ellipse whose centre is not the image of the sphere's centre: off the
optical axis they differ by a fraction of the sphere's size. Measured are the area and the centroid
of the ellipse in the undistorted plane z = 1, with each pixel weighted by the part of it that the
sphere covers. They determine the cone of rays that touch the sphere, whose axis passes through the
sphere's centre.

Which part of a pixel is covered is told by the colours of the inner pixels (`sphere_coverage`), and
which pixels are inner ones by the outline itself: a first one from the colour alone, and one better
one suffice. Where something hides a part of the sphere, what is left is no disc, and its
middle is not the sphere's. By how much it is no disc tells about how wrong that may be.

Undistorting every pixel would be slow. The undistorted position is a smooth function of the pixel,
so it is interpolated between Chebyshev points of the sphere's window, which alone are undistorted;
for sums over pixels, each point gets the coverage of the pixels around it as a weight.
"""

from __future__ import annotations

from math import pi, sqrt
from typing import Literal

import cv2
import numpy as np
from numpy.polynomial.chebyshev import chebpts2, chebvander

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera, normalise, pixel_area, project
from vergence.vision.detector import Detection, Detector, windows
from vergence.vision.sphere_coverage import CONTRAST, EDGE_PX, coverage, edge_width_px, misfit

COLOURS = ("red", "blue")
STD_PX = 0.1
"""Standard deviation of a sphere's centre: more than noise makes, for blur and soft shadows."""
_THRESHOLD = 100  # grey levels of colour contrast above which a pixel belongs to the sphere
_BAND_ROWS = 96  # processed at a time: allocating memory for a whole image is slow
_MARGIN_PX = 5  # soft edges take two pixels; beyond them the background must be seen
_MIN_PIXELS = 4
_LARGEST_WINDOW = 64  # pixels across; a larger one is seen in blocks of 2 x 2 pixels
_ROUNDS = 2
"""How often coverage and outline are estimated; more rounds change some thousandths of a pixel."""
_LARGEST_MISFIT_PX = 0.1
"""From here on a part of a sphere is hidden. Drawn ones that are whole have a misfit of 0, lit from
one side or blurred by five pixels of motion; those of 28 and 56 px of which 15 % of the diameter
are hidden one of 0.3 and 0.4. Where less is hidden, the centre is wrong by less than a pixel."""
_MISLEADS = 5.0
"""Error of the centre per misfit: 3.6 to 5 in those spheres, with up to half of them hidden."""
_POINTS = np.asarray(chebpts2(16), dtype=float)
"""Chebyshev points along each side of a window. Near the corner of a wide lens's image they
interpolate windows of 120 px to 1e-10 px, and the whole image to 3e-4 px."""
_COEFFICIENTS = np.linalg.inv(chebvander(_POINTS, len(_POINTS) - 1))
"""Matrix from values at the points to the coefficients of their Chebyshev polynomial."""


def sphere_detector(colour: Literal["red", "blue"] = "red", *, std_px: float = STD_PX) -> Detector:
    """Return a detector of the largest sphere of a colour.

    Args:
        colour: of the sphere.
        std_px: standard deviation of its centre to report; that of one that is hidden in part is
            larger, by how wrong its centre may be.

    Raises:
        VergenceError: spheres of this colour are not detected, or the standard deviation is not
            positive.
    """
    if colour not in COLOURS:
        raise VergenceError(f"Spheres are {' or '.join(COLOURS)}, found {colour!r}.")
    if not std_px > 0:
        raise VergenceError(f"The standard deviation must be above 0 px, found {std_px:g}.")

    def detect(image: np.ndarray, camera: Camera, near: Array | None) -> Detection | None:
        pixel, misfit_px = _found(image, camera, colour, near)
        if not np.isfinite(pixel).all():
            return None
        return Detection(pixel, float(np.hypot(std_px, _MISLEADS * misfit_px)))

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
        completely there; NaN if no region of at least four pixels lies completely in the image, or
        a part of it is hidden.
    """
    pixel, misfit_px = _found(image, camera, colour, near)
    return pixel if misfit_px <= _LARGEST_MISFIT_PX else np.full(2, np.nan)


def _found(
    image: np.ndarray, camera: Camera, colour: str, near: Array | None
) -> tuple[Array, float]:
    """Return the centre (2,) of a sphere, or NaN, and by how much it is no disc [px]."""
    planes = (0, 1, 2) if colour == "red" else (2, 1, 0)  # the sphere's own colour first
    for rows, columns in windows(image, near):
        window = _sphere_window(image, planes, rows, columns)
        if window is not None:
            return _centre(image, planes, *window, camera)
    return np.full(2, np.nan), 0.0


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
) -> tuple[Array, float]:
    """Return the centre (2,) [px] of the sphere in these rows and columns, and its misfit [px].

    NaN: it is beyond the lens, or no sphere.
    """
    # Blocks of pixels show a large sphere exactly enough, in less time; they are its pixels below.
    size = max(columns.stop - columns.start, rows.stop - rows.start)
    block = 1 if size <= _LARGEST_WINDOW else 2
    u, by_u = _interpolation(columns.start, columns.stop, block)
    v, by_v = _interpolation(rows.start, rows.stop, block)
    xy = normalise(camera, np.stack(np.broadcast_arrays(u, v[:, None]), axis=-1))
    if not np.isfinite(xy).all():
        return np.full(2, np.nan), 0.0
    areas = block**2 * pixel_area(camera, xy)

    def cone(cover: Array) -> tuple[Array, float]:
        weights = (by_v.T @ cover @ by_u) * areas
        area = float(weights.sum())
        return _cone(weights.ravel() @ xy.reshape(-1, 2) / area, area)

    rays = np.stack([by_v @ each @ by_u.T for each in (xy[..., 0], xy[..., 1])], axis=-1)
    rays = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    whole = image[rows, columns, planes][: block * len(by_v), : block * len(by_u)]
    window = cv2.resize(whole, (len(by_u), len(by_v)), interpolation=cv2.INTER_AREA)
    window = window.astype(np.float32)
    contrast = window @ CONTRAST
    red = contrast > _THRESHOLD
    if not red.any():  # in no block: it is thinner than one
        return np.full(2, np.nan), 0.0
    usual = float(np.median(contrast[red]))
    cover = (contrast > 0.5 * usual).astype(float)
    blur_px, outline = EDGE_PX, _surface(rays, *cone(cover))
    for _ in range(_ROUNDS):
        cover = coverage(window, *outline, blur_px)
        if cover.sum() < 1:  # of a pixel: this is no sphere
            return np.full(2, np.nan), 0.0
        blur_px, outline = edge_width_px(cover), _surface(rays, *cone(cover))
    misfit_px = block * misfit(window, *outline, blur_px, usual)
    return project(camera, cone(cover)[0]), misfit_px


def _surface(rays: Array, axis: Array, sine: float) -> tuple[Array, np.ndarray]:
    """Return how far pixels are outside of a sphere's outline (H, W) [px], and normals (H, W, 3).

    Of the cone of rays that touch the sphere, `axis` (3,) is the axis and `sine` that of half the
    opening angle. The unit normals are those of the surface where rays (H, W, 3) meet it, and of
    its rim where they pass it.
    """
    along = rays @ axis
    distance = np.sqrt(np.maximum(1 - along**2, 0))  # the sine of the angle to the axis
    outward = (distance - sine) / np.maximum(np.hypot(*np.gradient(distance)), 1e-9)
    across = 1 / np.maximum(distance, sine)
    towards = np.sqrt(np.maximum(1 - (distance / sine) ** 2, 0)) + along * across
    across, towards = (each.astype(np.float32)[..., None] for each in (across, towards))
    return outward, rays.astype(np.float32) * across - axis.astype(np.float32) * towards


def _interpolation(begin: int, end: int, block: int) -> tuple[Array, Array]:
    """Return Chebyshev points (K,) of the pixels from begin to end, and weights (N, K).

    They give a polynomial's values in the middles of blocks of pixels, as many as are whole, from
    those at the points, for degrees below K.
    """
    middle, half = (begin + end - 1) / 2, (end - 1 - begin) / 2
    pixels = begin + block * np.arange((end - begin) // block) + (block - 1) / 2
    powers = chebvander((pixels - middle) / half, len(_POINTS) - 1)
    return middle + half * _POINTS, powers @ _COEFFICIENTS


def _cone(centroid: Array, area: float) -> tuple[Array, float]:
    """Return axis (3,) and sine of half the opening angle of a cone, by its section with z = 1.

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
