"""What is assumed of a rational and of a fisheye lens before any image is seen.

Numerator and denominator of a rational lens may nearly cancel, so that corners leave some of its
coefficients open: along a valley the fits differ less than the noise, whereas between the corners,
or beyond them, a pole may stand. But a lens has no pole: every direction before a camera has a
place in its image plane. So each coefficient of the denominator is assumed to be positive and of
the size that it has for an equidistant lens: distributed by a gamma distribution of shape 2, whose
density is largest there, zero at zero, and a fourteenth of the largest at six times it. The
numerator is free.

Where boards do not reach the edge of a fisheye lens, its last coefficients are open too. Those of
all the projections that lenses are designed for are below a third (that of a pinhole is 1/3, 2/15,
17/315, 62/2835 in the angle from the axis; others are smaller), so each is assumed to be normally
distributed about zero.
"""

from __future__ import annotations

import numpy as np

from vergence.arrays import Array
from vergence.geometry.camera import Camera
from vergence.geometry.parameter_names import PINHOLE

EQUIDISTANT = 21 / 13, 105 / 143, 35 / 429
"""k4, k5 and k6 of the rational lens that is nearest to the equidistant one: the denominator of the
Pade approximant [6/6] of arctan(r) / r, which differs from it by 0.001 at 65 degrees."""

FISHEYE_STD = 0.3
"""Of each coefficient of a fisheye lens."""


def lens_prior(camera: Camera) -> tuple[float, Array, Array]:
    """Return what the prior says of a lens, for its n intrinsics in the order of intrinsics_names.

    -2 log of the density, relative to the largest; (n,) half its gradient; and (n,) half its second
    derivatives, which are information. Infinity and zeros for a rational lens with a denominator
    that is not positive; zeros for lenses that are neither rational nor fisheye.
    """
    half_gradient, information = np.zeros((2, len(PINHOLE) + len(camera.distortion)))
    if camera.model == "fisheye":
        scaled = camera.distortion / FISHEYE_STD
        half_gradient[len(PINHOLE) :] = scaled / FISHEYE_STD
        information[len(PINHOLE) :] = FISHEYE_STD**-2
        return float((scaled**2).sum()), half_gradient, information
    if camera.model != "rational":
        return 0.0, half_gradient, information
    k, mode = camera.distortion[-3:], np.array(EQUIDISTANT)
    if not (k > 0).all():
        return np.inf, half_gradient, information
    half_gradient[-3:] = 1 / mode - 1 / k
    information[-3:] = 1 / k**2
    return float(2 * (k / mode - 1 - np.log(k / mode)).sum()), half_gradient, information
