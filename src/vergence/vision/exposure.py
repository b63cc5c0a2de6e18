"""How two images of one scene differ in brightness and contrast, and images made alike in both.

Two cameras seldom expose alike, nor does one camera at two times, and trackers and stereo matchers
compare grey levels as they are. There is one gain and one offset for the whole image; vignetting is
not modelled. Images show what the other does not, such as something near to one eye: so each part
of the image tells a gain and an offset, and most of the contrast decides.
"""

from __future__ import annotations

import cv2
import numpy as np

from vergence.arrays import Array

_LEAST_STD = 1.0
"""Standard deviation of grey levels below which a part shows noise and rounding alone."""
_PARTS = 16
"""Along the width of an image."""
_SMALLEST_PART_PX = 8


def gain_and_offset(first: np.ndarray, second: np.ndarray, both: np.ndarray) -> tuple[float, float]:
    """Return what gives the second image the grey levels and the contrast of the first.

    Where no part has contrast in both images the gain is 1; where none is shown by both, nothing
    changes.

    Args:
        first: (H, W) uint8.
        second: (H, W) uint8; a point of the scene is displaced by a part of the image at most.
        both: (H, W) bool: whether both images show it.
    """
    part = max(first.shape[1] // _PARTS, _SMALLEST_PART_PX)
    whole = _means(both, part) > 0.999
    means = [_means(image, part)[whole] for image in (first, second)]
    if not len(means[0]):
        return 1.0, 0.0
    variances = [
        np.maximum(_means(np.square(image, dtype=np.float32), part)[whole] - mean**2, 0)
        for image, mean in zip((first, second), means, strict=True)
    ]
    contrast = np.minimum(*variances)
    contrast[contrast < _LEAST_STD**2] = 0
    if not contrast.any():
        return 1.0, _median(means[0] - means[1], np.ones_like(contrast))
    ratios = np.sqrt(variances[0] / np.maximum(variances[1], _LEAST_STD**2))
    gain = _median(ratios, contrast)
    return gain, _median(means[0] - gain * means[1], contrast)


def _means(image: np.ndarray, part: int) -> Array:
    """Return the means (h, w) of the square parts of an image (H, W)."""
    rows, columns = (n // part for n in image.shape)
    image = image[: rows * part, : columns * part].astype(np.float32)
    if not image.size:
        return np.empty((0, 0))
    return cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA).astype(float)


def _median(values: Array, weights: Array) -> float:
    """Return the value (n,) at which half of the weight is reached."""
    order = np.argsort(values)
    reached = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(reached, reached[-1] / 2)])


def with_exposure(grey: np.ndarray, gain: float, offset: float) -> np.ndarray:
    """Return an image (H, W) uint8 whose grey levels are multiplied, shifted, and cut to 0-255."""
    levels = np.round(gain * np.arange(256) + offset)
    return cv2.LUT(grey, np.clip(levels, 0, 255).astype(np.uint8))
