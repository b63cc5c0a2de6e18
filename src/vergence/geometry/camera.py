"""Pinhole camera with distortion: project, normalise, and the Jacobians of both.

Frame `cam` is OpenCV's: x right, y down, z forward; pixel (0, 0) is the centre of the top-left
pixel. The lens models are OpenCV's (see `geometry.lens`), so that both agree to the last digit;
unlike OpenCV, the matrix may have skew (the paper's Eq. 2). Directions at 90 degrees from the axis
and beyond are not supported, whatever the lens. See docs/conventions.md.
"""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from vergence.arrays import Array, Matrix3, Vector
from vergence.geometry import lens
from vergence.geometry.lens import COEFFICIENTS, CameraModel

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
    """The coefficients of the lens model, in the order of `lens.COEFFICIENTS`."""
    model: CameraModel = "radial-tangential"
    """The lens model; files of earlier versions, which do not state one, have this one."""

    def __post_init__(self) -> None:
        names = COEFFICIENTS[self.model]
        if self.distortion.shape != (len(names),):
            raise ValueError(
                f"distortion has {len(names)} coefficients, found {self.distortion.size}; those of "
                f"a {self.model} lens are {', '.join(names)}"
            )
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


def _coefficients(camera: Camera) -> tuple[float, ...]:
    return tuple(camera.distortion.tolist())


def _distortion(camera: Camera, x: Array, y: Array) -> tuple[Array, ...]:
    """Return distorted x', y', and dx'/dx, dx'/dy (which is dy'/dx), dy'/dy, each shaped as x."""
    return lens.distort(camera.model, _coefficients(camera), x, y)


def project(camera: Camera, points_cam: Array) -> Array:
    """Return the pixels (..., 2) of points (..., 3) in frame cam (Eq. 1, with distortion).

    Points that are not in front of the camera, and NaN, give NaN.
    """
    z = points_cam[..., 2:]
    xy = points_cam[..., :2] / np.where(z > 0, z, np.nan)
    distorted = np.stack(_distortion(camera, xy[..., 0], xy[..., 1])[:2], axis=-1)
    return distorted @ camera.matrix[:2, :2].T + camera.matrix[:2, 2]


def project_jacobians(camera: Camera, points_cam: Array) -> tuple[Array, Array, Array]:
    """Return pixels (..., 2), their Jacobians by point (..., 2, 3) and by intrinsics (..., 2, n).

    The intrinsics are fx, fy, cx, cy and the coefficients of the lens model.
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
    d_k = lens.by_coefficients(camera.model, _coefficients(camera), x, y)
    d_f = np.stack([distorted_x, zero, one, zero, zero, distorted_y, zero, one], axis=-1)
    d_intrinsics = np.concatenate([d_f.reshape(*x.shape, 2, 4), K @ d_k], axis=-1)
    pixels = np.stack([distorted_x, distorted_y], axis=-1) @ K.T + camera.matrix[:2, 2]
    return pixels, d_point, d_intrinsics


def normalise(camera: Camera, pixels: Array) -> Array:
    """Return undistorted normalised coordinates (x/z, y/z) (..., 2) of pixels (..., 2).

    Newton's method to machine precision. Pixels beyond the reach of the lens model (where it folds
    over, or 90 degrees from the axis) give NaN.
    """
    (fx, skew, cx), (_, fy, cy), _ = camera.matrix.tolist()
    wanted_y = (pixels[..., 1] - cy) / fy
    wanted_x = (pixels[..., 0] - cx - skew * wanted_y) / fx
    if camera.model != "fisheye" and not camera.distortion.any():
        return np.stack([wanted_x, wanted_y], axis=-1)
    k = _coefficients(camera)
    x, y = lens.first_guess(camera.model, k, wanted_x, wanted_y)
    error, det = np.full(x.shape, np.inf), np.ones_like(x)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for _ in range(20):
            distorted_x, distorted_y, xx, cross, yy = _distortion(camera, x, y)
            error_x, error_y = distorted_x - wanted_x, distorted_y - wanted_y
            error, det = np.maximum(np.abs(error_x), np.abs(error_y)), xx * yy - cross * cross
            x = x - (yy * error_x - cross * error_y) / det
            y = y - (xx * error_y - cross * error_x) / det
            if (
                not np.fmax.reduce(np.ravel(error), initial=0.0) > 1e-9
            ):  # which this step has squared
                break
        good = (error < 1e-9) & (det > 0)
        good &= x * x + y * y < lens.reach(camera.model, k)  # another sheet may reach back
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
    distortion: tuple[float, ...] | None = None,
    *,
    model: CameraModel = "radial-tangential",
) -> Camera:
    """Return a camera whose principal point is the middle of its image; no coefficients: zeros."""
    fx, fy = focal_px if isinstance(focal_px, tuple) else (focal_px, focal_px)
    matrix = np.array([[fx, 0, (width - 1) / 2], [0, fy, (height - 1) / 2], [0, 0, 1]])
    k = np.zeros(len(COEFFICIENTS[model])) if distortion is None else np.array(distortion)
    return Camera(width=width, height=height, matrix=matrix, distortion=k, model=model)
