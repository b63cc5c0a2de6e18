"""Where a board stands before a camera of known intrinsics, by its corners in one image."""

from __future__ import annotations

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.geometry.camera import Camera, normalise, project_jacobians
from vergence.geometry.projection import by_pose_of_points
from vergence.geometry.se3 import boxplus, known_poses, pose, rotation

LEAST_CORNERS = 6
"""Fewer do not say where a board is."""
_REFINEMENTS = 20
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
    if camera.model == "fisheye" or camera.matrix[0, 1]:
        return _poses_by_directions(camera, corners, points)
    poses = np.full((len(corners), 4, 4), np.nan)
    seen = seen_corners(corners)
    for v in np.flatnonzero(determines_pose(points, seen)):
        view = points[seen[v]], corners[v, seen[v]], camera.matrix, camera.distortion
        found, rvec, tvec = cv2.solvePnP(*view, flags=cv2.SOLVEPNP_ITERATIVE)
        if found:
            rvec, tvec = cv2.solvePnPRefineLM(*view, rvec, tvec, _CRITERIA)
            poses[v] = pose(rotation(rvec.ravel()), tvec.ravel())
    return poses


def _poses_by_directions(camera: Camera, corners: Array, points: Array) -> Array:
    """Return what board_poses does, for fisheye lenses and skew, which solvePnP does not know.

    The poses by directions are the start; by pixels, all views at once, they are refined.
    """
    xy = normalise(camera, corners)
    plain = Camera(camera.width, camera.height, np.eye(3))
    poses = board_poses(plain, xy, points)
    known = known_poses(poses)
    if known.any():
        reached = np.where(np.isfinite(xy), corners, np.nan)
        poses[known], _ = refined_poses(camera, reached[known], points, poses[known])
    return poses


def seen_from_the_other_side(T_cam_target: Array, points: Array) -> Array:
    """Return the poses (V, 4, 4) with which small boards look almost the same.

    The board is slanted the other way about its middle: seen along the line of sight, its normal is
    the mirror image.
    """
    middle = points.mean(axis=0)
    R, centre = T_cam_target[:, :3, :3], T_cam_target[:, :3, :3] @ middle + T_cam_target[:, :3, 3]
    sight = centre / np.linalg.norm(centre, axis=-1, keepdims=True)
    half_turn = 2 * sight[:, :, None] * sight[:, None] - np.eye(3)
    R_other = half_turn @ R @ np.diag([-1.0, -1.0, 1.0])
    return pose(R_other, centre - R_other @ middle)


def board_errors(
    camera: Camera, T_cam_target: Array, corners: Array, points: Array
) -> tuple[Array, Array, Array]:
    """Return what V views of a board are off, and how that depends on the poses and on the lens.

    Args:
        camera: that saw the board.
        T_cam_target: (V, 4, 4) poses of the board.
        corners: (V, K, 2) pixels; NaN where a corner was not seen, whose rows are zero.
        points: (K, 3) the corners in frame target [m].

    Returns:
        Predicted minus seen pixels (V, 2 K), and their derivatives by increments of the poses
        (V, 2 K, 6) and by the n intrinsics (V, 2 K, n), in the order of `project_jacobians`.
    """
    V, seen = len(T_cam_target), seen_corners(corners)[..., None]
    turned = points @ np.swapaxes(T_cam_target[:, :3, :3], 1, 2)
    at = turned + T_cam_target[:, None, :3, 3]
    pixels, by_point, by_lens = project_jacobians(camera, at)
    errors = np.where(seen, pixels - np.where(seen, corners, 0.0), 0.0).reshape(V, -1)
    by_pose, by_lens = (
        np.where(seen[..., None], J, 0.0).reshape(V, -1, J.shape[-1])
        for J in (by_pose_of_points(by_point, turned), by_lens)
    )
    return errors, by_pose, by_lens


def refined_poses(camera: Camera, corners: Array, points: Array, T: Array) -> tuple[Array, Array]:
    """Return poses (V, 4, 4) of least reprojection error near T, and the sums of squares [px^2].

    All views at once, by Levenberg and Marquardt's method; each has four corners or more.
    """
    damping: Array = np.full(len(T), 1e-6)
    lowest: Array = np.full(len(T), np.inf)
    best, step = T, np.zeros((len(T), 6))
    kept: tuple[Array, Array] | None = None
    for _ in range(_REFINEMENTS):
        trial = boxplus(best, step)
        errors, J, _ = board_errors(camera, trial, corners, points)
        cost = np.nan_to_num((errors**2).sum(axis=1), nan=np.inf)
        better = (cost <= lowest) & np.isfinite(cost)
        J_T = np.swapaxes(J, 1, 2)
        H: Array = J_T @ J
        g: Array = (J_T @ errors[..., None])[..., 0]
        if kept is not None:
            H = np.where(better[:, None, None], H, kept[0])
            g = np.where(better[:, None], g, kept[1])
        kept = H, g
        best = np.where(better[:, None, None], trial, best)
        fall = lowest - np.where(better, cost, 0.0)
        settled = better & (fall < 1e-14 * np.where(better, cost, 0.0) + 1e-20)
        lowest = np.minimum(cost, lowest)
        if settled.all():
            break
        damping = np.where(better, np.maximum(damping / 10, 1e-12), damping * 100)
        damped = H + damping[:, None, None] * H * np.eye(6)
        step = np.asarray(-np.linalg.solve(damped, g[..., None])[..., 0], dtype=float)
    return best, lowest
