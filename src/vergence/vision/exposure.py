"""How much brighter one image is than another of the same scene, and images made equally bright.

Two cameras seldom expose alike, nor does one camera at two times, and trackers and stereo matchers
take grey for grey: of a pair in which one image has 0.6 times the contrast, a tracker finds next to
nothing again. Gain and offset are those of the whole image; vignetting is not modelled.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

_LEAST_SPREAD = 1.0
"""Standard deviation of an image's greys by noise and rounding alone: it shows no contrast."""


class Exposure(NamedTuple):
    """A linear function of grey levels."""

    gain: float
    offset: float

    def of(self, grey: np.ndarray) -> np.ndarray:
        """Return an image (H, W) uint8 as it would be with this exposure, uint8."""
        levels = np.round(self.gain * np.arange(256) + self.offset)
        return cv2.LUT(grey, np.clip(levels, 0, 255).astype(np.uint8))


def exposure_like(first: np.ndarray, second: np.ndarray) -> Exposure:
    """Return what gives the second greys (n,) the mean and the spread of the first (m,).

    Both show about the same scene. Where there is nothing to compare, it changes nothing.
    """
    if not len(first) or not len(second):
        return Exposure(1.0, 0.0)
    spread, other = float(first.std(dtype=np.float32)), float(second.std(dtype=np.float32))
    gain = spread / other if min(spread, other) > _LEAST_SPREAD else 1.0
    return Exposure(gain, float(first.mean()) - gain * float(second.mean()))
