"""Find a coloured sphere in an image, without the bias of its outline's centre.

The outline of a sphere is an ellipse whose centre is not the image of the sphere's centre: off
the optical axis the two differ by a fraction of the sphere's own size. What is measured is the
area and the centroid of the ellipse in the undistorted plane z = 1, from all pixels weighted by
how much of each the sphere covers; both follow from the cone of rays that touch the sphere, and
the cone's axis goes through its centre.
"""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.camera import Camera, normalise, normalise_area, project

_REDNESS = np.array([1.0, -0.5, -0.5])  # zero for grey, whatever its brightness
_HALF = 100  # grey levels of redness above which a pixel belongs to the sphere for certain


def find_sphere(
    image: np.ndarray, camera: Camera, *, colour: Literal["red", "blue"] = "red"
) -> Array:
    """Return the pixel (2,) of the centre of a coloured sphere, distortion included.

    The centroid is exact for a sphere of one flat colour before a grey background, however the
    camera averages over its pixels, since coverage then enters linearly.

    Args:
        image: (H, W, 3) uint8, RGB.
        camera: intrinsics of the camera that took it.
        colour: of the sphere.

    Returns:
        NaN where no region of this colour, of four pixels or more lies wholly within the image.
    """
    if colour == "blue":
        image = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    red, green, blue = cv2.split(image)
    redness8 = cv2.subtract(red, cv2.addWeighted(green, 0.5, blue, 0.5, 0))
    _, mask = cv2.threshold(redness8, _HALF, 255, cv2.THRESH_BINARY)
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    if not outlines:
        return np.full(2, np.nan)
    left, top, width, height = cv2.boundingRect(max(outlines, key=cv2.contourArea))
    area = cv2.countNonZero(mask[top : top + height, left : left + width])
    margin = 3  # the edge's soft pixels: blur and anti-aliasing reach two pixels, and one for luck
    u0, v0, u1, v1 = left - margin, top - margin, left + width + margin, top + height + margin
    if area < 4 or u0 < 0 or v0 < 0 or u1 > image.shape[1] or v1 > image.shape[0]:
        return np.full(2, np.nan)
    window = image[v0:v1, u0:u1].astype(float)
    redness = window @ _REDNESS
    cover = redness / np.median(redness[redness > _HALF])
    u, v = np.meshgrid(np.arange(u0, u1), np.arange(v0, v1))
    pixels = np.stack([u, v], axis=-1).reshape(-1, 2).astype(float)
    xy = normalise(camera, pixels)
    if not np.isfinite(xy).all():
        return np.full(2, np.nan)
    weights = cover.ravel() * normalise_area(camera, xy)
    if not weights.sum() > 0:
        return np.full(2, np.nan)
    ray = _cone_axis(weights @ xy / weights.sum(), weights.sum())
    return project(camera, ray)


def _cone_axis(centroid: Array, area: float) -> Array:
    """Return the unit axis (3,) of the cone whose section with z = 1 has this centroid and area.

    With c the axis and s the sine of half the opening angle, the ellipse has the centre
    c_xy c_z / (c_z^2 - s^2) and the area pi s^2 sqrt(1 - s^2) / (c_z^2 - s^2)^(3/2).
    """
    s2, c_z2, m2 = 0.0, 1.0, centroid @ centroid
    for _ in range(50):  # a contraction by about s^2, which is far below one
        before = s2
        # |c| = 1 makes the first of the two a quadratic equation in c_z^2.
        c_z2 = (1 + 2 * m2 * s2 + np.sqrt(1 + 4 * m2 * s2 * (1 - s2))) / (2 * (1 + m2))
        s2 = min(area / np.pi * (c_z2 - s2) ** 1.5 / np.sqrt(1 - s2), 0.5 * c_z2)
        if abs(s2 - before) < 1e-15:
            break
    c_z = np.sqrt(c_z2)
    return np.array([*(centroid * (c_z2 - s2) / c_z), c_z])
