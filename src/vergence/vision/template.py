"""Detect an object by its picture: normalised cross-correlation at several sizes.

The zero-mean normalised correlation does not depend on brightness and contrast. A parabola through
the best score and its neighbours gives the position to a fraction of a pixel. The object may be
turned or slanted by a few degrees; its size may vary within the given scales.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera
from vergence.vision.detector import Detection, Detector, windows
from vergence.vision.exposure import checked_image, grey_levels

LEAST_SIDE_PX = 8
"""Smallest side of a template [px]; smaller pictures resemble too many places of an image."""
LEAST_CONTRAST = 5.0
"""Least standard deviation of a template's grey levels: above the noise of a camera, 3."""


@dataclass(frozen=True, eq=False)
class _Match:
    """The best place of an image for a template."""

    score: float
    """Correlation, at most 1."""
    corner: Array
    """(2,) [px] top-left corner of the template."""
    template: np.ndarray
    """(h, w) uint8."""
    contrast: float
    """Standard deviation of the image's grey levels under the template."""


def template_detector(
    picture: np.ndarray,
    *,
    scales: Sequence[float] = (1.0,),
    least_score: float = 0.7,
) -> Detector:
    """Make a detector of what a picture shows; it locates the picture's centre.

    Args:
        picture: (h, w, 3) RGB or (h, w) grey, uint8: the object alone, without background, as the
            camera sees it from the front.
        scales: sizes at which it may appear in the image, relative to the picture; neighbours may
            differ by a fifth. Sizes with a side below LEAST_SIDE_PX are left out.
        least_score: correlation from which the object counts as found.

    Raises VergenceError for an argument that cannot serve, such as a picture of little contrast.
    """
    grey = grey_levels(checked_image(picture, "A template"))
    if not all((slope != 0).any() for slope in np.gradient(grey.astype(float))):
        raise VergenceError(
            "This template is the same all along its width or its height, so that its place in "
            "that direction is undetermined."
        )
    if not 0 < least_score < 1:
        raise VergenceError(f"The least score must be between 0 and 1, found {least_score:g}.")
    templates = _templates(grey, scales)

    def detect(image: np.ndarray, camera: Camera, near: Array | None) -> Detection | None:
        del camera  # over the size of an object a lens bends the image little
        searched = grey_levels(image)
        for rows, columns in windows(searched, near):
            match = _best(searched[rows, columns], templates)
            if match is not None and match.score >= least_score:
                if len(templates) > 1:
                    match = _refine_size(searched[rows, columns], grey, match)
                h, w = match.template.shape
                to_middle = np.array([columns.start + (w - 1) / 2, rows.start + (h - 1) / 2])
                return Detection(match.corner + to_middle, _std_px(match))
        return None

    return detect


def _templates(grey: np.ndarray, scales: Sequence[float]) -> list[np.ndarray]:
    """Resize a picture (h, w) to several scales; VergenceError if all are too small or too flat."""
    sizes = [[round(scale * side) for side in grey.shape[::-1]] for scale in scales]
    resized = [_resized(grey, size) for size in sizes if min(size) >= LEAST_SIDE_PX]
    templates = [template for template in resized if template.std() >= LEAST_CONTRAST]
    if not templates:
        raise VergenceError(
            f"At none of the scales ({', '.join(f'{scale:g}' for scale in scales)}) a template of "
            f"{grey.shape[1]} x {grey.shape[0]} px has sides of {LEAST_SIDE_PX} px and a contrast "
            f"of {LEAST_CONTRAST:g} grey levels."
        )
    return templates


def _resized(image: np.ndarray, size: Sequence[int]) -> np.ndarray:
    smaller = size[0] < image.shape[1]
    return cv2.resize(
        image, list(size), interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    )


def _best(image: np.ndarray, templates: Sequence[np.ndarray]) -> _Match | None:
    """Find the best match in an image (H, W) over the templates; None: all are larger."""
    matches = (_match(image, template) for template in templates)
    return max(filter(None, matches), key=lambda match: match.score, default=None)


def _refine_size(image: np.ndarray, picture: np.ndarray, match: _Match) -> _Match:
    """Interpolate the size at which a picture resembles the image (H, W) most, about a match.

    With a wrong size the parts of an uneven picture shift its centre. The best size is at the peak
    of a parabola through the scores of three sizes.
    """

    def resized(power: float) -> np.ndarray:  # by half the step of the scales
        return _resized(picture, [round(1.1**power * side) for side in match.template.shape[::-1]])

    smaller, larger = _match(image, resized(-1)), _match(image, resized(1))
    if smaller is None or larger is None:
        return match
    best = _match(image, resized(_vertex(np.array([smaller.score, match.score, larger.score]))))
    return max(filter(None, (match, smaller, larger, best)), key=lambda each: each.score)


def _match(image: np.ndarray, template: np.ndarray) -> _Match | None:
    """Find the place of an image (H, W) that resembles a template (h, w) most; None: too small."""
    h, w = template.shape
    if image.shape[0] < h or image.shape[1] < w:
        return None
    scores = cv2.matchTemplate(image, template, cv2.TM_CCOEFF_NORMED)
    v, u = np.unravel_index(np.argmax(scores), scores.shape)
    contrast = float(image[v : v + h, u : u + w].std())
    if contrast < LEAST_CONTRAST:  # scores of uniform places are rounding errors
        scores = np.where(_contrasts(image, w, h) >= LEAST_CONTRAST, scores, -1.0)
        v, u = np.unravel_index(np.argmax(scores), scores.shape)
        contrast = float(image[v : v + h, u : u + w].std())
    along_u = _vertex(scores[v, max(u - 1, 0) : u + 2])
    along_v = _vertex(scores[max(v - 1, 0) : v + 2, u])
    return _Match(float(scores[v, u]), np.array([u + along_u, v + along_v]), template, contrast)


def _contrasts(image: np.ndarray, w: int, h: int) -> Array:
    """Compute the standard deviations of grey levels under windows of w x h at all places."""
    mean, square = (
        (S[h:, w:] - S[:-h, w:] - S[h:, :-w] + S[:-h, :-w]) / (w * h) for S in cv2.integral2(image)
    )
    return np.sqrt(np.maximum(square - mean**2, 0.0))


def _vertex(scores: np.ndarray) -> float:
    """Find the peak of the parabola through three scores, relative to the middle one, the best.

    It lies within half a step; at the border of the image, with two scores, it is 0.
    """
    if len(scores) < 3:
        return 0.0
    before, here, after = (float(score) for score in scores)
    curvature = before - 2 * here + after
    return 0.0 if curvature >= 0 else float(np.clip(0.5 * (before - after) / curvature, -0.5, 0.5))


def _std_px(match: _Match) -> float:
    """Estimate the standard deviation of a match: the Cramer-Rao bound and systematic errors.

    The part of the image's contrast that correlation does not explain counts as noise.
    """
    noise = match.contrast * np.sqrt(max(1 - match.score**2, 0.0))
    gain = match.contrast / match.template.std()
    slopes = np.gradient(gain * match.template.astype(float))
    weakest = min(np.linalg.norm(slope) for slope in slopes)
    by_shape = 0.005 * max(match.template.shape)  # slant and lens change the object's shape
    return float(np.linalg.norm([0.05, by_shape, noise / weakest]))  # the peak is no parabola
