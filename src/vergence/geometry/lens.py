"""Lens models: how (x/z, y/z) is distorted, its derivatives, and how far out it can be undone.

Three models, each OpenCV's, so that both agree to the last digits:

- `radial-tangential` (k1, k2, p1, p2, k3): Brown's polynomial.
- `rational` (k1, k2, p1, p2, k3, k4, k5, k6): the same with the radial factor divided by
  1 + k4 r^2 + k5 r^4 + k6 r^6.
- `fisheye` (k1, k2, k3, k4): equidistant; with t the angle from the axis, a point lies at the
  radius t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8) (Kannala and Brandt; cv2.fisheye).

Directions are given by x/z and y/z, so all models end at 90 degrees from the axis.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import numpy as np

from vergence.arrays import Array
from vergence.geometry.batches import ignoring_invalid

CameraModel = Literal["radial-tangential", "rational", "fisheye"]
COEFFICIENTS: dict[CameraModel, tuple[str, ...]] = {
    "radial-tangential": ("k1", "k2", "p1", "p2", "k3"),
    "rational": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}
"""The names of the distortion coefficients, in their order."""
PINHOLE = ("fx", "fy", "cx", "cy")
"""The names of the other intrinsics of a camera."""

Coefficients = tuple[float, ...]
_SMALLEST_RADIUS = 1e-9
"""Below it a fisheye lens is linear to machine precision."""


def distort(model: CameraModel, k: Coefficients, x: Array, y: Array) -> tuple[Array, ...]:
    """Compute distorted x', y', and dx'/dx, dx'/dy (which is dy'/dx), dy'/dy, each shaped as x.

    x and y are x/z and y/z; k are the coefficients of the model.
    """
    if model == "fisheye":
        return _distort_fisheye(k, x, y)
    k1, k2, p1, p2, k3 = k[:5]
    x2, xy, y2 = x * x, x * y, y * y
    r2 = x2 + y2
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * k3 * r2))  # d radial / d x = slope * x
    if model == "rational":  # at a pole the result is NaN
        k4, k5, k6 = k[5:]
        below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
        slope_below = 2 * (k4 + r2 * (2 * k5 + 3 * k6 * r2))
        radial = radial / below
        slope = (slope - radial * slope_below) / below
    return (
        x * radial + 2 * p1 * xy + p2 * (r2 + 2 * x2),
        y * radial + p1 * (r2 + 2 * y2) + 2 * p2 * xy,
        radial + slope * x2 + 2 * p1 * y + 6 * p2 * x,
        slope * xy + 2 * p1 * x + 2 * p2 * y,
        radial + slope * y2 + 6 * p1 * y + 2 * p2 * x,
    )


def _distort_fisheye(k: Coefficients, x: Array, y: Array) -> tuple[Array, ...]:
    r = np.maximum(np.hypot(x, y), _SMALLEST_RADIUS)
    theta = np.arctan(r)
    scale = _radius(k, theta) / r
    slope = (_radius_slope(k, theta) / (1 + r * r) - scale) / (r * r)  # d scale / d x = slope * x
    return x * scale, y * scale, scale + slope * x * x, slope * x * y, scale + slope * y * y


def _radius(k: Coefficients, theta: Array) -> Array:
    k1, k2, k3, k4 = k
    t2 = theta * theta
    return theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))


def _radius_slope(k: Coefficients, theta: Array) -> Array:
    k1, k2, k3, k4 = k
    t2 = theta * theta
    return 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))


def by_coefficients(
    model: CameraModel, k: Coefficients, x: Array, y: Array
) -> tuple[list[Array], list[Array]]:
    """Compute the derivatives of distorted x' and of y' by the n coefficients of the model."""
    r2 = x * x + y * y
    if model == "fisheye":
        r = np.maximum(np.sqrt(r2), _SMALLEST_RADIUS)
        theta = np.arctan(r)
        powers = [theta**n / r for n in (3, 5, 7, 9)]
        return [x * power for power in powers], [y * power for power in powers]
    radial, twice_xy = [r2, r2 * r2, r2 * r2 * r2], 2 * x * y
    if model == "rational":
        k1, k2, _, _, k3, k4, k5, k6 = k
        below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
        factor = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / below
        radial = [power / below for power in radial]
        radial += [-factor * power for power in radial]
    rows = []
    for own, tangential in ((x, (twice_xy, r2 + 2 * x * x)), (y, (r2 + 2 * y * y, twice_xy))):
        first, second, *others = (own * power for power in radial)
        rows.append([first, second, *tangential, *others])
    return rows[0], rows[1]


@lru_cache(maxsize=1024)
def reach(model: CameraModel, k: Coefficients) -> float:
    """Compute the x^2 + y^2 up to which the radius in the image grows; infinity: up to 90 degrees.

    Beyond it the lens model folds over or has a pole, and pixels belong to no direction.
    """
    u = np.array([1.0, 0.0])
    if model == "radial-tangential":
        k1, k2, _, _, k3 = k
        slopes = [[7 * k3, 5 * k2, 3 * k1, 1.0]]
    elif model == "fisheye":
        k1, k2, k3, k4 = k
        slopes = [[9 * k4, 7 * k3, 5 * k2, 3 * k1, 1.0]]
    else:
        k1, k2, _, _, k3, k4, k5, k6 = k
        above, below = np.array([k3, k2, k1, 1.0]), np.array([k6, k5, k4, 1.0])
        rising = np.polyadd(above, 2 * np.polymul(u, np.polyder(above)))
        falling = 2 * np.polymul(u, np.polymul(above, np.polyder(below)))
        slopes = [np.polysub(np.polymul(rising, below), falling), below]
    # Solved for 1 / r^2: the largest root is the first fold or pole.
    roots = np.concatenate([np.roots(slope[::-1]) for slope in slopes])
    largest = roots.real[(roots.imag == 0) & (roots.real > 0)].max(initial=0.0)
    first = 1 / largest if largest > 0 else np.inf
    if model != "fisheye":
        return float(first)
    theta = np.sqrt(first)
    return float(np.tan(theta) ** 2) if theta < np.pi / 2 else np.inf


@lru_cache(maxsize=1024)
@ignoring_invalid
def _table(model: CameraModel, k: Coefficients) -> tuple[Array, Array]:
    """Tabulate radii in the image, rising, and the tangents (rational) or angles there."""
    end = reach(model, k)
    if model == "fisheye":
        theta = np.linspace(0, min(np.arctan(np.sqrt(end)), np.pi / 2), 500)
        return _radius(k, theta), theta
    # Up to 89.4 degrees, and short of a pole: on it the radius would be infinite, of either sign.
    largest = min((1 - 1e-9) * np.sqrt(end), 100.0)
    # Even in the angle: a lens is smooth in it.
    r = np.tan(np.linspace(0, np.arctan(largest), 500))
    rational = (*k[:2], 0.0, 0.0, *k[4:])
    return distort(model, rational, r, np.zeros_like(r))[0], r


def first_guess(model: CameraModel, k: Coefficients, x: Array, y: Array) -> tuple[Array, Array]:
    """Estimate undistorted coordinates of distorted x, y, from which Newton's method converges.

    For a fisheye lens they are exact, and NaN where no direction in front of the camera has this
    radius.
    """
    if model == "radial-tangential":
        # The radius alone: from x and y themselves Newton's method misses places near a fold.
        k1, k2, _, _, k3 = k
        r2 = x * x + y * y
        scale = 1.0 / (1 + r2 * (k1 + r2 * (k2 + r2 * k3)))
        for _ in range(2):
            inside = r2 * (scale * scale)
            radial = 1 + inside * (k1 + inside * (k2 + inside * k3))
            slope = radial + inside * (2 * k1 + inside * (4 * k2 + inside * 6 * k3))
            scale = scale - (scale * radial - 1) / slope
        return x * scale, y * scale
    radius = np.hypot(x, y)
    in_image, out = _table(model, k)
    found = np.interp(radius, in_image, out)
    if model == "fisheye":
        theta = found
        for _ in range(6):  # of a table this dense, three are enough but at a fold
            theta = theta - (_radius(k, theta) - radius) / _radius_slope(k, theta)
        inside = (radius < in_image[-1]) & (theta < np.pi / 2) & (theta >= 0)
        found = np.where(inside, np.tan(theta), np.nan)
    scale = np.where(radius > 0, found / np.where(radius > 0, radius, 1.0), 1.0)
    return x * scale, y * scale
