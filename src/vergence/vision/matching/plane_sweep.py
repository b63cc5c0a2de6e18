"""About how far away the scene is, anywhere in an image: where a tracker begins to search.

Both images are pinhole images of one orientation, so that a plane that faces them is displaced by
an affine map. The second image is displaced as planes at many distances would be, and each place of
the first takes the one of which its surroundings differ least (plane sweep: Collins, "A space-sweep
approach to true multi-image matching", 1996). In small images this is fast, and it covers far more
than a tracker's pyramid reaches.
"""

from __future__ import annotations

import cv2
import numpy as np

from vergence.arrays import Array

_WIDTH_PX = 80
"""About that of the small images."""
_NEAREST, _BEYOND = 1 / 3, 1 / 32
"""Shares of the width: the largest displacement, and the largest in the other direction, which
predictions that are wrong by degrees may give the farthest things."""
_SIDE_PX = 5
"""Of the squares that are compared, in the small images."""
_MEDIAN_PX = 5
_CLEAR = 0.5
"""Share of the mean difference of all planes, below which the least one tells something; 0.5
and 0.7 give about the same matches."""
_OUTSIDE = 1e4
"""Difference from what the second image does not show: more than any between grey levels, even in
the mean of a square."""


def step_px(width: int) -> int:
    """Return the displacement between neighbouring planes, which is a pixel of the small images."""
    return max(width // _WIDTH_PX, 1)


def inverse_depths(
    first: np.ndarray, second: np.ndarray, at: Array, *, focal: float, middle: Array, shift: Array
) -> Array:
    """Return inverse depths (N,) [1/m] of the scene.

    The depths are those in the second image, NaN where no plane fits clearly better than the
    others.

    Args:
        first: (H, W) grey, uint8, with contrast in the means over `step_px` pixels.
        second: the same, of about the same brightness and contrast.
        at: (N, 2) pixels of the first.
        focal: of both [px].
        middle: (2,) principal point of both [px].
        shift: (3,) of a point, from the first camera to the second [m].
    """
    step = step_px(first.shape[1])
    by_inverse_depth = focal * float(np.hypot(*shift[:2]))  # displacement in the middle
    if by_inverse_depth < 1e-9 or not len(at):
        return np.full(len(at), np.nan)
    size = first.shape[1] // step, first.shape[0] // step
    a, b = (
        cv2.resize(each, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        for each in (first, second)
    )
    planes = np.arange(-round(_BEYOND * size[0]), round(_NEAREST * size[0]) + 1)
    planes = planes * (step / by_inverse_depth)
    corner = (middle + 0.5) / step - 0.5  # the principal point, in pixels of the small images
    apart = np.empty((len(planes), *a.shape), np.float32)
    for k, inverse_depth in enumerate(planes):
        scale = 1 - inverse_depth * shift[2]
        moved = inverse_depth * focal / step * shift[:2] + (1 - scale) * corner
        there = cv2.warpAffine(
            b,
            np.array([[scale, 0, moved[0]], [0, scale, moved[1]]]),
            size,
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=_OUTSIDE,
        )
        cv2.boxFilter(cv2.absdiff(a, there), -1, 2 * (_SIDE_PX,), dst=apart[k])
    shown = apart < 256
    usual = np.einsum("kij,kij->ij", apart, shown) / np.maximum(shown.sum(axis=0), 1)
    least = apart.min(axis=0)
    clear = least < _CLEAR * usual
    # As argmin, which takes five times as long along the first axis.
    numbers = np.arange(len(planes), dtype=np.uint8)[:, None, None]
    best = cv2.medianBlur((numbers * (apart == least)).max(axis=0), _MEDIAN_PX)
    column, row = np.clip(((at + 0.5) // step).astype(int), 0, np.array(size) - 1).T
    return np.where(clear[row, column], planes[best[row, column]], np.nan)
