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
    pixels, by_point, by_lens = projection_rows(camera, np.moveaxis(points_cam, -1, 0))
    by_point, by_lens = (np.moveaxis(each, (0, 1), (-2, -1)) for each in (by_point, by_lens))
    return np.moveaxis(pixels, 0, -1), by_point, by_lens


def projection_rows(
    camera: Camera, points_cam: Array, *, intrinsics: bool = True
) -> tuple[Array, Array, Array]:
    """Return what project_jacobians does, components first: (2, ...), (2, 3, ...), (2, n, ...).

    Points are (3, ...) too; numpy is several times as fast on long rows as on small matrices. Where
    the derivatives by the intrinsics are not wanted, n is 0.
    """
    (fx, skew, cx), (_, fy, cy), _ = camera.matrix.tolist()
    z = points_cam[2]
    inv_z = 1 / np.where(z > 0, z, np.nan)
    x, y = points_cam[0] * inv_z, points_cam[1] * inv_z
    distorted_x, distorted_y, xx, cross, yy = _distortion(camera, x, y)
    pixels, by_point = np.empty((2, *z.shape)), np.empty((2, 3, *z.shape))
    pixels[0], pixels[1] = fx * distorted_x + skew * distorted_y + cx, fy * distorted_y + cy
    by_point[0, 0], by_point[0, 1] = fx * xx + skew * cross, fx * cross + skew * yy
    by_point[1, 0], by_point[1, 1] = fy * cross, fy * yy
    by_point[:, :2] *= inv_z
    by_point[:, 2] = -x * by_point[:, 0] - y * by_point[:, 1]
    if not intrinsics:
        return pixels, by_point, np.empty((2, 0, *z.shape))
    k = _coefficients(camera)
    by_intrinsics = np.zeros((2, 4 + len(k), *z.shape))
    by_intrinsics[0, 0], by_intrinsics[1, 1] = distorted_x, distorted_y
    by_intrinsics[0, 2] = by_intrinsics[1, 3] = 1.0
    of_x, of_y = lens.by_coefficients(camera.model, k, x, y)
    by_intrinsics[0, 4:] = fx * of_x + skew * of_y
    by_intrinsics[1, 4:] = fy * of_y
    return pixels, by_point, by_intrinsics


def normalise(camera: Camera, pixels: Array) -> Array:
    """Return undistorted normalised coordinates (x/z, y/z) (..., 2) of pixels (..., 2).

    Newton's method to machine precision. Pixels beyond the reach of the lens model (where it folds
    over, or 90 degrees from the axis) give NaN.
    """
    xy, _ = normalised_rows(camera, np.moveaxis(pixels, -1, 0))
    return np.ascontiguousarray(np.moveaxis(xy, 0, -1))


def normalised_rows(camera: Camera, pixels: Array) -> tuple[Array, Array]:
    """Return normalised coordinates (2, ...) of pixels (2, ...), and their slopes (2, 2, ...).

    The slopes are the derivatives of the pixels by the normalised coordinates, to the precision to
    which these were known before the last step, 1e-9.
    """
    (fx, skew, cx), (_, fy, cy), _ = camera.matrix.tolist()
    wanted_y = (pixels[1] - cy) / fy
    wanted_x = (pixels[0] - cx - skew * wanted_y) / fx
    xy, slopes = np.empty(pixels.shape), np.empty((2, *pixels.shape))
    if camera.model != "fisheye" and not camera.distortion.any():
        xy[0], xy[1] = wanted_x, wanted_y
        slopes[0, 0], slopes[0, 1], slopes[1, 0], slopes[1, 1] = fx, skew, 0.0, fy
        return xy, slopes
    k = _coefficients(camera)
    if wanted_x.size == 1:  # numpy is six times as fast on a number as on an array of one
        wanted_x, wanted_y = wanted_x.reshape(-1)[0], wanted_y.reshape(-1)[0]
    x, y = lens.first_guess(camera.model, k, wanted_x, wanted_y)
    xx = cross = yy = det = squared = x
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for _ in range(20):
            distorted_x, distorted_y, xx, cross, yy = _distortion(camera, x, y)
            error_x, error_y = distorted_x - wanted_x, distorted_y - wanted_y
            squared, det = error_x * error_x + error_y * error_y, xx * yy - cross * cross
            x = x - (yy * error_x - cross * error_y) / det
            y = y - (xx * error_y - cross * error_x) / det
            if not (squared > 1e-18).any():  # NaN is none; this step has squared the error
                break
        good = (squared < 1e-18) & (det > 0)
        good &= x * x + y * y < lens.reach(camera.model, k)  # another sheet may reach back
    xy[0], xy[1] = x, y
    if not good.all():
        xy[:, ~good] = np.nan
    slopes[0, 0], slopes[0, 1] = fx * xx + skew * cross, fx * cross + skew * yy
    slopes[1, 0], slopes[1, 1] = fy * cross, fy * yy
    return xy, slopes


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
