"""Rigid transforms as (..., 4, 4) arrays, on scipy's Rotation.

`T_a_b` maps coordinates of frame b into frame a: `p_a = T_a_b @ p_b`, `T_a_c = T_a_b @ T_b_c`.
Leading dimensions are batches, and `@` broadcasts over them. See docs/conventions.md.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from vergence.arrays import Array, floats, nearest_rotation, rigid
from vergence.errors import VergenceError
from vergence.findings import Finding, note
from vergence.geometry.batches import batch_first, batch_last

POSE = ("rx", "ry", "rz", "tx", "ty", "tz")
"""The names of the increments of a pose: see `boxplus`."""
ALIKE, AGREE = 1e-3, 5.0
"""Turn [rad] or shift [m] within which poses always agree, below the noise of boards' poses, and
multiple of the median one up to which they do: of normal noise one in a million is farther."""


def pose(R: ArrayLike | None = None, t: ArrayLike | None = None) -> Array:
    """Assemble T from rotation R (..., 3, 3) and translation t (..., 3); left out: none."""
    R = np.eye(3) if R is None else np.asarray(R, dtype=float)
    t = np.zeros(3) if t is None else np.asarray(t, dtype=float)
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], t.shape[:-1]), 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def inverse(T: Array) -> Array:
    """Invert T_a_b (..., 4, 4) to T_b_a."""
    R_inv = np.swapaxes(T[..., :3, :3], -1, -2)
    return pose(R_inv, -(R_inv @ T[..., :3, 3:])[..., 0])


def transform(T: Array, points: Array) -> Array:
    """Map points (..., 3) by T (..., 4, 4); the two broadcast."""
    return (T[..., :3, :3] @ points[..., None])[..., 0] + T[..., :3, 3]


def rotation(rotvec: ArrayLike) -> Array:
    """Compute R (..., 3, 3) of a rotation vector (..., 3) [rad]."""
    vectors = np.asarray(rotvec, dtype=float)
    # One row a vector: scipy takes five times as long with more dimensions.
    R = Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix()
    return R.reshape(*vectors.shape, 3)


def rotvec(R: Array) -> Array:
    """Compute the rotation vector (..., 3) [rad], at most pi long, of R (..., 3, 3)."""
    return Rotation.from_matrix(R).as_rotvec()


def boxplus(T: Array, xi: Array) -> Array:
    """Change T_a_b (..., 4, 4) by increments (..., 6), along the axes of frame a.

    The one increment of a pose in this project: rotation phi [rad], then translation d [m], turn
    R_a_b into exp(phi) R_a_b and t_a_b into t_a_b + d. Covariances of poses speak of it.
    """
    return pose(rotation(xi[..., :3]) @ T[..., :3, :3], T[..., :3, 3] + xi[..., 3:])


def boxminus(T: Array, T_reference: Array) -> Array:
    """Compute the increments (..., 6) with boxplus(T_reference, increments) = T."""
    R = T[..., :3, :3] @ np.swapaxes(T_reference[..., :3, :3], -1, -2)
    return np.concatenate([rotvec(R), T[..., :3, 3] - T_reference[..., :3, 3]], axis=-1)


def hat(v: Array) -> Array:
    """Assemble [v] (..., 3, 3), the matrix of the cross product: hat(v) @ w = v x w."""
    zero = np.zeros(v.shape[:-1])
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    rows = [zero, -z, y, z, zero, -x, -y, x, zero]
    return np.stack(rows, axis=-1).reshape(*v.shape[:-1], 3, 3)


def cross(a: Array, b: Array) -> Array:
    """Compute a x b (..., 3); numpy's own takes ten times as long for few vectors."""
    a1, a2, a3 = batch_last(a)
    b1, b2, b3 = batch_last(b)
    first = a2 * b3 - a3 * b2
    if type(first) is not np.ndarray:
        return np.array([first, a3 * b1 - a1 * b3, a1 * b2 - a2 * b1])
    rows = np.empty((3, *first.shape))
    rows[0] = first
    np.subtract(a3 * b1, a1 * b3, out=rows[1])
    np.subtract(a1 * b2, a2 * b1, out=rows[2])
    return batch_first(rows)


def angle(R: Array) -> Array:
    """Compute the angle (...,) [rad] of R (..., 3, 3)."""
    return Rotation.from_matrix(R).magnitude()


def agreeing_poses(T: Array) -> np.ndarray:
    """Find which of poses (N, 4, 4) agree: those about the one that is nearest to half of them.

    Turns and shifts each count relative to the least distance within which half of the poses lie.
    """
    R, t = T[:, :3, :3], T[:, :3, 3]
    chord = np.sqrt(np.maximum(3 - np.einsum("iab,jab->ij", R, R), 0.0))  # of the angle
    apart = np.stack([chord, np.linalg.norm(t[:, None] - t, axis=-1)])
    half = np.median(apart, axis=2).min(axis=1, initial=np.inf)
    far = (apart / np.maximum(half, ALIKE)[:, None, None]).max(axis=0)
    return far[np.median(far, axis=1).argmin()] < AGREE


def mean_pose(T: Array) -> Array:
    """Average the agreeing ones of poses (N, 4, 4): mean rotation and median translation (4, 4).

    The rotation is the mean of the matrices, projected onto SO(3).
    """
    T = T[agreeing_poses(T)]
    return pose(nearest_rotation(T[:, :3, :3].sum(axis=0)), np.median(T[:, :3, 3], axis=0))


def known_poses(T: Array) -> np.ndarray:
    """Check which (...,) of poses (..., 4, 4) are finite."""
    return np.asarray(np.isfinite(T).all(axis=(-2, -1)))


def rigid_poses(name: str, T: Array) -> tuple[Array, tuple[Finding, ...]]:
    """Take the finite ones of poses (..., 4, 4) to the nearest rigid transforms, with a note on it.

    VergenceError if one of them is farther from any than rounding explains.
    """
    known = known_poses(T)
    try:
        found = rigid(T[known])
    except ValueError as error:
        raise VergenceError(f"{name}: {error}.") from None
    if np.array_equal(found, T[known]):
        return T, ()
    sentence = (
        f"The rotations of {name} are rounded, by up to {np.abs(found - T[known]).max():.1g}; the "
        "nearest rotations are used."
    )
    T = T.copy()
    T[known] = found
    return T, (note("rounded-poses", sentence, name),)


def checked_points(points: ArrayLike, postures: tuple[int, ...] = ()) -> Array:
    """Check points (..., 3) that broadcast with postures of a leading shape, or VergenceError."""
    found = floats("points", points)
    if found.shape[-1:] != (3,):
        raise VergenceError(f"Points have the shape (..., 3); found an array of {found.shape}.")
    try:
        np.broadcast_shapes(found.shape[:-1], postures)
    except ValueError:
        raise VergenceError(
            f"Points of shape {found.shape} do not go with postures of shape {postures}: there is "
            "one posture, one point, or as many of both."
        ) from None
    return found
