"""What is assumed of a rational and of a fisheye lens before any image is taken.

Numerator and denominator of a rational lens may nearly cancel, so that corners leave some of its
coefficients open: along a valley the fits differ less than the noise, while a pole may stand
between the corners or beyond them. A lens has no pole: every direction before a camera has a place
in its image plane. So each coefficient of the denominator is assumed to be positive and of the size
that it has for an equidistant lens. It has a gamma distribution of shape 2, whose density is
largest there, zero at zero, and a fourteenth of the largest at six times it. The numerator is free.

Where boards do not reach the edge of a fisheye lens, its last coefficients are open too. Those of
all projections that lenses are designed for are below a third (that of a pinhole is 1/3, 2/15,
17/315, 62/2835 in the angle from the axis; others are smaller), so each is assumed to be normally
distributed about zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.estimation.residual import Levels, Residual, Rows
from vergence.estimation.variables import Variables
from vergence.geometry.camera import Camera
from vergence.geometry.parameter_names import PINHOLE
from vergence.geometry.parameters import camera_columns

EQUIDISTANT = 21 / 13, 105 / 143, 35 / 429
"""k4, k5 and k6 of the rational lens that is nearest to the equidistant one: the denominator of the
Pade approximant [6/6] of arctan(r) / r, which differs from it by 0.001 at 65 degrees."""

FISHEYE_STD = 0.3
"""Of each coefficient of a fisheye lens."""
LAST_ASSUMED = {"rational": "k6", "fisheye": "k4"}
"""Last coefficient of the lenses that have a prior; they have none where it is fixed."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LensPrior(Residual):
    """The prior of one lens: of a camera of the head, or of the block "lens"."""

    camera: str | None = None
    """Its name in the head; None: the block "lens"."""
    robust: bool = False

    def lens(self, x: Variables) -> Camera:
        """Take the lens at the unknowns."""
        return x["lens"] if self.camera is None else x["head"].cameras[self.camera].intrinsics

    def error(self, x: Variables) -> Array:
        """Compute k / std (1, 4) of a fisheye lens, k / mode - 1 (1, 3) of a rational one."""
        lens = self.lens(x)
        if lens.model == "fisheye":
            return lens.distortion[None] / FISHEYE_STD
        return lens.distortion[None, -3:] / EQUIDISTANT - 1

    def rows(self, x: Variables) -> Rows:
        """Compute derivatives that give the gradient and curvature of the log density."""
        lens = self.lens(x)
        if self.camera is None:
            columns = x.columns("lens")
        else:
            columns = x.columns("head")[camera_columns(x["head"], self.camera)]
        end = len(PINHOLE) + len(lens.distortion)
        # Of a rational lens half the gradient is 1 / mode - 1 / k, half the curvature 1 / k^2.
        fisheye = lens.model == "fisheye"
        slope = np.full(4, 1 / FISHEYE_STD) if fisheye else 1 / lens.distortion[-3:]
        return Rows(np.diag(slope)[None], columns[None, end - len(slope) : end])

    def costs(self, errors: Array, levels: Levels, outlier: float) -> Array:
        """Compute -2 log of the density, relative to the largest."""
        if errors.shape[1] == len(EQUIDISTANT):
            possible = np.maximum(errors, -1)
            with np.errstate(divide="ignore"):
                return 2 * (possible - np.log1p(possible)).sum(axis=1)
        return (errors**2).sum(axis=1)


def lens_priors(lens: Camera, free: bool, camera: str | None = None) -> list[LensPrior]:
    """Make the prior of a lens: none for other models, or if it starts where none can be.

    Args:
        lens: to start from.
        free: whether its last coefficient may change.
        camera: see LensPrior.
    """
    possible = lens.model == "fisheye" or (
        lens.model == "rational" and bool((lens.distortion[-3:] > 0).all())
    )
    return [LensPrior(camera=camera)] if possible and free else []
