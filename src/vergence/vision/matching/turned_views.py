"""Turn two images of a scene into pinhole images of one orientation, and pixels back.

Each is turned half of the way to the other by the predicted geometry, so that points of the scene
are displaced by little more than the disparity.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vergence.arrays import Array, nearest_rotation
from vergence.geometry.camera import Camera, project
from vergence.vision.exposure import grey_levels
from vergence.vision.matching.least_squares_matching import WINDOW_PX

_MAP_STEP_PX = 8
"""Step of the grid on which the lens is evaluated [px]; matches return by the same map."""


@dataclass(frozen=True, eq=False)
class TurnedViews:
    """Two images of the scene, each turned half of the way to the other."""

    first: np.ndarray
    """(H, W) grey."""
    second: np.ndarray
    """(H, W) grey."""
    second_image: np.ndarray
    """(H, W) grey, as it was taken."""
    maps: tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
    """For each view, u and v (H, W) of its pixels in its image."""
    inside: np.ndarray
    """(H / 2, W / 2) bool, for every second pixel: both images show it."""
    focal: float
    middle: Array
    """(2,) principal point of the views [px]."""
    R_view_first: Array
    """(3, 3)"""
    shift: Array
    """(3,) displacement of a point from the first view to the second [m]."""


def turned_views(
    images: tuple[np.ndarray, np.ndarray], cameras: tuple[Camera, Camera], T_second_first: Array
) -> TurnedViews:
    """Turn two images (H, W) or (H, W, 3) uint8 into pinhole images of one orientation.

    T_second_first (4, 4) is the predicted relative pose of the cameras. The views have the size of
    the first camera's image and the mean of both focal lengths.
    """
    # Each camera turns half of the way.
    R_second_view = nearest_rotation(np.eye(3) + T_second_first[:3, :3])
    focal = (cameras[0].matrix[0, 0] + cameras[1].matrix[0, 0]) / 2
    size = cameras[0].width, cameras[0].height
    middle = (np.array(size) - 1) / 2
    greys, views, maps, inside = [], [], [], []
    for image, camera, R_cam_view in zip(
        images, cameras, (R_second_view.T, R_second_view), strict=True
    ):
        u, v = _map(camera, R_cam_view, focal, middle, size)
        grey = grey_levels(image)
        greys.append(grey)
        # Replicated borders have no contrast.
        views.append(cv2.remap(grey, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
        maps.append((u, v))
        u, v = u[::2, ::2], v[::2, ::2]
        inside.append((u > 0) & (v > 0) & (u < camera.width - 1) & (v < camera.height - 1))
    return TurnedViews(
        first=views[0],
        second=views[1],
        second_image=greys[1],
        maps=(maps[0], maps[1]),
        inside=inside[0] & inside[1],
        focal=focal,
        middle=middle,
        R_view_first=R_second_view,
        shift=R_second_view.T @ T_second_first[:3, 3],
    )


def _map(
    camera: Camera, R_cam_common: Array, focal: float, middle: Array, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Map the pixels of the common image to u and v (H, W) in a camera's image.

    Interpolated linearly between the middles of squares, where resizing leaves them.
    """
    # One row of squares more around the image.
    squares = [np.arange(-1, -(-n // _MAP_STEP_PX) + 1) for n in size]
    x, y = (
        ((each + 0.5) * _MAP_STEP_PX - 0.5 - centre) / focal
        for each, centre in zip(squares, middle, strict=True)
    )
    rays = np.stack(np.broadcast_arrays(x, y[:, None], 1.0), axis=-1)
    coarse = project(camera, rays @ R_cam_common.T)
    columns, rows = (slice(_MAP_STEP_PX, _MAP_STEP_PX + n) for n in size)
    u, v = (
        cv2.resize(
            np.nan_to_num(each, nan=-1e4).astype(np.float32),
            None,
            fx=_MAP_STEP_PX,
            fy=_MAP_STEP_PX,
        )
        for each in np.moveaxis(coarse, -1, 0)
    )
    return u[rows, columns], v[rows, columns]


def on_map(where: tuple[np.ndarray, np.ndarray], pixels: Array) -> tuple[Array, Array]:
    """Map pixels (N, 2) of the common image to an image (N, 2), with derivatives (N, 2, 2)."""
    limits = np.array(where[0].shape[::-1]) - 2
    corner = np.clip(np.floor(pixels), 0, limits).astype(int)
    u, v = (pixels - corner).T[..., None]
    column, row = corner.T
    a, b, c, d = (
        np.stack([plane[row + i, column + j] for plane in where], axis=-1).astype(float)
        for i, j in np.ndindex(2, 2)
    )
    by_u, by_v = (1 - v) * (b - a) + v * (d - c), (1 - u) * (c - a) + u * (d - b)
    return a + u * (b - a) + v * by_v, np.stack([by_u, by_v], axis=-1)


def whole_windows(inside: np.ndarray) -> np.ndarray:
    """Test for every second pixel whether both images show the whole window around it."""
    reach = WINDOW_PX // 4 + 1
    margin = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    whole = cv2.erode(
        inside.astype(np.uint8), margin, borderType=cv2.BORDER_CONSTANT, borderValue=0
    )
    return whole.astype(bool)
