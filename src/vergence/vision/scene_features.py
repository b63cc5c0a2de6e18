"""What two eyes see of the same scene: features matched between a pair of images.

The predicted geometry brings both images into one orientation, in which a point of the scene
differs by little more than its disparity. In each cell of the part that both eyes see, the place
that a window determines best is tracked from the left to the right image and back (Lucas and
Kanade), then matched by least squares, and returned as pixels of the images as they are. The search
covers predictions that are wrong by a few degrees.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.geometry.camera import Camera, project
from vergence.geometry.se3 import rotation, rotvec
from vergence.vision.least_squares_matching import WINDOW_PX, match_windows

_MAP_STEP_PX = 8
_FEATURES = 450
"""About how many are sought, however large the part is that both eyes see."""
_SMALLEST_CELL_PX, _LARGEST_CELL_PX = 10, 24
_WINDOW_PX = 11
_LEVELS = 3
_EXPECTED_DEPTH_M = 1.5
"""Where tracking starts to search; its pyramid reaches about 50 px from there."""
_ROUND_TRIP_PX = 0.3
_LARGEST_STD_PX = 0.7
"""Of a match that is worth its time."""


@dataclass(frozen=True, eq=False)
class Matches:
    """The same N points of the scene in two images."""

    left: Array
    """(N, 2) pixels."""
    right: Array
    """(N, 2) pixels."""
    covariance: Array
    """(N, 2, 2) [px^2] of the right pixels, the left ones taken as exact: by the contrast of the
    window, and by how far the two windows differ."""


def match_scene(
    left: np.ndarray,
    right: np.ndarray,
    *,
    left_camera: Camera,
    right_camera: Camera,
    T_rcam_lcam: Array,
) -> Matches:
    """Return features that both images show, by about where the cameras stand to each other.

    Images are (H, W) grey or (H, W, 3) RGB, uint8; T_rcam_lcam (4, 4) may be wrong by a few
    degrees.
    """
    R_rcam_common = rotation(rotvec(T_rcam_lcam[:3, :3]) / 2)  # each eye turns half of the way
    focal = (left_camera.matrix[0, 0] + right_camera.matrix[0, 0]) / 2
    size = left_camera.width, left_camera.height
    middle = (np.array(size) - 1) / 2
    greys, views, maps, inside = [], [], [], []
    for image, camera, R_cam_common in (
        (left, left_camera, R_rcam_common.T),
        (right, right_camera, R_rcam_common),
    ):
        where = _map(camera, R_cam_common, focal, middle, size)
        grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        u, v = where
        greys.append(grey)
        views.append(cv2.remap(grey, u, v, cv2.INTER_LINEAR))
        u, v = u[::2, ::2], v[::2, ::2]
        inside.append((u > 0) & (v > 0) & (u < camera.width - 1) & (v < camera.height - 1))
        maps.append(where)
    at = _best_of_cells(views[0], inside[0] & inside[1])
    shift = R_rcam_common.T @ T_rcam_lcam[:3, 3]  # of a point, from the left view to the right
    by_depth = focal * shift[:2] - (at - middle) * shift[2]
    found, sure = _track(views[0], views[1], at, at + by_depth / _EXPECTED_DEPTH_M)
    at, found, by_depth = at[sure], found[sure], by_depth[sure]
    # Displaced by by_depth / (depth + shift[2]), of which the last is due to the change of scale.
    square = np.maximum((by_depth**2).sum(axis=1), 1e-12)
    matched = match_windows(
        views[0],
        greys[1],
        maps[1],
        at=at,
        found=found,
        direction=by_depth / np.sqrt(square)[:, None],
        enlargement=-shift[2] * ((found - at) * by_depth).sum(axis=1) / square,
    )
    # In the right image itself, whose scale is another.
    right_px, by_view = _on_map(maps[1], matched.pixels)
    covariance = by_view @ matched.covariance @ np.swapaxes(by_view, 1, 2)
    good = matched.good & (np.linalg.eigvalsh(covariance)[:, 1] < _LARGEST_STD_PX**2)
    return Matches(_on_map(maps[0], at)[0][good], right_px[good], covariance[good])


def _map(
    camera: Camera, R_cam_common: Array, focal: float, middle: Array, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return u and v (H, W) where in a camera's image the pixels of the common image lie.

    Lines between every eighth pixel. Matches are taken back by the same lines, so that these need
    not be exact.
    """
    # The middles of squares, where enlarging leaves them; one row of squares around the image.
    squares = [np.arange(-1, -(-n // _MAP_STEP_PX) + 1) for n in size]
    grid = [(each + 0.5) * _MAP_STEP_PX - 0.5 for each in squares]
    rays = np.ones((len(grid[1]), len(grid[0]), 3))
    rays[..., :2] = (np.stack(np.meshgrid(*grid), axis=-1) - middle) / focal
    coarse = np.nan_to_num(project(camera, rays @ R_cam_common.T), nan=-1e4).astype(np.float32)
    columns, rows = (slice(_MAP_STEP_PX, _MAP_STEP_PX + n) for n in size)
    u, v = (
        cv2.resize(np.ascontiguousarray(coarse[..., k]), None, fx=_MAP_STEP_PX, fy=_MAP_STEP_PX)
        for k in (0, 1)
    )
    return u[rows, columns], v[rows, columns]


def _on_map(where: tuple[np.ndarray, np.ndarray], pixels: Array) -> tuple[Array, Array]:
    """Return where pixels (N, 2) of the common image lie (N, 2), and derivatives (N, 2, 2)."""
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


def _best_of_cells(view: np.ndarray, inside: np.ndarray) -> Array:
    """Return pixels (N, 2), one of each cell: where a window determines both directions best.

    By the smaller eigenvalue of its structure tensor (Shi and Tomasi). Of every second pixel,
    `inside` says whether both eyes see it.
    """
    half = cv2.pyrDown(view)  # near enough, and much faster
    smaller = cv2.cornerMinEigenVal(half, WINDOW_PX // 2, ksize=3)
    margin = np.ones((WINDOW_PX // 2 + 2, WINDOW_PX // 2 + 2), np.uint8)
    whole = cv2.erode(
        inside.astype(np.uint8), margin, borderType=cv2.BORDER_CONSTANT, borderValue=0
    )
    smaller[whole == 0] = 0
    side = round(float(np.sqrt(cv2.countNonZero(whole) / _FEATURES)))
    side = min(max(side, _SMALLEST_CELL_PX // 2), _LARGEST_CELL_PX // 2)
    rows, columns = (n // side for n in smaller.shape)
    cells = smaller[: rows * side, : columns * side]
    cells = cells.reshape(rows, side, columns, side).swapaxes(1, 2)
    cells = cells.reshape(rows, columns, -1)
    best = cells.argmax(axis=-1)
    row, column = np.nonzero(cells.max(axis=-1) > 0)
    down, across = np.divmod(best[row, column], side)
    return 2.0 * np.stack([column * side + across, row * side + down], axis=-1)


def _track(
    view: np.ndarray, other: np.ndarray, at: Array, start: Array
) -> tuple[Array, np.ndarray]:
    """Return where pixels (N, 2) are found in another view, and which are sure.

    Sure are those that are found again where they came from.
    """
    if not len(at):
        return at, np.zeros(0, bool)
    options = {
        "winSize": (_WINDOW_PX, _WINDOW_PX),
        "flags": cv2.OPTFLOW_USE_INITIAL_FLOW,
        # Near enough for least squares.
        "criteria": (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03),
    }
    points = at.astype(np.float32)
    found, good, _ = cv2.calcOpticalFlowPyrLK(
        view, other, points, start.astype(np.float32), maxLevel=_LEVELS, **options
    )
    # The way back begins at its end: no pyramid is needed.
    back, again, _ = cv2.calcOpticalFlowPyrLK(
        other, view, found, points.copy(), maxLevel=0, **options
    )
    near = np.linalg.norm(back - points, axis=1) < _ROUND_TRIP_PX
    sure = (good[:, 0] == 1) & (again[:, 0] == 1) & near
    return found.astype(float), sure
