"""Estimate coarse depths over an image, from which a tracker starts its search.

Both images are pinhole images of one orientation, so that an affine map displaces a plane that
faces them. The second image is displaced as planes at many distances would be, and each place of
the first takes the plane at which its surroundings differ least (Collins, "A space-sweep approach
to true multi-image matching", 1996). In small images this is fast, and it covers larger
displacements than a tracker's pyramid.
"""

from __future__ import annotations

import cv2
import numpy as np

from vergence.arrays import Array

_NEAREST, _BEYOND = 1 / 3, 1 / 32
"""Largest displacement over the image's width, and the largest in the other direction, which far
things have if the prediction is wrong by degrees."""


def step_px(width: int) -> int:
    """Return the displacement between neighbouring planes: a pixel of the small images."""
    return max(width // 80, 1)  # about 80 px wide, for speed


def inverse_depths(
    first: np.ndarray, second: np.ndarray, at: Array, *, focal: float, middle: Array, shift: Array
) -> Array:
    """Estimate inverse depths (N,) [1/m] in the second image; NaN where no plane is clearly best.

    Both images (H, W) are of about the same brightness and contrast, with one focal length and
    principal point `middle` (2,). A pixel of the first is `at` (N, 2); `shift` (3,) [m] is that of
    a point from the first camera to the second.
    """
    step = step_px(first.shape[1])
    by_inverse_depth = focal * float(np.hypot(*shift[:2]))  # displacement in the middle
    if by_inverse_depth < 1e-9 or not len(at):
        return np.full(len(at), np.nan)
    size = first.shape[1] // step, first.shape[0] // step
    a, b = (
        cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        for image in (first, second)
    )
    planes = np.arange(-round(_BEYOND * size[0]), round(_NEAREST * size[0]) + 1)
    planes = planes * (step / by_inverse_depth)
    centre = (middle + 0.5) / step - 0.5  # the principal point in the small images
    difference = np.empty((len(planes), *a.shape), np.float32)
    for k, inverse_depth in enumerate(planes):
        scale = 1 - inverse_depth * shift[2]
        moved = inverse_depth * focal / step * shift[:2] + (1 - scale) * centre
        displaced = cv2.warpAffine(
            b,
            np.array([[scale, 0, moved[0]], [0, scale, moved[1]]]),
            size,
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=1e4,  # more than any difference, also in the mean of a square
        )
        cv2.boxFilter(cv2.absdiff(a, displaced), -1, (5, 5), dst=difference[k])
    visible = difference < 256
    mean = np.einsum("kij,kij->ij", difference, visible) / np.maximum(visible.sum(axis=0), 1)
    least = difference.min(axis=0)
    clear = least < 0.5 * mean  # 0.7 gives the same matches
    # argmin takes five times as long along the first axis.
    numbers = np.arange(len(planes), dtype=np.uint8)[:, None, None]
    best = cv2.medianBlur((numbers * (difference == least)).max(axis=0), 5)
    column, row = np.clip(((at + 0.5) // step).astype(int), 0, np.array(size) - 1).T
    return np.where(clear[row, column], planes[best[row, column]], np.nan)
