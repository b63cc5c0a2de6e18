"""Where the pixels of a rectified image lie in the real one.

A map is computed on a grid and interpolated; the lens is undone by it, so any lens model will do.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from vergence.arrays import Array
from vergence.geometry.camera import Camera, in_reach, project

GRID_PX = 16
"""Distance of the pixels for which the map is computed."""
MAP_ERROR_PX = 0.01
"""Largest error of the map between them."""
_OUTSIDE = -1e4
"""In a map: no pixel of the camera shows this direction."""


def rectified_map(
    camera: Camera, R_rect_cam: Array, matrix: Array, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return column and row (H, W) float32 in the real image of each rectified pixel.

    They are exact every GRID_PX, and between by cubics through four points.
    Where these would miss by more than MAP_ERROR_PX, as fourth differences tell, every pixel is
    projected: at the ends of a view, and where a lens is near its limit.
    """
    nodes = [np.arange(-1, _nodes(n) - 1) * float(GRID_PX) for n in size]
    coarse = _where(camera, R_rect_cam, matrix, *np.meshgrid(*nodes))
    rough = np.zeros(coarse.shape[:2], bool)
    for axis in (0, 1):
        # A cubic's largest error in the middle one of three intervals is 3/128 of the difference.
        missed = np.abs(np.diff(coarse, 4, axis=axis)).max(axis=-1) * (3 / 128)
        inside = [slice(None), slice(None)]
        inside[axis] = slice(2, -2)
        rough[tuple(inside)] |= missed > MAP_ERROR_PX / 2
    cells = sliding_window_view(rough, (4, 4)).any(axis=(-1, -2))
    across, down = (_cubic(n) for n in size)
    planes = np.moveaxis(coarse, -1, 0).astype(np.float32)
    map_x, map_y = (down @ plane @ across.T for plane in planes)
    v, u = np.nonzero(np.kron(cells, np.ones((GRID_PX, GRID_PX), bool))[: size[1], : size[0]])
    if len(u):
        map_x[v, u], map_y[v, u] = _where(camera, R_rect_cam, matrix, u, v).T
    return map_x, map_y


def _nodes(n: int) -> int:
    """Return how many nodes n pixels need: at least the five of a fourth difference."""
    return max(-(-n // GRID_PX) + 3, 5)


@lru_cache(maxsize=8)
def _cubic(n: int) -> np.ndarray:
    """Return weights (n, m) of the nodes at -GRID_PX, 0, GRID_PX, ... for n pixels."""
    cell, t = np.divmod(np.arange(n), GRID_PX)
    t = t / GRID_PX
    weights = np.zeros((n, _nodes(n)), np.float32)
    four = np.array([-1, 0, 1, 2])
    for k, at in enumerate(four):
        others = four[four != at]
        weights[np.arange(n), cell + k] = np.prod([(t - x) / (at - x) for x in others], axis=0)
    return weights


def _where(camera: Camera, R_rect_cam: Array, matrix: Array, u: np.ndarray, v: np.ndarray) -> Array:
    """Return where (..., 2) in the real image rectified pixels are; _OUTSIDE: nowhere."""
    return pixels_of_rays(
        camera, np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(matrix).T @ R_rect_cam
    )


def pixels_of_rays(camera: Camera, rays: Array) -> Array:
    """Return where (..., 2) an image shows points (..., 3) in frame cam; _OUTSIDE: nowhere."""
    good = in_reach(camera, *np.moveaxis(rays, -1, 0))
    pixels = project(camera, np.where(good[..., None], rays, [0.0, 0.0, 1.0]))
    return np.where(good[..., None], pixels, _OUTSIDE).clip(_OUTSIDE, -_OUTSIDE)
