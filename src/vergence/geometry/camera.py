"""Pinhole camera with distortion: project, normalise, and the Jacobians of both.

Frame `cam` is OpenCV's: x right, y down, z forward; pixel (0, 0) is the centre of the top-left
pixel. Distortion is OpenCV's (k1, k2, p1, p2, k3), so that both agree to the last digit; unlike
OpenCV, the matrix may have skew (the paper's Eq. 2). See docs/conventions.md.
"""

from __future__ import annotations

from dataclasses import field
from functools import lru_cache
from typing import Annotated

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from vergence.arrays import Array, Matrix3, Vector

MAX_IMAGE_PX = 20_000
MAX_IMAGE_AREA_PX = 50_000_000
"""Width times height; decoding an image of this size takes 300 MB."""
MIN_FOCAL_PX = 1e-6
Pixels = Annotated[int, Field(gt=0, le=MAX_IMAGE_PX)]
"""The width or height of an image."""
MAX_NUMBER = 1e12
"""Of the matrix and the distortion; with larger ones projections overflow."""


def check_image_size(width: int, height: int) -> None:
    """Raise ValueError if an image has more pixels than are read."""
    if width * height > MAX_IMAGE_AREA_PX:
        raise ValueError(
            f"images have at most {MAX_IMAGE_AREA_PX:,} pixels, found {width} x {height}"
        )


@dataclass(frozen=True, eq=False, config=ConfigDict(extra="forbid"))
class Camera:
    """Intrinsic parameters of one camera; ValueError where they are not possible."""

    width: Pixels
    """Image width [px]."""
    height: Pixels
    """Image height [px]."""
    matrix: Matrix3
    """A of Eq. 2: [[alpha, gamma, u0], [0, beta, v0], [0, 0, 1]] [px]."""
    distortion: Vector = field(default_factory=lambda: np.zeros(5))
    """(k1, k2, p1, p2, k3)."""

    def __post_init__(self) -> None:
        if self.distortion.shape != (5,):
            raise ValueError(f"distortion has 5 coefficients, found {self.distortion.size}")
        check_image_size(self.width, self.height)
        largest = max(np.abs(self.distortion).max(), np.abs(self.matrix).max())
        if largest > MAX_NUMBER:
            raise ValueError(f"matrix and distortion are below {MAX_NUMBER:g}, found {largest:g}")
        smallest = self.matrix[[0, 1], [0, 1]].min()
        if smallest < MIN_FOCAL_PX:
            raise ValueError(f"focal lengths are positive, found one of {smallest:g} px")
        if self.matrix[1, 0] != 0 or (self.matrix[2] != [0, 0, 1]).any():
            rows = self.matrix[1:].tolist()
            raise ValueError(
                f"the matrix has rows (fx, s, cx), (0, fy, cy), (0, 0, 1), found {rows}"
            )


def _distortion(camera: Camera, x: Array, y: Array) -> tuple[Array, Array, Array, Array, Array]:
    """Return distorted x', y', and dx'/dx, dx'/dy (which is dy'/dx), dy'/dy, each shaped as x."""
    k1, k2, p1, p2, k3 = camera.distortion.tolist()
    x2, xy, y2 = x * x, x * y, y * y
    r2 = x2 + y2
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * k3 * r2))  # d radial / d x = slope * x
    return (
        x * radial + 2 * p1 * xy + p2 * (r2 + 2 * x2),
        y * radial + p1 * (r2 + 2 * y2) + 2 * p2 * xy,
        radial + slope * x2 + 2 * p1 * y + 6 * p2 * x,
        slope * xy + 2 * p1 * x + 2 * p2 * y,
        radial + slope * y2 + 6 * p1 * y + 2 * p2 * x,
    )


@lru_cache
def _fold(k1: float, k2: float, k3: float) -> float:
    """Return x^2 + y^2 at which the radial polynomial first stops rising; infinity: nowhere."""
    inverse = np.roots([1, 3 * k1, 5 * k2, 7 * k3])  # of 1 / (x^2 + y^2), where the slope is zero
    rising = max((root.real for root in inverse if root.imag == 0 < root.real), default=0.0)
    return 1 / rising if rising > 0 else np.inf


def project(camera: Camera, points_cam: Array) -> Array:
    """Return the pixels (..., 2) of points (..., 3) in frame cam (Eq. 1, with distortion).

    Points that are not in front of the camera, and NaN, give NaN.
    """
    z = points_cam[..., 2:]
    xy = points_cam[..., :2] / np.where(z > 0, z, np.nan)
    distorted = np.stack(_distortion(camera, xy[..., 0], xy[..., 1])[:2], axis=-1)
    return distorted @ camera.matrix[:2, :2].T + camera.matrix[:2, 2]


def project_jacobians(camera: Camera, points_cam: Array) -> tuple[Array, Array, Array]:
    """Return pixels (..., 2), their Jacobians by point (..., 2, 3) and by intrinsics (..., 2, 9).

    The intrinsics are in the order (fx, fy, cx, cy, k1, k2, p1, p2, k3).
    """
    z = points_cam[..., 2]
    inv_z = 1 / np.where(z > 0, z, np.nan)
    x, y = points_cam[..., 0] * inv_z, points_cam[..., 1] * inv_z
    zero, one = np.zeros_like(x), np.ones_like(x)
    d_xy = np.stack([inv_z, zero, -x * inv_z, zero, inv_z, -y * inv_z], axis=-1)
    d_xy = d_xy.reshape(*x.shape, 2, 3)
    K = camera.matrix[:2, :2]
    distorted_x, distorted_y, xx, cross, yy = _distortion(camera, x, y)
    d_point = K @ np.stack([xx, cross, cross, yy], axis=-1).reshape(*x.shape, 2, 2) @ d_xy
    r2 = x * x + y * y
    d_k = np.stack(
        [
            np.stack([x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x, x * r2**3], axis=-1),
            np.stack([y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y, y * r2**3], axis=-1),
        ],
        axis=-2,
    )
    d_f = np.stack([distorted_x, zero, one, zero, zero, distorted_y, zero, one], axis=-1)
    d_intrinsics = np.concatenate([d_f.reshape(*x.shape, 2, 4), K @ d_k], axis=-1)
    pixels = np.stack([distorted_x, distorted_y], axis=-1) @ K.T + camera.matrix[:2, 2]
    return pixels, d_point, d_intrinsics


def normalise(camera: Camera, pixels: Array) -> Array:
    """Return undistorted normalised coordinates (x/z, y/z) (..., 2) of pixels (..., 2).

    Newton's method to machine precision. Pixels beyond the reach of the distortion polynomial
    (where it folds over) give NaN.
    """
    (fx, skew, cx), (_, fy, cy), _ = camera.matrix.tolist()
    wanted_y = (pixels[..., 1] - cy) / fy
    wanted_x = (pixels[..., 0] - cx - skew * wanted_y) / fx
    if not camera.distortion.any():
        return np.stack([wanted_x, wanted_y], axis=-1)
    x, y = wanted_x, wanted_y
    error, det = np.full(x.shape, np.inf), np.ones_like(x)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for _ in range(20):
            distorted_x, distorted_y, xx, cross, yy = _distortion(camera, x, y)
            error_x, error_y = distorted_x - wanted_x, distorted_y - wanted_y
            error, det = np.maximum(np.abs(error_x), np.abs(error_y)), xx * yy - cross * cross
            x = x - (yy * error_x - cross * error_y) / det
            y = y - (xx * error_y - cross * error_x) / det
            if not np.nanmax(error, initial=0.0) > 1e-9:  # which this step has squared
                break
        good = (error < 1e-9) & (det > 0)
        k1, k2, _, _, k3 = camera.distortion.tolist()
        good &= x * x + y * y < _fold(k1, k2, k3)  # further out, another sheet reaches back
    return np.where(good[..., None], np.stack([x, y], axis=-1), np.nan)


def normalise_area(camera: Camera, xy: Array) -> Array:
    """Return the area (...,) in the plane z = 1 of one pixel at undistorted xy (..., 2)."""
    _, _, xx, cross, yy = _distortion(camera, xy[..., 0], xy[..., 1])
    return 1 / (camera.matrix[0, 0] * camera.matrix[1, 1] * (xx * yy - cross * cross))


def undistort(camera: Camera, pixels: Array) -> Array:
    """Return distortion-corrected pixels (..., 2): what Eqs. 1-4 speak of."""
    return normalise(camera, pixels) @ camera.matrix[:2, :2].T + camera.matrix[:2, 2]


def pinhole(
    width: int,
    height: int,
    focal_px: float | tuple[float, float],
    distortion: tuple[float, ...] = (0.0,) * 5,
) -> Camera:
    """Return a camera whose principal point is the middle of its image."""
    fx, fy = focal_px if isinstance(focal_px, tuple) else (focal_px, focal_px)
    matrix = np.array([[fx, 0, (width - 1) / 2], [0, fy, (height - 1) / 2], [0, 0, 1]])
    return Camera(width=width, height=height, matrix=matrix, distortion=np.array(distortion))
