"""Detectors of objects: functions that find one object in an image.

The gaze calls a detector with an image, the camera that took it and the pixel where the object was
before, and takes whatever it answers. `vision.sphere`, `vision.marker` and `vision.template` make
such functions; any other function with these arguments is as good.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.geometry.camera import Camera

SEARCH_RADIUS = 0.2
"""Half the side of the window that is searched first, as a share of the image's width."""


@dataclass(frozen=True, eq=False)
class Detection:
    """Where an object is in an image."""

    pixel: Array
    """(2,) of its centre, distortion included."""
    std_px: float
    """Standard deviation of each coordinate."""


Detector = Callable[[np.ndarray, Camera, Array | None], Detection | None]
"""A function of an image (H, W, 3) uint8 RGB, the intrinsics of the camera that took it, and the
pixel (2,) around which to search first, None where it is not known. It returns the object, or None
where the image does not show it."""


def pixel_or_nan(detection: Detection | None) -> Array:
    """Return the pixel (2,) of a detection, NaN where there is none."""
    return np.full(2, np.nan) if detection is None else detection.pixel


def windows(image: np.ndarray, near: Array | None) -> list[tuple[slice, slice]]:
    """Return rows and columns in which to search, in this order: around a pixel, then everywhere.

    Args:
        image: (H, W, ...).
        near: (2,) pixel; without one, or if it is NaN or outside the image, there is only the
            whole image.
    """
    height, width = image.shape[:2]
    everywhere = slice(0, height), slice(0, width)
    if near is None or not np.isfinite(near).all() or not (near >= 0).all():
        return [everywhere]
    if near[0] > width - 1 or near[1] > height - 1:
        return [everywhere]
    reach = round(SEARCH_RADIUS * width)
    u, v = near.round().astype(int)
    rows = slice(max(v - reach, 0), min(v + reach, height))
    columns = slice(max(u - reach, 0), min(u + reach, width))
    return [(rows, columns), everywhere]
