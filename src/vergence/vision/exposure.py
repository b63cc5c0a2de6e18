"""How two images of one scene differ in brightness and contrast, and images made alike in both.

Two cameras seldom expose alike, nor does one camera at two times, and trackers and stereo matchers
compare grey levels as they are. Gain and offset are those of the whole image; vignetting is not
modelled.
"""

from __future__ import annotations

import cv2
import numpy as np

_LEAST_STD = 1.0
"""Standard deviation of an image's grey levels below which it shows noise and rounding alone."""


def gain_and_offset(first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """Return what gives the second grey levels (n,) the mean and the deviation of the first (m,).

    Both are of about the same part of the scene. Without contrast in one of them the gain is 1;
    without pixels nothing changes.
    """
    if not len(first) or not len(second):
        return 1.0, 0.0
    std, other = float(first.std(dtype=np.float32)), float(second.std(dtype=np.float32))
    gain = std / other if min(std, other) > _LEAST_STD else 1.0
    return gain, float(first.mean()) - gain * float(second.mean())


def with_exposure(grey: np.ndarray, gain: float, offset: float) -> np.ndarray:
    """Return an image (H, W) uint8 whose grey levels are multiplied, shifted, and cut to 0-255."""
    levels = np.round(gain * np.arange(256) + offset)
    return cv2.LUT(grey, np.clip(levels, 0, 255).astype(np.uint8))
