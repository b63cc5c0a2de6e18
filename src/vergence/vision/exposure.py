"""Equalise brightness and contrast of two images of a scene, for trackers and stereo matchers.

Subtracting the local mean removes offsets and most of the vignetting. The ratio of contrasts is the
weighted median over parts of the image, since each also shows things that the other does not.
"""

from __future__ import annotations

import cv2
import numpy as np

from vergence.errors import VergenceError

NEARBY_PX = 31
"""Side of the square of the local mean [px]: twice that of a window that is matched."""
_MIDDLE = 128
"""Grey level of no contrast."""


def checked_image(image: np.ndarray, what: str) -> np.ndarray:
    """Check an image (H, W), (H, W, 1) or (H, W, 3) uint8; VergenceError for anything else."""
    if image is None:  # as cv2.imread answers
        raise VergenceError(f"{what} takes images; found None: the file was not read.")
    image = np.asarray(image)
    if image.dtype != np.uint8 or image.shape[2:] not in ((), (1,), (3,)) or image.ndim < 2:
        raise VergenceError(
            f"{what} takes images of uint8, RGB (H, W, 3) or grey (H, W); found an array of shape "
            f"{image.shape} of {image.dtype}."
        )
    return image


def grey_levels(image: np.ndarray) -> np.ndarray:
    """Convert an image (H, W, 3) RGB or a grey one to grey levels (H, W) uint8."""
    if image.ndim == 3 and image.shape[2] == 1:
        return image[..., 0]
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)


def of_equal_contrast(
    first: np.ndarray, second: np.ndarray, both: np.ndarray, nearby_px: int = NEARBY_PX
) -> tuple[np.ndarray, np.ndarray]:
    """Subtract local means of two images (H, W) and scale the second to the first's contrast.

    Points of the scene are displaced by less than a part; `both` (H / 2, W / 2) says for every
    second pixel whether both images show it. Returns (H, W) uint8 about 128. If no part has
    contrast in both images, each keeps its own.
    """
    first, second = (_without_mean(each, nearby_px) for each in (first, second))
    ratio = _contrast_ratio(first[::2, ::2], second[::2, ::2], both)
    levels = np.round(ratio * (np.arange(256) - _MIDDLE) + _MIDDLE)
    return first, cv2.LUT(second, np.clip(levels, 0, 255).astype(np.uint8))


def _without_mean(image: np.ndarray, nearby_px: int) -> np.ndarray:
    nearby = cv2.boxFilter(image, -1, 2 * (nearby_px,), borderType=cv2.BORDER_REPLICATE)
    return cv2.addWeighted(image, 1, nearby, -1, _MIDDLE)


def _contrast_ratio(first: np.ndarray, second: np.ndarray, both: np.ndarray) -> float:
    """Estimate the contrast of the first image over that of the second."""
    part = max(first.shape[1] // 10, 8)  # side in pixels
    whole = _means(both, part) > 0.999
    squares = [
        _means(np.square(image.astype(np.float32) - _MIDDLE), part)[whole]
        for image in (first, second)
    ]
    weights = np.minimum(*squares)
    counted = weights >= 1.0  # grey levels^2; below, noise and rounding prevail
    if not counted.any():
        return 1.0
    ratios = np.sqrt(squares[0][counted] / squares[1][counted])
    median = np.quantile(ratios, 0.5, weights=weights[counted], method="inverted_cdf")
    return float(median)


def _means(image: np.ndarray, part: int) -> np.ndarray:
    """Average an image (H, W) over square parts (h, w)."""
    rows, columns = (n // part for n in image.shape)
    whole = image[: rows * part, : columns * part].astype(np.float32)
    return cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)
