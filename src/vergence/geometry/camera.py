"""Pinhole camera with distortion: from points to pixels and back, with derivatives.

Frame `cam` is OpenCV's: x right, y down, z forward; pixel (0, 0) is the centre of the top-left
pixel. The lens models are OpenCV's (see `geometry.lens`), so that both agree to the last digit;
unlike OpenCV, the matrix may have skew (the paper's Eq. 2). Directions at 90 degrees from the axis
and beyond are not supported, whatever the lens. See docs/conventions.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace
from functools import cached_property
from numbers import Integral
from typing import Annotated, Any

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from vergence.arrays import Array, Matrix3, VectorN
from vergence.errors import VergenceError
from vergence.geometry import lens
from vergence.geometry.components import (
    Component,
    Rows,
    anywhere,
    components,
    ignoring_invalid,
    positive,
    quotient,
    stacked,
    where,
)
from vergence.geometry.lens import COEFFICIENTS, CameraModel

MAX_IMAGE_PX = 20_000
MAX_IMAGE_AREA_PX = 50_000_000
"""Width times height; decoding an image of this size takes 300 MB."""
MIN_FOCAL_PX = 1e-6
ImageSide = Annotated[int, Field(gt=0, le=MAX_IMAGE_PX)]
"""The width or height of an image."""
MAX_NUMBER = 1e12
"""Largest number in the matrix and the distortion; with larger ones projections overflow."""
_GRID = 16
"""Pixels along each axis of the image in `pixel_grid`."""


def check_image_size(width: int, height: int) -> None:
    """Raise ValueError if an image has more pixels than are read."""
    if width * height > MAX_IMAGE_AREA_PX:
        raise ValueError(
            f"images have at most {MAX_IMAGE_AREA_PX:,} pixels, found {width} x {height}"
        )


def is_image_size(size: Any) -> bool:
    """Return whether this is a width and a height, in whole pixels, that an image may have."""
    if np.shape(size) != (2,) or not all(isinstance(n, Integral) for n in size):
        return False
    width, height = map(int, size)
    return 0 < min(width, height) <= max(width, height) <= MAX_IMAGE_PX and (
        width * height <= MAX_IMAGE_AREA_PX
    )


def check_image_fits(name: str, camera: Camera, shape: Sequence[int], *, whose: str) -> None:
    """Raise VergenceError if images are not as large as those that a camera was calibrated with.

    Args:
        name: of the camera, for the message.
        camera: its intrinsics.
        shape: (H, W, ...) of an image.
        whose: images they are, for the message, such as "the frame's".
    """
    if tuple(shape[:2]) != (camera.height, camera.width):
        raise VergenceError(
            f"The calibration of {name} is for images of {camera.width} x {camera.height} px, but "
            f"{whose} have {shape[1]} x {shape[0]} px."
        )


_UNDISTORTED = np.zeros(0)  # as many zeros as the lens model has coefficients


@dataclass(frozen=True, eq=False, config=ConfigDict(extra="forbid"))
class Camera:
    """Intrinsic parameters of one camera; ValueError where they are not possible."""

    width: ImageSide
    """Image width [px]."""
    height: ImageSide
    """Image height [px]."""
    matrix: Matrix3
    """A of Eq. 2: [[alpha, gamma, u0], [0, beta, v0], [0, 0, 1]] [px]."""
    distortion: VectorN = field(default_factory=lambda: _UNDISTORTED)
    """The coefficients of the lens model, in the order of `lens.COEFFICIENTS`; left out: zeros."""
    model: CameraModel = "radial-tangential"
    """The lens model; files of earlier versions, which do not state one, have this one."""

    def __post_init__(self) -> None:
        names = COEFFICIENTS[self.model]
        if self.distortion is _UNDISTORTED:
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


def _distortion(camera: Camera, x: Array, y: Array) -> tuple[Array, ...]:
    """Return distorted x', y', and dx'/dx, dx'/dy (which is dy'/dx), dy'/dy, each shaped as x."""
    return lens.distort(camera.model, camera.coefficients, x, y)


def project(camera: Camera, points_cam: Array) -> Array:
    """Return the pixels (..., 2) of points (..., 3) in frame cam (Eq. 1, with distortion).

    Points that are not in front of the camera, and NaN, give NaN.
    """
    pixel = pixel_rows(camera, components(np.moveaxis(points_cam, -1, 0)))
    return np.moveaxis(stacked(pixel, points_cam.shape[:-1]), 0, -1)


def pixel_rows(camera: Camera, point: Sequence[Component]) -> Sequence[Component]:
    """Return the pixel of a point in frame cam, by components."""
    (fx, skew, cx), (_, fy, cy), _ = camera.matrix.tolist()
    inv_z = 1 / positive(point[2])
    x, y, *_ = _distortion(camera, point[0] * inv_z, point[1] * inv_z)
    return fx * x + skew * y + cx, fy * y + cy


def project_jacobians(camera: Camera, points_cam: Array) -> tuple[Array, Array, Array]:
    """Return pixels (..., 2), their Jacobians by point (..., 2, 3) and by intrinsics (..., 2, n).

    The intrinsics are fx, fy, cx, cy and the coefficients of the lens model.
    """
    shape = points_cam.shape[:-1]
    pixels, *rows = projection_rows(camera, components(np.moveaxis(points_cam, -1, 0)))
    by_point, by_lens = (np.moveaxis(stacked(each, shape, 2), (0, 1), (-2, -1)) for each in rows)
    return np.moveaxis(stacked(pixels, shape), 0, -1), by_point, by_lens


def in_reach(camera: Camera, x: Component, y: Component, z: Component) -> Component:
    """Return whether points (x, y, z) in frame cam are in front of a camera and before its reach.

    Beyond it a lens model folds over, and shows what no camera would see; see `lens.reach`.
    """
    limit = lens.reach(camera.model, camera.coefficients)
    with ignoring_invalid(z):  # infinity times zero
        return (z > 0) & (x * x + y * y < limit * (z * z))


def projection_rows(
    camera: Camera, point: Sequence[Component], *, intrinsics: bool = True
) -> tuple[Sequence[Component], Rows, Rows]:
    """Return what project_jacobians does, by components: (2), (2, 3) and (2, n).

    Where the derivatives by the intrinsics are not wanted, n is 0.
    """
    (fx, skew, cx), (_, fy, cy), _ = camera.matrix.tolist()
    inv_z = 1 / positive(point[2])
    x, y = point[0] * inv_z, point[1] * inv_z
    distorted_x, distorted_y, xx, cross, yy = _distortion(camera, x, y)
    by_point = []
    for along_x, along_y in (
        (fx * xx + skew * cross, fx * cross + skew * yy),
        (fy * cross, fy * yy),
    ):
        along_x, along_y = along_x * inv_z, along_y * inv_z
        by_point.append((along_x, along_y, -x * along_x - y * along_y))
    pixel = fx * distorted_x + skew * distorted_y + cx, fy * distorted_y + cy
    if not intrinsics:
        return pixel, by_point, ((), ())
    of_x, of_y = lens.by_coefficients(camera.model, camera.coefficients, x, y)
    by_intrinsics = (
        [distorted_x, 0.0, 1.0, 0.0, *(fx * a + skew * b for a, b in zip(of_x, of_y, strict=True))],
        [0.0, distorted_y, 0.0, 1.0, *(fy * b for b in of_y)],
    )
    return pixel, by_point, by_intrinsics


def displaced_by_distortion(camera: Camera) -> Array:
    """Return X (n, n) [px^2]: how far pixels move when the n distortion coefficients change.

    A change d of the coefficients moves the pixels of the image by d^T X d in the mean square.
    """
    points = unproject(camera, pixel_grid(camera))
    points = points[np.isfinite(points).all(axis=1)]
    _, _, by_lens = project_jacobians(camera, points)
    J = by_lens[:, :, -len(COEFFICIENTS[camera.model]) :]
    return np.einsum("nij,nik->jk", J, J) / len(points)


def pixel_grid(camera: Camera) -> Array:
    """Return pixels (N, 2) evenly spread over an image."""
    u, v = np.meshgrid(*((np.arange(_GRID) + 0.5) / _GRID * n - 0.5 for n in camera.size))
    return np.stack([u.ravel(), v.ravel()], axis=1)


def normalise(camera: Camera, pixels: Array) -> Array:
    """Return undistorted normalised coordinates (x/z, y/z) (..., 2) of pixels (..., 2).

    Newton's method to machine precision. Pixels beyond the reach of the lens model (where it folds
    over, or 90 degrees from the axis) give NaN.
    """
    xy, _ = normalised_rows(camera, *components(np.moveaxis(pixels, -1, 0)))
    return np.ascontiguousarray(np.moveaxis(stacked(xy, pixels.shape[:-1]), 0, -1))


def unproject(camera: Camera, pixels: Array) -> Array:
    """Return the points (..., 3) in frame cam that pixels (..., 2) show at depth 1.

    NaN where `normalise` gives NaN.
    """
    xy = normalise(camera, pixels)
    return np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)


def normalised_rows(camera: Camera, u: Component, v: Component) -> tuple[Sequence[Component], Rows]:
    """Return normalised coordinates (x/z, y/z) of pixels, and their slopes (2, 2), by components.

    The slopes are the derivatives of the pixels by the normalised coordinates. They are taken
    before the last step of Newton's method, where the coordinates are known to 1e-9.
    """
    (fx, skew, cx), (_, fy, cy), _ = camera.matrix.tolist()
    wanted_y = (v - cy) / fy
    wanted_x = (u - cx - skew * wanted_y) / fx
    if camera.model != "fisheye" and not camera.distortion.any():
        return (wanted_x, wanted_y), ((fx, skew), (0.0, fy))
    k = camera.coefficients
    with ignoring_invalid(wanted_x):
        x, y = lens.first_guess(camera.model, k, wanted_x, wanted_y)
        xx = cross = yy = det = squared = x
        for _ in range(20):
            distorted_x, distorted_y, xx, cross, yy = _distortion(camera, x, y)
            error_x, error_y = distorted_x - wanted_x, distorted_y - wanted_y
            squared, det = error_x * error_x + error_y * error_y, xx * yy - cross * cross
            x = x - quotient(yy * error_x - cross * error_y, det)
            y = y - quotient(xx * error_y - cross * error_x, det)
            if not anywhere(squared > 1e-18):  # NaN is none; this step has squared the error
                break
        good = (squared < 1e-18) & (det > 0)
        good = good & (x * x + y * y < lens.reach(camera.model, k))  # another sheet may reach back
    x, y = where(good, x), where(good, y)
    return (x, y), ((fx * xx + skew * cross, fx * cross + skew * yy), (fy * cross, fy * yy))


def pixel_area(camera: Camera, xy: Array) -> Array:
    """Return the area (...,) in the plane z = 1 of one pixel at undistorted xy (..., 2)."""
    _, _, xx, cross, yy = _distortion(camera, xy[..., 0], xy[..., 1])
    return 1 / (camera.matrix[0, 0] * camera.matrix[1, 1] * (xx * yy - cross * cross))


def undistort(camera: Camera, pixels: Array) -> Array:
    """Return distortion-corrected pixels (..., 2): what Eqs. 1-4 speak of."""
    return normalise(camera, pixels) @ camera.matrix[:2, :2].T + camera.matrix[:2, 2]


def half_size(camera: Camera) -> Camera:
    """Return the camera of an image whose pixels are means of 2 x 2; an odd last one is lost."""
    matrix = camera.matrix.copy()
    matrix[:2] /= 2
    matrix[:2, 2] -= 1 / 4  # (0, 0) is the middle of a pixel
    width, height = camera.width // 2, camera.height // 2
    return replace(camera, width=width, height=height, matrix=matrix)


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
