"""Detection of an object by its picture: normalised correlation at several sizes.

Correlation is normalised by mean and contrast (the zero-mean normalised cross-correlation), so that
brightness does not matter. A parabola through the best score and its neighbours, along each axis,
gives the position to a fraction of a pixel. The object may be turned or slanted by a few degrees
only; its size in the image may vary within the range of sizes that the detector is made for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera
from vergence.vision.detector import Detection, Detector, windows
from vergence.vision.exposure import grey_levels

LEAST_SIDE_PX = 8
"""Smaller pictures resemble too many places of an image."""
LEAST_CONTRAST = 5.0
"""Standard deviation of the grey levels, below which a picture or a place is little but noise."""
_SIZE_STEP = 1.1
"""Ratio of the three sizes among which the size is interpolated: half of what the sizes that are
searched for may differ by."""
_LEAST_STD_PX = 0.05
"""What remains of the error without noise: the parabola is not quite the shape of the peak."""
_SHAPE_STD = 0.005
"""Standard deviation as a share of the template's side: by slant and by the lens, the object has
another shape than the picture, and its centre is elsewhere in it."""


@dataclass(frozen=True, eq=False)
class _Template:
    """A picture of one size, in full and reduced by a power of two for the search."""

    full: np.ndarray
    """(h, w) uint8."""
    reduced: np.ndarray
    octaves: int
    """By how many powers of two."""


@dataclass(frozen=True, eq=False)
class _Match:
    """The best place of an image for a template of one size."""

    score: float
    corner: Array
    """(2,) [px] top-left corner of the template there, to a fraction of a pixel."""
    template: np.ndarray
    """(h, w) uint8, of this size."""
    contrast: float
    """Standard deviation of the image's grey levels under the template."""


def template_detector(
    picture: np.ndarray,
    *,
    scales: Sequence[float] = (1.0,),
    least_score: float = 0.7,
) -> Detector:
    """Return a detector of what a picture shows, which finds the centre of the picture.

    Args:
        picture: (h, w, 3) RGB or (h, w) grey, uint8: the object alone, without background, as the
            camera sees it from the front.
        scales: sizes at which it may appear in the image, relative to the picture. Neighbours may
            differ by a fifth: at half of that the correlation is still high. Sizes at which a side
            would be below LEAST_SIDE_PX are left out.
        least_score: correlation, at most 1, from which the object counts as found.

    Raises:
        VergenceError: the picture has another form, or hardly any contrast, or stripes only, or no
            size is large enough, or the least score is not between 0 and 1.
    """
    grey = _grey(picture)
    if not 0 < least_score < 1:
        raise VergenceError(f"The least score must be between 0 and 1, found {least_score:g}.")
    templates = _templates(grey, scales)

    def detect(image: np.ndarray, camera: Camera, near: Array | None) -> Detection | None:
        del camera  # the picture is compared as it is: lenses bend an image little over its size
        there = grey_levels(image)
        for rows, columns in windows(there, near):
            found = _best(there[rows, columns], templates)
            if found is not None and found.score >= least_score:
                if len(templates) > 1:
                    found = _at_best_size(there[rows, columns], grey, found)
                h, w = found.template.shape
                to_middle = np.array([columns.start + (w - 1) / 2, rows.start + (h - 1) / 2])
                return Detection(found.corner + to_middle, _std_px(found))
        return None

    return detect


def _grey(picture: np.ndarray) -> np.ndarray:
    """Return a picture in grey (h, w) uint8; VergenceError if it cannot be a template."""
    flat = picture.ndim == 2
    if picture.dtype != np.uint8 or not (flat or (picture.ndim == 3 and picture.shape[2] == 3)):
        raise VergenceError(
            "A template is a picture (h, w, 3) RGB or (h, w) grey of uint8, found "
            f"{picture.shape} of {picture.dtype}."
        )
    grey = grey_levels(picture)
    if min(grey.shape) < LEAST_SIDE_PX:
        raise VergenceError(
            f"A template has sides of at least {LEAST_SIDE_PX} px, found "
            f"{grey.shape[1]} x {grey.shape[0]} px."
        )
    contrast = float(grey.std())
    if contrast < LEAST_CONTRAST:
        raise VergenceError(
            f"This template has a contrast of {contrast:.1f} grey levels (standard deviation); at "
            f"least {LEAST_CONTRAST:g} are needed to recognise it."
        )
    if not all((slope != 0).any() for slope in np.gradient(grey.astype(float))):
        raise VergenceError(
            "This template is the same all along its width or its height, in which direction its "
            "place cannot be told."
        )
    return grey


def _templates(grey: np.ndarray, scales: Sequence[float]) -> list[_Template]:
    """Return a picture (h, w) at several sizes; VergenceError if none of them can be found."""
    found = []
    for scale in scales:
        size = [round(scale * side) for side in grey.shape[::-1]]
        if scale > 0 and min(size) >= LEAST_SIDE_PX:
            full = grey if scale == 1 else _resized(grey, size)
            octaves = int(np.log2(min(size) / LEAST_SIDE_PX))
            reduced = _resized(full, [round(side / 2**octaves) for side in size])
            if reduced.std() >= LEAST_CONTRAST:
                found.append(_Template(full, reduced, octaves))
    if not found:
        raise VergenceError(
            f"At none of the scales ({', '.join(f'{scale:g}' for scale in scales)}) a template of "
            f"{grey.shape[1]} x {grey.shape[0]} px has sides of {LEAST_SIDE_PX} px and a contrast "
            f"of {LEAST_CONTRAST:g} grey levels."
        )
    return found


def _resized(image: np.ndarray, size: Sequence[int]) -> np.ndarray:
    """Return an image of another width and height, in which every pixel is a mean of its area."""
    smaller = size[0] < image.shape[1]
    return cv2.resize(
        image, list(size), interpolation=cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    )


def _best(image: np.ndarray, templates: Sequence[_Template]) -> _Match | None:
    """Return the best match in an image (H, W) over the templates; None: none fits into it.

    Each is searched for in an image that is reduced as far as leaves the template eight pixels, and
    then located around that place in the full image.
    """
    reduced = [image]
    for _ in range(max(template.octaves for template in templates)):
        height, width = reduced[-1].shape
        if min(height, width) < 2:
            break
        reduced.append(
            _resized(reduced[-1][: height & ~1, : width & ~1], [width // 2, height // 2])
        )
    matches: list[_Match] = []
    for template in templates:
        if template.octaves >= len(reduced):
            continue
        there = reduced[template.octaves]
        if not _fits(template.reduced, there):
            continue
        step = 2**template.octaves
        corner = step * _match(there, template.reduced).corner
        fine = _match_near(image, template.full, corner, step + 1)
        matches += [] if fine is None else [fine]
    return max(matches, key=lambda match: match.score, default=None)


def _at_best_size(image: np.ndarray, picture: np.ndarray, found: _Match) -> _Match:
    """Return a match with the size that resembles the image (H, W) most, near that of a match.

    With another size than the object's, the parts of an uneven picture draw its centre aside. The
    size is where a parabola through the scores of three sizes peaks.
    """
    h, w = found.template.shape

    def sized(power: float) -> _Match | None:
        size = [round(_SIZE_STEP**power * side) for side in (w, h)]
        corner = found.corner + (np.array([w, h]) - size) / 2
        return _match_near(image, _resized(picture, size), corner, 2)

    around = sized(-1.0), sized(1.0)
    if around[0] is None or around[1] is None:
        return found
    best = sized(_vertex(np.array([around[0].score, found.score, around[1].score])))
    matches = [match for match in (found, *around, best) if match is not None]
    return max(matches, key=lambda match: match.score)


def _fits(template: np.ndarray, image: np.ndarray) -> bool:
    return bool((np.array(template.shape) <= image.shape).all())


def _match_near(
    image: np.ndarray, template: np.ndarray, corner: Array, reach: int
) -> _Match | None:
    """Return the best match whose corner (2,) [px] is near a given one; None: it does not fit."""
    h, w = template.shape
    u, v = corner.round().astype(int)
    u0, v0 = max(u - reach, 0), max(v - reach, 0)
    around = image[v0 : v + h + reach, u0 : u + w + reach]
    if not _fits(template, around):
        return None
    found = _match(around, template)
    return replace(found, corner=found.corner + np.array([u0, v0]))


def _match(image: np.ndarray, template: np.ndarray) -> _Match:
    """Return the place of an image (H, W) that resembles a template (h, w) most."""
    h, w = template.shape
    scores = cv2.matchTemplate(image, template, cv2.TM_CCOEFF_NORMED)
    v, u = np.unravel_index(np.argmax(scores), scores.shape)
    # Where the image is uniform, rounding errors make any score.
    if (contrast := float(image[v : v + h, u : u + w].std())) < LEAST_CONTRAST:
        scores = np.where(_contrasts(image, w, h) >= LEAST_CONTRAST, scores, -1.0)
        v, u = np.unravel_index(np.argmax(scores), scores.shape)
        contrast = float(image[v : v + h, u : u + w].std())
    along_u = _vertex(scores[v, max(u - 1, 0) : u + 2])
    along_v = _vertex(scores[max(v - 1, 0) : v + 2, u])
    corner = np.array([u + along_u, v + along_v])
    return _Match(float(scores[v, u]), corner, template, contrast)


def _contrasts(image: np.ndarray, w: int, h: int) -> Array:
    """Return the standard deviations of grey levels under windows of w x h at all places."""
    total, squares = cv2.integral2(image)
    mean, square = (
        (S[h:, w:] - S[:-h, w:] - S[h:, :-w] + S[:-h, :-w]) / (w * h) for S in (total, squares)
    )
    return np.sqrt(np.maximum(square - mean**2, 0.0))


def _vertex(scores: np.ndarray) -> float:
    """Return where the parabola through three scores peaks, from the middle one: -0.5 to 0.5.

    The middle one is the greatest. At the border of the image, with two scores, it is 0.
    """
    if len(scores) < 3:
        return 0.0
    before, here, after = (float(score) for score in scores)
    curvature = before - 2 * here + after
    return 0.0 if curvature >= 0 else float(np.clip(0.5 * (before - after) / curvature, -0.5, 0.5))


def _std_px(found: _Match) -> float:
    """Return the standard deviation of a match: the Cramer-Rao bound, and what is not noise.

    What correlation does not explain of the image's contrast is taken for noise of its pixels. A
    shift is known as well as the slopes of the template are steep in comparison with this noise.
    """
    noise = found.contrast * np.sqrt(max(1 - found.score**2, 0.0))
    gain = found.contrast / found.template.std()  # of the image's brightness over the template's
    slopes = np.gradient(gain * found.template.astype(float))
    weakest = min(np.linalg.norm(slope) for slope in slopes)
    by_shape = _SHAPE_STD * max(found.template.shape)
    return float(np.linalg.norm([_LEAST_STD_PX, by_shape, noise / weakest]))
