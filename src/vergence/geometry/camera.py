"""Pinhole camera with distortion: from points to pixels and back, with derivatives.

Frame `cam` is OpenCV's: x right, y down, z forward; pixel (0, 0) is the centre of the top-left
pixel. The lens models are OpenCV's (see `geometry.lens`), so that both agree to the last digit;
unlike OpenCV, the matrix may have skew (the paper's Eq. 2). Directions at 90 degrees from the axis
and beyond are not supported, whatever the lens. See docs/conventions.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from functools import cached_property
from numbers import Integral
from typing import Annotated, Any

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from vergence.arrays import Array, Matrix3, VectorN
from vergence.errors import VergenceError
from vergence.geometry import lens
from vergence.geometry.batches import batch_first, batch_last, ignoring_invalid, vector
from vergence.geometry.lens import COEFFICIENTS, PINHOLE, CameraModel

MAX_IMAGE_PX = 20_000  # side of an image, beyond any camera
MAX_IMAGE_AREA_PX = 50_000_000
"""Width times height; decoding an image of this size takes 300 MB."""
MIN_FOCAL_PX = 1e-6  # above zero by more than rounding
ImageSide = Annotated[int, Field(gt=0, le=MAX_IMAGE_PX)]
"""The width or height of an image."""
MAX_NUMBER = 1e12
"""Largest number in the matrix and the distortion; with larger ones projections overflow."""


def check_image_size(width: int, height: int) -> None:
    """Raise ValueError if an image has more pixels than are read."""
    if width * height > MAX_IMAGE_AREA_PX:
        raise ValueError(
            f"images have at most {MAX_IMAGE_AREA_PX:,} pixels, found {width} x {height}"
        )


def is_image_size(size: Any) -> bool:
    """Check whether this is a width and a height, in whole pixels, that an image may have."""
    if np.shape(size) != (2,) or not all(isinstance(n, Integral) for n in size):
        return False
    width, height = map(int, size)
    return 0 < min(width, height) <= max(width, height) <= MAX_IMAGE_PX and (
        width * height <= MAX_IMAGE_AREA_PX
    )


def check_image_fits(name: str, camera: Camera, shape: Sequence[int], *, whose: str) -> None:
    """Raise VergenceError if images (H, W, ...) do not have the size of a calibrated camera."""
    if tuple(shape[:2]) != (camera.height, camera.width):
        raise VergenceError(
            f"The calibration of {name} is for images of {camera.width} x {camera.height} px, but "
            f"{whose} have {shape[1]} x {shape[0]} px."
        )


@dataclass(frozen=True, eq=False, config=ConfigDict(extra="forbid"))
class Camera:
    """Intrinsic parameters of one camera; ValueError where they are not possible."""

    width: ImageSide
    """Image width [px]."""
    height: ImageSide
    """Image height [px]."""
    matrix: Matrix3
    """A of Eq. 2: [[alpha, gamma, u0], [0, beta, v0], [0, 0, 1]] [px]."""
    distortion: VectorN = field(default_factory=lambda: np.zeros(0))
    """The coefficients of the lens model, in the order of `lens.COEFFICIENTS`; empty: zeros."""
    model: CameraModel = "radial-tangential"
    """The lens model; files of earlier versions, which do not state one, have this one."""

    def __post_init__(self) -> None:
        names = COEFFICIENTS[self.model]
        if not self.distortion.size:
            zeros = np.zeros(len(names))
            zeros.setflags(write=False)
            object.__setattr__(self, "distortion", zeros)
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

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self.width, self.height

    @cached_property
    def coefficients(self) -> tuple[float, ...]:
        """The distortion, in plain numbers."""
        return tuple(self.distortion.tolist())


def intrinsics_names(camera: Camera) -> tuple[str, ...]:
    """List the names of a camera's intrinsics: fx, fy, cx, cy, k1, ..., in their order."""
    return (*PINHOLE, *COEFFICIENTS[camera.model])


def _pinhole(camera: Camera) -> tuple[float, float, float, float, float]:
    """Unpack fx, skew, cx, fy, cy."""
    (fx, skew, cx), (_, fy, cy), _ = camera.matrix.tolist()
    return fx, skew, cx, fy, cy


def _in_front(points_cam: Array) -> tuple[Array, Array, Array]:
    """Divide points in frame cam: x/z, y/z and 1/z (...); NaN where z is not above zero."""
    x, y, z = batch_last(points_cam)
    inv_z = 1 / np.where(z > 0, z, np.nan)[()]
    return x * inv_z, y * inv_z, inv_z


@ignoring_invalid
def project(camera: Camera, points_cam: Array) -> Array:
    """Compute the pixels (..., 2) of points (..., 3) in frame cam (Eq. 1, with distortion).

    Points that are not in front of the camera, and NaN, give NaN.
    """
    fx, skew, cx, fy, cy = _pinhole(camera)
    x, y, _ = _in_front(points_cam)
    x, y, *_ = lens.distort(camera.model, camera.coefficients, x, y)
    return vector(fx * x + skew * y + cx, fy * y + cy)


@ignoring_invalid
def project_jacobians(
    camera: Camera, points_cam: Array, *, intrinsics: bool = True
) -> tuple[Array, Array, Array]:
    """Compute pixels (..., 2), their Jacobians by point (..., 2, 3) and by intrinsics (..., 2, n).

    The intrinsics are those of `intrinsics_names`, or none.
    """
    fx, skew, cx, fy, cy = _pinhole(camera)
    x, y, inv_z = _in_front(points_cam)
    x_lens, y_lens, xx, xy, yy = lens.distort(camera.model, camera.coefficients, x, y)
    pixels = vector(fx * x_lens + skew * y_lens + cx, fy * y_lens + cy)
    batch = points_cam.shape[:-1]
    by_point = np.empty((2, 3, *batch))
    by_point[0, 0], by_point[0, 1] = (fx * xx + skew * xy) * inv_z, (fx * xy + skew * yy) * inv_z
    by_point[1, 0], by_point[1, 1] = fy * xy * inv_z, fy * yy * inv_z
    by_point[:, 2] = -x * by_point[:, 0] - y * by_point[:, 1]
    of_lens = len(COEFFICIENTS[camera.model]) if intrinsics else -4
    by_intrinsics = np.empty((2, 4 + of_lens, *batch))
    if intrinsics:
        by_intrinsics[:, :4] = 0.0
        by_intrinsics[0, 0], by_intrinsics[1, 1] = x_lens, y_lens
        by_intrinsics[0, 2] = by_intrinsics[1, 3] = 1.0
        of_x, of_y = lens.by_coefficients(camera.model, camera.coefficients, x, y)
        for k, (a, b) in enumerate(zip(of_x, of_y, strict=True), 4):
            by_intrinsics[0, k], by_intrinsics[1, k] = fx * a + skew * b, fy * b
    return pixels, batch_first(by_point, 2), batch_first(by_intrinsics, 2)


@ignoring_invalid  # infinity times zero
def in_valid_field(camera: Camera, x: Array, y: Array, z: Array) -> np.ndarray:
    """Check whether points (x, y, z) in frame cam are in front of it and within `lens.reach`."""
    limit = lens.reach(camera.model, camera.coefficients)
    return (z > 0) & (x * x + y * y < limit * (z * z))


def displaced_by_distortion(camera: Camera) -> Array:
    """Compute X (n, n) [px^2]: a change d of the distortion moves pixels by d^T X d (squared)."""
    points = unproject(camera, pixel_grid(camera))
    points = points[np.isfinite(points).all(axis=1)]
    _, _, by_lens = project_jacobians(camera, points)
    J = by_lens[:, :, -len(COEFFICIENTS[camera.model]) :]
    return np.einsum("nij,nik->jk", J, J) / len(points)


def pixel_grid(camera: Camera) -> Array:
    """Spread 16 x 16 pixels (256, 2) evenly over an image."""
    u, v = np.meshgrid(*((np.arange(16) + 0.5) / 16 * n - 0.5 for n in camera.size))
    return np.stack([u.ravel(), v.ravel()], axis=1)


def normalise(camera: Camera, pixels: Array) -> Array:
    """Undistort pixels (..., 2) to normalised coordinates (x/z, y/z) (..., 2).

    Pixels beyond the reach of the lens model (where it folds over, or at 90 degrees) give NaN.
    """
    return np.ascontiguousarray(normalise_jacobian(camera, pixels)[0])


def unproject(camera: Camera, pixels: Array) -> Array:
    """Compute the points (..., 3) in frame cam that pixels show at depth 1; see `normalise`."""
    xy = normalise(camera, pixels)
    return np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)


@ignoring_invalid
def normalise_jacobian(camera: Camera, pixels: Array) -> tuple[Array, Array]:
    """Compute normalised coordinates (..., 2) of pixels (..., 2), and derivatives (..., 2, 2).

    By Newton's method to machine precision; derivatives are those before the last step.
    """
    fx, skew, cx, fy, cy = _pinhole(camera)
    u, v = batch_last(pixels)
    wanted_y = (v - cy) / fy
    wanted_x = (u - cx - skew * wanted_y) / fx
    if camera.model != "fisheye" and not camera.distortion.any():
        by_pixels = np.array([[1 / fx, -skew / (fx * fy)], [0.0, 1 / fy]])
        return vector(wanted_x, wanted_y), by_pixels
    k = camera.coefficients
    x, y = lens.first_guess(camera.model, k, wanted_x, wanted_y)
    squared = det = by_x = by_xy = by_y = x
    for _ in range(20):
        x_lens, y_lens, xx, xy, yy = lens.distort(camera.model, k, x, y)
        error_x, error_y = x_lens - wanted_x, y_lens - wanted_y
        squared, det = error_x * error_x + error_y * error_y, xx * yy - xy * xy
        by_x, by_xy, by_y = yy / det, -xy / det, xx / det  # the inverse of the lens's derivatives
        x, y = x - by_x * error_x - by_xy * error_y, y - by_xy * error_x - by_y * error_y
        if not (squared > 1e-18).any():  # NaN is none; this step has squared the error
            break
    good = (squared < 1e-18) & (det > 0)
    good &= x * x + y * y < lens.reach(camera.model, k)  # another sheet may reach back
    if not good.all():
        x, y = np.where(good, x, np.nan)[()], np.where(good, y, np.nan)[()]
    by_pixels = np.empty((2, 2, *x.shape))
    by_pixels[0, 0], by_pixels[1, 0] = by_x / fx, by_xy / fx
    by_pixels[0, 1] = (by_xy - skew * by_pixels[0, 0]) / fy
    by_pixels[1, 1] = (by_y - skew * by_pixels[1, 0]) / fy
    return vector(x, y), batch_first(by_pixels, 2)


@ignoring_invalid
def pixel_area(camera: Camera, xy: Array) -> Array:
    """Compute the area (...,) in the plane z = 1 of one pixel at undistorted xy (..., 2)."""
    *_, xx, cross, yy = lens.distort(camera.model, camera.coefficients, xy[..., 0], xy[..., 1])
    return 1 / (camera.matrix[0, 0] * camera.matrix[1, 1] * (xx * yy - cross * cross))


def undistort(camera: Camera, pixels: Array) -> Array:
    """Correct pixels (..., 2) for distortion: those of Eqs. 1-4."""
    return normalise(camera, pixels) @ camera.matrix[:2, :2].T + camera.matrix[:2, 2]


def pinhole(
    width: int,
    height: int,
    focal_px: float | tuple[float, float],
    distortion: tuple[float, ...] | None = None,
    *,
    model: CameraModel = "radial-tangential",
) -> Camera:
    """Make a camera whose principal point is the middle of its image."""
    fx, fy = focal_px if isinstance(focal_px, tuple) else (focal_px, focal_px)
    matrix = np.array([[fx, 0, (width - 1) / 2], [0, fy, (height - 1) / 2], [0, 0, 1]])
    return Camera(width, height, matrix, np.array(distortion or ()), model)
