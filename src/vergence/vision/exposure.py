"""Two images of one scene made alike in brightness and contrast, for trackers and stereo matchers.

These compare grey levels as they are, and two cameras seldom expose alike, nor does one camera at
two times. The local mean is subtracted from both images, so that offsets and most of the vignetting
do not matter. The ratio of contrasts is one number for the whole image: the median of the ratios of
its parts, weighted by contrast, since each image also shows things that the other does not.
"""

from __future__ import annotations

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError

NEARBY_PX = 31
"""Side of the square of which the mean is taken: twice that of a window that is matched."""
_LEAST_STD = 1.0
"""Root mean square of grey levels below which a part shows noise and rounding alone."""
_PARTS = 10
"""Along the width of an image."""
_SMALLEST_PART_PX = 8
_MIDDLE = 128


def checked_image(image: np.ndarray, what: str) -> np.ndarray:
    """Return an image (H, W), (H, W, 1) or (H, W, 3) uint8; VergenceError if it is none."""
    if image is None:  # as cv2.imread answers
        raise VergenceError(f"{what} is of two images; one of them is None: it was not read.")
    image = np.asarray(image)
    if image.dtype != np.uint8 or image.shape[2:] not in ((), (1,), (3,)) or image.ndim < 2:
        raise VergenceError(
            f"{what} is of RGB (H, W, 3) or grey (H, W) images of uint8; found an array of shape "
            f"{image.shape} of {image.dtype}."
        )
    return image


def grey_levels(image: np.ndarray) -> np.ndarray:
    """Return the grey levels (H, W) uint8 of an image (H, W, 3) in RGB, or of a grey one."""
    if image.ndim == 3 and image.shape[2] == 1:
        return image[..., 0]
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)


def of_equal_contrast(
    first: np.ndarray, second: np.ndarray, both: np.ndarray, nearby_px: int = NEARBY_PX
) -> tuple[np.ndarray, np.ndarray]:
    """Return two images (H, W) without their local means, the second with the first's contrast.

    Grey levels are uint8 about 128. Where no part has contrast in both images, each keeps its own.

    Args:
        first: (H, W) uint8.
        second: (H, W) uint8; a point of the scene is displaced by a part of the image at most.
        both: (H / 2, W / 2) bool: of every second pixel, whether both images show it.
        nearby_px: side of the square of which the mean is taken.
    """
    first, second = (_without_mean(each, nearby_px) for each in (first, second))
    ratio = _contrast_ratio(first[::2, ::2], second[::2, ::2], both)
    levels = np.round(ratio * (np.arange(256) - _MIDDLE) + _MIDDLE)
    return first, cv2.LUT(second, np.clip(levels, 0, 255).astype(np.uint8))


def _without_mean(image: np.ndarray, nearby_px: int) -> np.ndarray:
    nearby = cv2.boxFilter(image, -1, 2 * (nearby_px,), borderType=cv2.BORDER_REPLICATE)
    return cv2.addWeighted(image, 1, nearby, -1, _MIDDLE)


def _contrast_ratio(first: np.ndarray, second: np.ndarray, both: np.ndarray) -> float:
    """Return the contrast of the first image over that of the second."""
    part = max(first.shape[1] // _PARTS, _SMALLEST_PART_PX)
    whole = _means(both, part) > 0.999
    squares = [
        _means(np.square(image.astype(np.float32) - _MIDDLE), part)[whole]
        for image in (first, second)
    ]
    weights = np.minimum(*squares)
    counted = weights >= _LEAST_STD**2
    if not counted.any():
        return 1.0
    ratios = np.sqrt(squares[0][counted] / squares[1][counted])
    median = np.quantile(ratios, 0.5, weights=weights[counted], method="inverted_cdf")
    return float(median)


def _means(image: np.ndarray, part: int) -> Array:
    """Return the means (h, w) of the square parts of an image (H, W)."""
    rows, columns = (n // part for n in image.shape)
    parts = image[: rows * part, : columns * part].reshape(rows, part, columns, part)
    return parts.mean(axis=1, dtype=np.float32).mean(axis=-1)  # numpy is slow with both at once
