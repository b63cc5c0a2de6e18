"""What is assumed of a rational lens before any image is seen, and where it must not end.

Numerator and denominator of a rational lens may nearly cancel, so that corners leave some of its
coefficients open: along a curved valley the fits differ less than the noise, whereas between the
corners, or beyond them, a pole may stand. So the denominator is assumed to be about that of an
equidistant lens, and a lens whose pole or fold lies within the corners that were seen is no
solution. The numerator is free.
"""

from __future__ import annotations

import numpy as np

from vergence.arrays import Array
from vergence.geometry.camera import Camera, normalise
from vergence.geometry.parameters import PINHOLE
from vergence.vision.board_pose import seen_corners

EQUIDISTANT = 21 / 13, 105 / 143, 35 / 429
"""k4, k5 and k6 of the rational lens that is nearest to the equidistant one: the denominator of the
Pade approximant [6/6] of arctan(r) / r, which differs from it by 0.001 at 65 degrees."""
DENOMINATOR_STD = 1.0
"""Standard deviation that is assumed of each, relative to it: a lens without distortion, which has
none, is one away, and so is one with twice as much."""


def lens_prior(camera: Camera) -> tuple[Array, Array]:
    """Return (n,) the intrinsics that are assumed beforehand, and (n,) with what information.

    In the order of intrinsics_names; zeros where nothing is assumed.
    """
    mean, information = np.zeros((2, len(PINHOLE) + len(camera.distortion)))
    if camera.model == "rational":
        mean[-3:] = EQUIDISTANT
        information[-3:] = (DENOMINATOR_STD * mean[-3:]) ** -2
    return mean, information


def reaches(camera: Camera, corners: Array) -> bool:
    """Return whether a lens has a direction for the outermost of corners (..., 2) [px].

    NaN are corners that were not seen. Asked of rational lenses only: for others the answer is yes,
    since they cannot fold unnoticed.
    """
    if camera.model != "rational":
        return True
    pixels = corners[seen_corners(corners)]
    if not len(pixels):
        return True
    away = np.linalg.norm(pixels - camera.matrix[:2, 2], axis=-1)
    return bool(np.isfinite(normalise(camera, pixels[away.argmax()])).all())
