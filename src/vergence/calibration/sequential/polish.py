"""Least squares to the last digit, started from OpenCV, which takes corners in single precision.

The cost is OpenCV's own: the sum of squared distances between corners and their reprojections.
Each view has a board pose of its own; those six numbers a view are eliminated (Schur complement),
so that a step costs no more than the few parameters that all views share.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from vergence.arrays import Array
from vergence.geometry.camera import Camera, project_jacobians
from vergence.geometry.se3 import exp, hat, transform

_STEPS = 20
_SMALL = 1e-13  # a step below this, relative to one radian or metre or focal length, ends it


def board_jacobians(
    camera: Camera, T_cam_target: Array, points: Array
) -> tuple[Array, Array, Array, Array]:
    """Return how a camera's view of the board varies with everything.

    Args:
        camera: intrinsics.
        T_cam_target: (V, 4, 4).
        points: (K, 3) in frame target.

    Returns:
        Pixels (V, K, 2), and their Jacobians by the board's pose (V, K, 2, 6), where the pose is
        T_cam_target exp(xi) with rotation first, by the point in frame cam (V, K, 2, 3), and by
        the intrinsics (V, K, 2, 9).
    """
    points_cam = transform(T_cam_target[:, None], points)
    pixels, d_point, d_intrinsics = project_jacobians(camera, points_cam)
    d_target = d_point @ T_cam_target[:, None, :3, :3]
    d_pose = np.concatenate([-d_target @ hat(points), d_target], axis=-1)
    return pixels, d_pose, d_point, d_intrinsics


def solve_shared(d_shared: Array, d_view: Array, residuals: Array) -> tuple[Array, Array]:
    """Return the Gauss-Newton step of the shared parameters (S,) and of each view's (V, Q).

    Args:
        d_shared: (V, M, S) Jacobian of the predictions by the shared parameters.
        d_view: (V, M, Q) Jacobian by the view's own.
        residuals: (V, M) measured less predicted; rows of unseen corners are zero in all three.
    """
    d_view_T, d_shared_T = np.swapaxes(d_view, 1, 2), np.swapaxes(d_shared, 1, 2)
    W = np.linalg.inv(d_view_T @ d_view)
    cross = d_view_T @ d_shared
    gradient = (d_view_T @ residuals[:, :, None])[:, :, 0]
    inner = (W @ gradient[:, :, None])[:, :, 0]
    H = (d_shared_T @ d_shared - np.swapaxes(cross, 1, 2) @ W @ cross).sum(axis=0)
    g = np.einsum("vms,vm->s", d_shared, residuals) - np.einsum("vqs,vq->s", cross, inner)
    scale = 1 / np.sqrt(np.diag(H))
    step = scale * np.linalg.solve(H * scale * scale[:, None], g * scale)
    return step, inner - (W @ cross @ step[:, None])[:, :, 0]


def iterate(step: Callable[[], float]) -> None:
    """Take Gauss-Newton steps, each of which returns its size, until they no longer matter."""
    last = np.inf
    for _ in range(_STEPS):
        size = step()
        if size < _SMALL or size >= last < 1e-9:
            return
        last = size


def polish_intrinsics(
    camera: Camera, free: NDArray[np.bool_], T_cam_target: Array, corners: Array, points: Array
) -> tuple[Camera, Array]:
    """Return the camera, and T_cam_target (V, 4, 4), at the minimum of the cost.

    Args:
        camera: the start.
        free: (9,) of bool: which of (fx, fy, cx, cy, k1, k2, p1, p2, k3) may move.
        T_cam_target: (V, 4, 4) the start.
        corners: (V, K, 2) pixels; NaN where a corner was not seen.
        points: (K, 3) in frame target.
    """
    values = np.concatenate([camera.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], camera.distortion])
    seen = np.isfinite(corners)

    def build() -> Camera:
        matrix = camera.matrix.copy()
        matrix[[0, 1, 0, 1], [0, 1, 2, 2]] = values[:4]
        return Camera(camera.width, camera.height, matrix, values[4:])

    def step() -> float:
        nonlocal T_cam_target
        pixels, d_pose, _, d_intrinsics = board_jacobians(build(), T_cam_target, points)
        residuals = np.where(seen, corners - pixels, 0.0)
        shared, poses = solve_shared(
            _rows(d_intrinsics[..., free], seen), _rows(d_pose, seen), _flat(residuals)
        )
        values[free] += shared
        T_cam_target = T_cam_target @ exp(poses)
        return float(max(np.abs(shared / np.maximum(1, np.abs(values[free]))).max(), _most(poses)))

    iterate(step)
    return build(), T_cam_target


def intrinsics_std(
    camera: Camera, free: NDArray[np.bool_], T_cam_target: Array, corners: Array, points: Array
) -> Array:
    """Return the standard deviations of the free intrinsics, by the residuals at the optimum.

    Args: see polish_intrinsics. Infinite where the views do not tell one.
    """
    seen = np.isfinite(corners)
    pixels, d_pose, _, d_intrinsics = board_jacobians(camera, T_cam_target, points)
    residuals = np.where(seen, corners - pixels, 0.0)
    d_view, d_shared = _rows(d_pose, seen), _rows(d_intrinsics[..., free], seen)
    d_view_T = np.swapaxes(d_view, 1, 2)
    inner = d_shared - d_view @ np.linalg.solve(d_view_T @ d_view, d_view_T @ d_shared)
    H = (np.swapaxes(inner, 1, 2) @ inner).sum(axis=0)
    spare = np.count_nonzero(seen) - 6 * len(T_cam_target) - np.count_nonzero(free)
    scale = np.sqrt(np.diag(H))
    if spare < 1 or not (scale > 0).all():
        return np.full(len(scale), np.inf)
    values, vectors = np.linalg.eigh(H / np.outer(scale, scale))
    variance = (vectors**2 / np.maximum(values, 1e-15)).sum(axis=1) / scale**2
    return np.sqrt(variance * (residuals**2).sum() / spare)


def polish_pair(
    T_b_a: Array,
    T_a_target: Array,
    corners: tuple[Array, Array],
    points: Array,
    cameras: tuple[Camera, Camera],
) -> tuple[Array, float]:
    """Return T_b_a (4, 4) at the minimum of the cost over both cameras, and the RMS [px].

    Args:
        T_b_a: the start.
        T_a_target: (V, 4, 4) board poses in camera a, the start.
        corners: (V, K, 2) pixels in camera a and in camera b; NaN where not seen.
        points: (K, 3) in frame target.
        cameras: intrinsics of a and b.
    """
    seen = np.concatenate([np.isfinite(c) for c in corners], axis=1)
    measured = np.concatenate(corners, axis=1)
    residuals = np.zeros_like(measured)

    def step() -> float:
        nonlocal T_b_a, T_a_target, residuals
        pixels_a, pose_a, _, _ = board_jacobians(cameras[0], T_a_target, points)
        T_b_target = T_b_a @ T_a_target
        pixels_b, pose_b, point_b, _ = board_jacobians(cameras[1], T_b_target, points)
        # T_b_a exp(xi): the board's points move in frame a, and R_b_a turns that into frame b.
        d_a = point_b @ T_b_a[:3, :3]
        points_a = transform(T_a_target[:, None], points)
        pair_b = np.concatenate([-d_a @ hat(points_a), d_a], axis=-1)
        residuals = np.where(seen, measured - np.concatenate([pixels_a, pixels_b], axis=1), 0.0)
        shared, poses = solve_shared(
            _rows(np.concatenate([np.zeros_like(pair_b), pair_b], axis=1), seen),
            _rows(np.concatenate([pose_a, pose_b], axis=1), seen),
            _flat(residuals),
        )
        T_b_a = T_b_a @ exp(shared)
        T_a_target = T_a_target @ exp(poses)
        return float(max(np.abs(shared).max(), _most(poses)))

    iterate(step)
    return T_b_a, float(np.sqrt(2 * (residuals**2).sum() / seen.sum()))


def _rows(jacobian: Array, seen: Array) -> Array:
    """Flatten (V, K, 2, P) to (V, 2K, P), with zeros where a corner was not seen."""
    masked = np.where(seen[..., None], jacobian, 0.0)
    return masked.reshape(len(masked), -1, masked.shape[-1])


def _flat(residuals: Array) -> Array:
    return residuals.reshape(len(residuals), -1)


def _most(poses: Array) -> float:
    return float(np.abs(poses).max())
