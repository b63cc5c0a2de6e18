"""How accurate a point is by the design of a head: baseline, lens, encoders, delay; closed form.

The head is symmetric: eyes a baseline b apart that pan about z, then tilt about y, and pinhole
cameras of focal length f that sit a little ahead of their rotation centres, on the optical axis.
Both eyes turn towards a point, and by the same angles off it. For an eye at e with forward axis F,
left axis L and upward axis U, its camera c = e + a F, a point P at depth d = F (P - c) and image
coordinates x, y in units of f, one pixel's errors and those of its readings obey

    -(L + x F) dP = d (dx - x_pan dpan - x_tilt dtilt)   and likewise U, y        (a)

where x_pan is how x changes when the eye turns about its pan axis. The four equations of both eyes
are solved by least squares as in Eqs. 3-4 of the paper: dP = G r. With white noise, the mean
square distance of the located point from the true one is a sum over sources,

    E|dP|^2 = (s / f)^2 S_pixel + j^2 S_joint + (w t)^2 (S_joint + rho S_between)  (b)

for pixel noise s [px], joint noise j [rad], eyes that turn with rms speed w [rad/s] in each joint
and readings a time t late; rho is the correlation of the two eyes' speeds: 1 when they turn
together, -1 when one does the opposite of the other. The S depend on the geometry alone, not on f.
What the calibration adds stands in design_effort.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array
from vergence.geometry.components import dot, plus
from vergence.geometry.kinematics import pan_tilt_along

Vec = tuple[Array, Array, Array]
"""x, y, z; in three arrays, since most of the time goes into memory."""


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """What a unit of variance of each source adds to a point's mean square error; see Eq. b."""

    pixel: Array
    """(...) [m^2] by errors of 1 rad in each image coordinate: pixels over focal length."""
    joint: Array
    """(...) [m^2 / rad^2] by independent errors in all four readings."""
    between: Array
    """(...) [m^2 / rad^2] twice the covariance by errors of the same joint in both eyes."""
    image_x: Array
    """(...) distance of the point from the middle of an image, the larger of both, sideways, in
    focal lengths."""
    image_y: Array
    """(...) the same upwards or downwards."""


def joint_std_rad(counts_per_turn: ArrayLike, noise_deg: ArrayLike) -> Array:
    """Return the standard deviation [rad] of readings with steps and noise; 0 counts: no steps."""
    counts = np.asarray(counts_per_turn, float)
    step = np.where(counts > 0, 2 * np.pi / np.maximum(counts, 1), 0.0)
    return np.hypot(step / np.sqrt(12), np.radians(noise_deg))  # errors of rounding are uniform


def gaze_at(baseline_m: Array, point: Array) -> tuple[Array, Array, Array, Array]:
    """Return left pan, left tilt, right pan, right tilt [rad] of eyes that fixate points (..., 3).

    Points are from the middle between the eyes.
    """
    x, y, z = point[..., 0], point[..., 1], point[..., 2]
    left, right = (pan_tilt_along(x, y - side * baseline_m, z) for side in (0.5, -0.5))
    return *left, *right


def sensitivity(
    baseline_m: ArrayLike, point: Array, *, camera_ahead_m: float, off_rad: Array | None = None
) -> Sensitivity:
    """Return what each source does to points (..., 3) [m], from the middle between the eyes.

    The eyes fixate each point, and then turn off it together by off_rad (..., 2), pan and tilt;
    None: not at all. All arguments broadcast.
    """
    baseline = np.asarray(baseline_m, float)
    left_pan, left_tilt, right_pan, right_tilt = gaze_at(baseline, point)
    pan_off, tilt_off = (0.0, 0.0) if off_rad is None else (off_rad[..., 0], off_rad[..., 1])
    P = point[..., 0], point[..., 1], point[..., 2]
    rows: list[Vec] = []
    errors = []  # by row: depth, and depth times the change by pan and by tilt
    image = [np.zeros(()), np.zeros(())]
    for side, pan, tilt in ((0.5, left_pan, left_tilt), (-0.5, right_pan, right_tilt)):
        pan, tilt = pan + pan_off, tilt + tilt_off
        cp, sp, ct, st = np.cos(pan), np.sin(pan), np.cos(tilt), np.sin(tilt)
        F, L, U = (ct * cp, ct * sp, -st), (-sp, cp, np.zeros_like(cp)), (st * cp, st * sp, ct)
        q = P[0], P[1] - side * baseline, P[2]
        r = q[0] - camera_ahead_m * F[0], q[1] - camera_ahead_m * F[1], q[2] - camera_ahead_m * F[2]
        depth = dot(F, r)
        for k, axis in enumerate((L, U)):
            at = -dot(axis, r) / depth
            row = axis[0] + at * F[0], axis[1] + at * F[1], axis[2] + at * F[2]
            # A turn of the eye moves the point, as the eye sees it, by -axis x q.
            by_pan = row[1] * q[0] - row[0] * q[1]
            by_tilt = dot(row, (L[1] * q[2], -L[0] * q[2], L[0] * q[1] - L[1] * q[0]))
            rows.append(row)
            errors.append((depth, by_pan, by_tilt))
            image[k] = np.maximum(image[k], np.abs(at))
    inverse = _inverse_of_squares(rows)
    columns = [_times(inverse, row) for row in rows]
    pixel = sum(dot(c, c) * e[0] ** 2 for c, e in zip(columns, errors, strict=True))
    joint, between = np.zeros(()), np.zeros(())
    for k in (1, 2):
        left, right = (
            plus(_scaled(columns[i], errors[i][k]), _scaled(columns[i + 1], errors[i + 1][k]))
            for i in (0, 2)
        )
        joint = joint + dot(left, left) + dot(right, right)
        between = between + 2 * dot(left, right)
    return Sensitivity(np.asarray(pixel), joint, between, *image)


def mean_square(
    seen: Sensitivity,
    *,
    focal_px: ArrayLike,
    pixel_std_px: ArrayLike,
    joint_std_rad: ArrayLike,
    late_rad: ArrayLike = 0.0,
    correlation: float = 0.0,
) -> Array:
    """Return Eq. b [m^2]: the mean square error of points by noise; all arguments broadcast.

    late_rad is by how much a joint turns, rms, while its reading is late.
    """
    late = np.asarray(late_rad, float) ** 2
    joint = np.asarray(joint_std_rad, float) ** 2 + late
    by_pixels = (np.asarray(pixel_std_px, float) / np.asarray(focal_px, float)) ** 2 * seen.pixel
    return by_pixels + joint * seen.joint + correlation * late * seen.between


def _scaled(a: Vec, by: Array) -> Vec:
    return a[0] * by, a[1] * by, a[2] * by


def _inverse_of_squares(rows: list[Vec]) -> tuple[Array, ...]:
    """Return xx, xy, xz, yy, yz, zz of the inverse of the sum of row row^T."""
    xx, xy, xz, yy, yz, zz = (
        np.sum([row[a] * row[b] for row in rows], axis=0)
        for a, b in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    )
    first = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    det = xx * first[0] + xy * first[1] + xz * first[2]
    second = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    return tuple(each / det for each in (*first, *second))


def _times(symmetric: tuple[Array, ...], v: Vec) -> Vec:
    xx, xy, xz, yy, yz, zz = symmetric
    return dot((xx, xy, xz), v), dot((xy, yy, yz), v), dot((xz, yz, zz), v)
