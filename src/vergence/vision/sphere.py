"""Find a coloured sphere in an image, without the bias of its outline's centre.

The outline of a sphere is an ellipse whose centre is not the image of the sphere's centre: off
the optical axis the two differ by a fraction of the sphere's own size. What is measured is the
area and the centroid of the ellipse in the undistorted plane z = 1, from all pixels weighted by
how much of each the sphere covers; both follow from the cone of rays that touch the sphere, and
the cone's axis goes through its centre.

Where a pixel comes to lie in that plane is a smooth function of it. It is interpolated between
Chebyshev points of the sphere's window, which gives each of those points a weight, the cover that
falls to it, and spares a solution of the lens's polynomial for each pixel.
"""

from __future__ import annotations

from math import pi, sqrt
from typing import Literal

import cv2
import numpy as np
from numpy.polynomial.chebyshev import chebpts2, chebvander

from vergence.arrays import Array
from vergence.geometry.camera import Camera, normalise, normalise_area, project

_HALF = 100  # grey levels of redness above which a pixel belongs to the sphere for certain
_BAND_ROWS = 96  # at a time: memory for a whole image comes from the system, and slowly
_NEAR = 0.2  # of the image's width: how far around the place where it is sought first
_MARGIN_PX = 3  # for soft edges: blur and anti-aliasing reach two pixels, and one for luck
_FEWEST = 4  # pixels
_POINTS = np.asarray(chebpts2(16), dtype=float)
"""Along each side of a window. In a wide lens's corner they interpolate windows of 120 px to 1e-10
px, and all of its image to 3e-4 px."""
_COEFFICIENTS = np.linalg.inv(chebvander(_POINTS, len(_POINTS) - 1))
"""Of the polynomial through values at the points, by the values."""


def find_sphere(
    image: np.ndarray,
    camera: Camera,
    *,
    colour: Literal["red", "blue"] = "red",
    near: Array | None = None,
) -> Array:
    """Return the pixel (2,) of the centre of a coloured sphere, distortion included.

    The centroid is exact for a sphere of one flat colour before a grey background, however the
    camera averages over its pixels, since coverage then enters linearly.

    Args:
        image: (H, W, 3) uint8, RGB.
        camera: intrinsics of the camera that took it.
        colour: of the sphere.
        near: (2,) px where it is sought first, which is faster; NaN: that is not known.

    Returns:
        NaN where no region of this colour, of four pixels or more lies wholly within the image.
        The largest counts, of those around `near` if one lies wholly there.
    """
    planes = (0, 1, 2) if colour == "red" else (2, 1, 0)  # its own first; the others count alike
    window = None
    if near is not None and np.isfinite(near).all():
        window = _window(image, planes, *_around(near, image))
    if window is None:
        window = _window(image, planes, slice(0, image.shape[0]), slice(0, image.shape[1]))
    return np.full(2, np.nan) if window is None else _centre(image, planes, *window, camera)


def _around(pixel: Array, image: np.ndarray) -> tuple[slice, slice]:
    """Return the rows and columns of an image around a pixel."""
    height, width = image.shape[:2]
    reach = round(_NEAR * width)
    u, v = pixel.round().astype(int)
    rows = slice(max(v - reach, 0), min(v + reach, height))
    return rows, slice(max(u - reach, 0), min(u + reach, width))


def _window(
    image: np.ndarray, planes: tuple[int, int, int], rows: slice, columns: slice
) -> tuple[slice, slice] | None:
    """Return rows and columns around the largest region of a colour; None: it is not whole.

    With a margin for its soft edge. Only these rows and columns of the image are looked at.
    """
    boxes = []
    for top in range(rows.start, rows.stop, _BAND_ROWS):
        band = image[top : min(top + _BAND_ROWS, rows.stop), columns]
        u, v, width, height = cv2.boundingRect(_coloured(band, planes))
        if width:
            boxes.append((u, top + v, u + width, top + v + height))
    if not boxes:
        return None
    lefts, tops, rights, bottoms = zip(*boxes, strict=True)
    left, top = columns.start + min(lefts), min(tops)
    mask = _coloured(image[top : max(bottoms), left : columns.start + max(rights)], planes)
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    u, v, width, height = cv2.boundingRect(max(outlines, key=cv2.contourArea))
    u0, v0 = left + u - _MARGIN_PX, top + v - _MARGIN_PX
    u1, v1 = left + u + width + _MARGIN_PX, top + v + height + _MARGIN_PX
    whole = columns.start <= u0 and rows.start <= v0 and u1 <= columns.stop and v1 <= rows.stop
    enough = cv2.countNonZero(mask[v : v + height, u : u + width]) >= _FEWEST
    return (slice(v0, v1), slice(u0, u1)) if whole and enough else None


def _coloured(image: np.ndarray, planes: tuple[int, int, int]) -> np.ndarray:
    """Return a mask (H, W) of the pixels in which the first of the planes stands out."""
    split = cv2.split(image)
    own, *others = (split[plane] for plane in planes)
    redness = cv2.subtract(own, cv2.addWeighted(others[0], 0.5, others[1], 0.5, 0))
    return cv2.threshold(redness, _HALF, 255, cv2.THRESH_BINARY)[1]


def _centre(
    image: np.ndarray, planes: tuple[int, int, int], rows: slice, columns: slice, camera: Camera
) -> Array:
    """Return the centre (2,) px of the sphere in these rows and columns; NaN: beyond the lens."""
    own, *others = np.moveaxis(image[rows, columns, planes].astype(float), -1, 0)
    redness = own - 0.5 * (others[0] + others[1])
    cover = redness / np.median(redness[redness > _HALF])
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


def _interpolation(begin: int, end: int) -> tuple[Array, Array]:
    """Return Chebyshev points (K,) of the pixels from begin to end, and the pixels' shares (N, K).

    A polynomial of a degree below K takes at a pixel the sum of its values at the points, times
    the pixel's shares.
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
