"""Detectors of objects: functions that find one object in an image.

Gaze control calls a detector with an image, its camera and the pixel where the object was before.
`vision.sphere` and `vision.marker` make such functions; any function with these arguments can take
their place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.geometry.camera import Camera


@dataclass(frozen=True, eq=False)
class Detection:
    """The position of an object in an image."""

    pixel: Array
    """(2,) of its centre, distortion included."""
    std_px: float
    """Standard deviation of each coordinate."""


Detector = Callable[[np.ndarray, Camera, Array | None], Detection | None]
"""A function of an image (H, W, 3) uint8 RGB, the intrinsics of the camera that took it, and the
pixel (2,) around which to search first, None if unknown. It returns None if the image does not
show the object."""


def pixel_or_nan(detection: Detection | None) -> Array:
    """Take the pixel (2,) of a detection; NaN without one."""
    return np.full(2, np.nan) if detection is None else detection.pixel


def windows(image: np.ndarray, near: Array | None) -> list[tuple[slice, slice]]:
    """List the windows to search, as rows and columns: around a pixel (2,), then everywhere.

    Without a pixel inside the image only the image is searched.
    """
    height, width = image.shape[:2]
    everywhere = slice(0, height), slice(0, width)
    # NaN fails the comparison.
    if near is None or not ((near >= 0) & (near <= [width - 1, height - 1])).all():
        return [everywhere]
    radius = round(0.2 * width)  # small enough for a control step
    u, v = near.round().astype(int)
    rows = slice(max(v - radius, 0), min(v + radius, height))
    columns = slice(max(u - radius, 0), min(u + radius, width))
    return [(rows, columns), everywhere]
