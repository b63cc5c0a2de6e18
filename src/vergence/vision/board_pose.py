"""Where a board stands before a camera of known intrinsics, by its corners in one image."""

from __future__ import annotations

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.geometry.camera import Camera
from vergence.geometry.se3 import pose, rotation

LEAST_CORNERS = 6
"""Fewer do not say where a board is."""
_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-14)


def seen_corners(corners: Array) -> np.ndarray:
    """Return (..., K) of bool: which corners (..., K, 2) [px] were seen."""
    return np.asarray(np.isfinite(corners).all(axis=-1))


def determines_pose(points: Array, seen: np.ndarray) -> np.ndarray:
    """Return (...,) whether corners determine the board's pose: enough are seen, not on one line.

    The board's corners are points (K, 3) in frame target, seen is (..., K) of bool.
    """
    count = seen.sum(axis=-1)
    weight = seen / np.maximum(count, 1)[..., None]
    mean = weight @ points
    second = np.einsum("...k,ki,kj->...ij", weight, points, points, optimize=True)
    spread = np.linalg.eigvalsh(second - mean[..., :, None] * mean[..., None, :])
    return (count >= LEAST_CORNERS) & (spread[..., 1] > 1e-3 * np.maximum(spread[..., 2], 1e-30))


def board_poses(camera: Camera, corners: Array, points: Array) -> Array:
    """Return T_cam_target (V, 4, 4) of each view, by least squares; NaN where it is not determined.

    Corners are pixels (V, K, 2), NaN where not seen, of points (K, 3) in frame target [m].
    """
    poses = np.full((len(corners), 4, 4), np.nan)
    seen = seen_corners(corners)
    for v in np.flatnonzero(determines_pose(points, seen)):
        view = points[seen[v]], corners[v, seen[v]], camera.matrix, camera.distortion
        found, rvec, tvec = cv2.solvePnP(*view, flags=cv2.SOLVEPNP_ITERATIVE)
        if found:
            rvec, tvec = cv2.solvePnPRefineLM(*view, rvec, tvec, _CRITERIA)
            poses[v] = pose(rotation(rvec.ravel()), tvec.ravel())
    return poses
