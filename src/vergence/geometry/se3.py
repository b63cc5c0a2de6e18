"""Rigid transforms as (..., 4, 4) arrays, on scipy's Rotation and RigidTransform.

`T_a_b` maps coordinates of frame b into frame a: `p_a = T_a_b @ p_b`, `T_a_c = T_a_b @ T_b_c`.
Leading dimensions are batches, and `@` broadcasts over them. See docs/conventions.md.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from vergence.arrays import Array


def pose(R: ArrayLike | None = None, t: ArrayLike | None = None) -> Array:
    """Return T with rotation R (..., 3, 3) and translation t (..., 3); left out: none."""
    R = np.eye(3) if R is None else np.asarray(R, dtype=float)
    t = np.zeros(3) if t is None else np.asarray(t, dtype=float)
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], t.shape[:-1]), 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def inverse(T: Array) -> Array:
    """Return T_b_a of T_a_b, (..., 4, 4)."""
    R_inv = np.swapaxes(T[..., :3, :3], -1, -2)
    return pose(R_inv, -(R_inv @ T[..., :3, 3:])[..., 0])


def transform(T: Array, points: Array) -> Array:
    """Map points (..., 3) by T (..., 4, 4); the two broadcast."""
    return (T[..., :3, :3] @ points[..., None])[..., 0] + T[..., :3, 3]


def rotation(rotvec: ArrayLike) -> Array:
    """Return R (..., 3, 3) of a rotation vector (..., 3) [rad]."""
    vectors = np.asarray(rotvec, dtype=float)
    # One row a vector: scipy takes five times as long with more dimensions.
    R = Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix()
    return R.reshape(*vectors.shape, 3)


def rotvec(R: Array) -> Array:
    """Return the rotation vector (..., 3) [rad], at most pi long, of R (..., 3, 3)."""
    return Rotation.from_matrix(R).as_rotvec()


def exp(xi: ArrayLike) -> Array:
    """Return T (..., 4, 4) of exponential coordinates (..., 6): rotation [rad], translation [m]."""
    return RigidTransform.from_exp_coords(np.asarray(xi, dtype=float)).as_matrix()


def log(T: Array) -> Array:
    """Return the exponential coordinates (..., 6) of T (..., 4, 4): rotation, translation."""
    return RigidTransform.from_matrix(T).as_exp_coords()


def hat(v: Array) -> Array:
    """Return [v] (..., 3, 3), the matrix of the cross product: hat(v) @ w = v x w."""
    zero = np.zeros(v.shape[:-1])
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    rows = [zero, -z, y, z, zero, -x, -y, x, zero]
    return np.stack(rows, axis=-1).reshape(*v.shape[:-1], 3, 3)


def angle(R: Array) -> Array:
    """Return the angle (...,) [rad] of R (..., 3, 3)."""
    return Rotation.from_matrix(R).magnitude()
