"""The analytic derivatives of the adjustment's residuals by all unknowns of `problem`."""

from __future__ import annotations

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle.problem import (
    PER_CAMERA,
    Index,
    Problem,
    State,
    calibration_size,
    eye_parts,
)
from vergence.geometry.camera import project_jacobians
from vergence.geometry.se3 import hat


def jacobians(problem: Problem, state: State) -> tuple[Array, Index, Array]:
    """Return the derivatives of corner_errors.

    Returns:
        (M, K, 2, 33) by the shared unknowns that a detection meets, (M, 33) which these are, and
        (M, K, 2, n) by the latent ones of its block. Zero where a corner is not seen.
    """
    camera, block = problem.camera, problem.block
    right = problem.eye[camera] == 1
    R_eye, t_eye, R_pan = (array[block] for array in eye_parts(problem, state))
    R_rl = np.where(right[:, None, None], state.T_rbase_lbase[:3, :3], np.eye(3))
    t_rl = np.where(right[:, None], state.T_rbase_lbase[:3, 3], 0.0)
    T_target = state.T_lbase_target[problem.placement]
    T_mount = state.T_eye_cam[camera]

    p_turned = _turned(T_target[:, :3, :3], problem.points)
    p_swung = _turned(R_rl, p_turned + T_target[:, None, :3, 3])
    p_arm = p_swung + (t_rl - t_eye)[:, None]  # from the eye's origin, along the axes of its base
    p_eye = _turned(_t(R_eye), p_arm)
    p_mount = p_eye - T_mount[:, None, :3, 3]
    p_cam = _turned(_t(T_mount[:, :3, :3]), p_mount)

    M, K = problem.seen.shape
    by_point, by_lens = np.empty((M, K, 2, 3)), np.empty((M, K, 2, 9))
    for c, lens in enumerate(state.lenses):
        chosen = camera == c
        _, by_point[chosen], by_lens[chosen] = project_jacobians(lens, p_cam[chosen])

    by_eye = _times(by_point, _t(T_mount[:, :3, :3]))
    by_base = _times(by_eye, _t(R_eye))
    by_lbase = _times(by_base, R_rl)
    by_mount = np.concatenate([_crossed(by_eye, p_mount), -by_eye], axis=-1)
    by_rl = np.concatenate([-_crossed(by_base, p_swung), by_base], axis=-1)
    by_rl[~right] = 0.0
    by_target = np.concatenate([-_crossed(by_lbase, p_turned), by_lbase], axis=-1)
    if problem.poses is None:
        by_axes, by_latent = _joint_jacobians(problem, state, by_eye, p_eye, p_arm, R_eye, R_pan)
    else:
        turn = _times(_crossed(by_base, p_arm), _left_jacobian(state.latent[:, :3])[block])
        by_latent = np.concatenate([turn, -by_base], axis=-1)
        by_axes = np.zeros((M, K, 2, 6))

    C = len(problem.cameras)
    head = PER_CAMERA * C
    index = np.concatenate(
        [
            PER_CAMERA * camera[:, None] + np.arange(PER_CAMERA),
            np.broadcast_to(head + np.arange(6), (M, 6)),
            head + 6 + 6 * problem.eye[camera][:, None] + np.arange(6),
            calibration_size(problem) + 6 * problem.placement[:, None] + np.arange(6),
        ],
        axis=1,
    )
    shared = np.concatenate([by_lens, by_mount, by_rl, by_axes, by_target], axis=-1)
    seen = problem.seen[..., None, None]
    return np.where(seen, shared, 0.0), index, np.where(seen, by_latent, 0.0)


def _joint_jacobians(
    problem: Problem,
    state: State,
    by_eye: Array,
    p_eye: Array,
    p_arm: Array,
    R_eye: Array,
    R_pan: Array,
) -> tuple[Array, Array]:
    """Return derivatives by the 6 fields of EyeAxes and by the 2 latent readings.

    p_eye = R_tilt^T q with q = R_pan^T p_arm, and R_tilt = Rx(e) Ry(tilt) Rx(-e) where e is the
    non-orthogonality, from which the derivative by e follows.
    """
    axes = state.axes[problem.block_eye][problem.block]
    latent = state.latent[problem.block]
    x, z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    tilt_axis = np.stack([np.zeros(len(axes)), np.cos(axes[:, 4]), np.sin(axes[:, 4])], axis=-1)
    R_tilt_T = _t(R_eye) @ R_pan
    q = _turned(_t(R_pan), p_arm)
    ahead = q + axes[:, None, 5:] * x  # the tilt axis travels with pan
    columns = (
        -_turned(R_tilt_T, np.cross(z, ahead)),  # by pan
        -np.cross(tilt_axis[:, None], p_eye),  # by tilt
        np.cross(x, p_eye) - _turned(R_tilt_T, np.cross(x, q)),  # by the non-orthogonality
        np.broadcast_to(-R_tilt_T[:, None, :, 0], p_eye.shape),  # by the distance of the axes
    )
    slopes = [(by_eye * column[:, :, None]).sum(axis=-1) for column in columns]
    pan_tilt, others = np.stack(slopes[:2], axis=-1), np.stack(slopes[2:], axis=-1)
    by_axes = np.concatenate([pan_tilt * latent[:, None, None], pan_tilt, others], axis=-1)
    return by_axes, pan_tilt * axes[:, None, None, :2]


def _left_jacobian(phi: Array) -> Array:
    """Return (B, 3, 3): exp(phi + d) = exp(J d) exp(phi); a series, for turns well below 1 rad."""
    term = np.broadcast_to(np.eye(3), (*phi.shape, 3))
    total = term.copy()
    for k in range(2, 12):
        term = term @ hat(phi) / k
        total += term
    return total


def _turned(R: Array, points: Array) -> Array:
    """Return R (M, 3, 3) times each of the points (M, K, 3)."""
    return points @ _t(R)


def _times(rows: Array, matrix: Array) -> Array:
    """Return each row of (M, K, 2, 3) times its matrix (M, 3, 3)."""
    return (rows.reshape(len(rows), -1, 3) @ matrix).reshape(rows.shape)


def _crossed(rows: Array, points: Array) -> Array:
    """Return rows (M, K, 2, 3) times hat(points (M, K, 3)): the rows' cross products with them."""
    (a, b, c), (x, y, z) = np.moveaxis(rows, -1, 0), np.moveaxis(points[:, :, None], -1, 0)
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=-1)


def _t(R: Array) -> Array:
    return np.swapaxes(R, -1, -2)
