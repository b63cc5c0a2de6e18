"""How well a lens is known, part by part of the image: what a mean over the image would hide.

For each cell of the image: the standard deviation of the pixel of a point that stands there, the
corners that were seen there, and the mean of their residuals. A misfit at the edge shows as
residuals that grow towards it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.geometry.camera import Camera, intrinsics_names, project_jacobians, unproject
from vergence.geometry.head import HeadCalibration, stated_covariance, states_covariance
from vergence.geometry.se3 import cross

COLUMNS, ROWS = 12, 9
"""Cells of the map: squares in an image of 4 : 3."""
EDGE = 0.75
"""Distance from the image's middle, relative to that of its nearer border."""


@dataclass(frozen=True, eq=False)
class LensMap:
    """What is known of a camera in each cell of its image; ROWS from the top, COLUMNS."""

    std_px: Array
    """(ROWS, COLUMNS) standard deviation of the pixel of a direction, by the lens (root mean square
    of its coordinates); NaN where it reaches none, or where no covariance is stated."""
    corners: np.ndarray
    """(ROWS, COLUMNS) how many corners were seen; 0: never covered."""
    residual_px: Array
    """(ROWS, COLUMNS, 2) mean of projected minus seen; NaN where not covered."""
    residual_std_px: Array
    """(ROWS, COLUMNS) standard error of a coordinate of that mean; NaN for fewer than two corners.
    """

    @property
    def covered(self) -> float:
        """The part of the image in which corners were seen."""
        return float((self.corners > 0).mean())


def lens_maps(
    head: HeadCalibration, corners: Mapping[str, Array], residuals_px: Mapping[str, Array]
) -> dict[str, LensMap]:
    """Map the lens of each camera that has residuals.

    Corners and residuals, which are projected minus seen, are (V, K, 2) pixels, NaN where not seen.
    The head states its accuracy.
    """
    return {name: _map(head, name, corners[name], own) for name, own in residuals_px.items()}


def _map(head: HeadCalibration, name: str, corners: Array, residuals: Array) -> LensMap:
    camera = head.cameras[name].intrinsics
    u, v = (
        (np.arange(n) + 0.5) * size / n - 0.5
        for n, size in ((COLUMNS, camera.width), (ROWS, camera.height))
    )
    grid = np.stack(np.meshgrid(u, v), axis=-1)
    covariance = pixel_covariance(head, name, grid.reshape(-1, 2))
    std = np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 2).reshape(ROWS, COLUMNS)
    used = np.isfinite(residuals).all(axis=-1) & np.isfinite(corners).all(axis=-1)
    place, off = corners[used], residuals[used]
    column, row = (
        np.clip((place[:, k] + 0.5) * n / size, 0, n - 1).astype(int)
        for k, n, size in ((0, COLUMNS, camera.width), (1, ROWS, camera.height))
    )
    cell, cells = row * COLUMNS + column, ROWS * COLUMNS
    count = np.bincount(cell, minlength=cells)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.stack([np.bincount(cell, e, cells) / count for e in off.T], axis=-1)
        squares = np.bincount(cell, ((off - mean[cell]) ** 2).sum(axis=1), cells)
        error = np.sqrt(squares / (2 * (count - 1) * count))
    return LensMap(
        std_px=std,
        corners=count.reshape(ROWS, COLUMNS),
        residual_px=mean.reshape(ROWS, COLUMNS, 2),
        residual_std_px=np.where(count > 1, error, np.nan).reshape(ROWS, COLUMNS),
    )


def pixel_covariance(head: HeadCalibration, name: str, pixels: Array) -> Array:
    """Return the covariance (N, 2, 2) [px^2] of where directions are projected, by the lens.

    The directions are those of the named camera's pixels (N, 2). A rotation of the camera that
    compensates for an error of its lens is removed by `without_turn`. NaN if a pixel has no
    direction, or the head states no covariance.
    """
    camera = head.camera(name).intrinsics
    total = np.full((len(pixels), 2, 2), np.nan)
    if not states_covariance(head):
        return total
    stated, C = stated_covariance(head, [f"{name}.{each}" for each in intrinsics_names(camera)])
    both = np.concatenate([pixels, reference_pixels(camera)])
    with np.errstate(invalid="ignore"):
        rows = project_jacobians(camera, unit_rays(camera, both))[2][..., stated]
    rows = without_turn(camera, pixels, rows[: len(pixels)], rows[len(pixels) :])
    return rows @ C @ np.swapaxes(rows, 1, 2)


def reference_pixels(camera: Camera) -> Array:
    """Return pixels (M, 2) about the image's middle, from which a camera's turn is estimated."""
    x, y = np.meshgrid(*2 * [np.linspace(-1, 1, 9)])
    place = np.stack([x, y], axis=-1)[np.hypot(x, y) <= 1]
    middle = np.array([camera.width - 1, camera.height - 1]) / 2
    return middle + EDGE * middle.min() * place


def without_turn(camera: Camera, pixels: Array, errors: Array, at_reference: Array) -> Array:
    """Remove from errors (N, 2, n) at pixels (N, 2) the camera rotation that explains them best.

    The rotation is fitted to the errors (M, 2, n) at reference_pixels. The mounting compensates
    for a rotation, so that it is no error of the lens.
    """
    with np.errstate(invalid="ignore"):
        by_turn, reference = (
            cross(rays[:, None], project_jacobians(camera, rays)[1])
            for rays in (unit_rays(camera, each) for each in (pixels, reference_pixels(camera)))
        )
    good = np.isfinite(reference).all(axis=(1, 2)) & np.isfinite(at_reference).all(axis=(1, 2))
    turn = np.linalg.lstsq(
        reference[good].reshape(-1, 3), at_reference[good].reshape(-1, at_reference.shape[-1])
    )[0]
    return errors - by_turn @ turn


def unit_rays(camera: Camera, pixels: Array) -> Array:
    """Return unit vectors (N, 3) in frame cam towards what is seen at pixels (N, 2)."""
    rays = unproject(camera, pixels)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)
