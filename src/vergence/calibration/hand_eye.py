"""Where a camera sits in its eye: AX = XB by the method of Park and Martin (Eqs. 5-9).

With X = T_eye_cam, the consistent form of Eqs. 5-6 is A X = X B for motions of the eye,
A = eye_pose(i)^-1 eye_pose(j), and of the camera, B = target_poses(i) target_poses(j)^-1.
"""

from __future__ import annotations

import numpy as np

from vergence.arrays import Array, nearest_rotation
from vergence.errors import VergenceError
from vergence.geometry.se3 import (
    agreeing_poses,
    angle,
    inverse,
    mean_pose,
    pose,
    rotvec,
)

DRAWS, SAMPLE = 100, 4
"""Random draws, and the views of each; with a third of the views wrong, one draw in five has good
ones only."""
LEAST_MOTION_RAD = 0.01
"""Minimum root mean square turn of an eye about its second axis: with a joint noise of 0.3 degrees
and 20 views the paper's method is then wrong by 7 degrees."""


def motion_pairs(T_base_eye: Array, T_cam_target: Array) -> tuple[Array, Array]:
    """Pair the motions A and B (P, 4, 4) of Eqs. 5-6 for all pairs of N views of a fixed board.

    All pairs carry more information than the pairs with view 0, which the paper prints.
    """
    i, j = np.triu_indices(len(T_base_eye), k=1)
    A = inverse(T_base_eye[i]) @ T_base_eye[j]
    B = T_cam_target[i] @ inverse(T_cam_target[j])
    return A, B


def solve_rotation(a: Array, b: Array) -> Array:
    """Solve for R_X (3, 3) of Eq. 9, the least-squares solution of a = R_X b (Eq. 7).

    Rotation vectors a (P, 3) are the eye's motions, b (P, 3) the camera's. (M^T M)^(-1/2) M^T with
    M = sum b a^T is the orthogonal factor of M^T: with the singular values M = U S V^T it is V U^T.
    When all rotations share one axis M has rank one, the turn about that axis is free, and a
    VergenceError is raised.
    """
    M = b.T @ a
    S = np.linalg.svd(M, compute_uv=False)
    # Two axes suffice: M then has rank two, and the third direction follows from handedness.
    if not S[1] > 1e-6 * S[0] or S[0] == 0:
        raise VergenceError(
            "All eye motions share one axis, which leaves the camera's turn about that axis open; "
            "record views in which the eye both pans and tilts."
        )
    return nearest_rotation(M.T)


def park_martin(T_base_eye: Array, T_cam_target: Array) -> Array:
    """Compute T_eye_cam (4, 4) from N views of a board at rest.

    The eye's poses T_base_eye (N, 4, 4) are from the joint readings, the board's T_cam_target (N,
    4, 4) from the images. VergenceError if there are too few, or the motion is degenerate.
    """
    if len(T_base_eye) < 3:
        raise VergenceError(
            f"park_martin needs at least 3 views at different eye angles, found {len(T_base_eye)}."
        )
    A, B = motion_pairs(T_base_eye, T_cam_target)
    R_A = A[:, :3, :3]
    R_X = solve_rotation(rotvec(R_A), rotvec(B[:, :3, :3]))
    left = (np.eye(3) - R_A).reshape(-1, 3)  # Eq. 8
    right = A[:, :3, 3] - B[:, :3, 3] @ R_X.T
    U, sizes, Vt = np.linalg.svd(left, full_matrices=False)
    # About a single axis noise would move the camera along it, by hundreds of metres.
    moved = sizes > LEAST_MOTION_RAD * np.sqrt(len(A))
    t_X = Vt[moved].T @ ((U[:, moved].T @ right.reshape(-1)) / sizes[moved])
    return pose(R_X, t_X)


def robust_park_martin(T_base_eye: Array, T_cam_target: Array) -> Array:
    """Run park_martin on the views that agree where the board stands: least median of squares."""
    best = park_martin(T_base_eye, T_cam_target)
    if agreeing_poses(T_base_eye @ best @ T_cam_target).all():
        return best
    rng, least = np.random.default_rng(0), median_turn(T_base_eye @ best @ T_cam_target)
    for _ in range(DRAWS):
        drawn = rng.choice(len(T_base_eye), min(SAMPLE, len(T_base_eye)), replace=False)
        try:
            trial = park_martin(T_base_eye[drawn], T_cam_target[drawn])
        except VergenceError:
            continue
        if (turn := median_turn(T_base_eye @ trial @ T_cam_target)) < least:
            best, least = trial, turn
    agreeing = agreeing_poses(T_base_eye @ best @ T_cam_target)
    try:
        return park_martin(T_base_eye[agreeing], T_cam_target[agreeing])
    except VergenceError:
        return best


def median_turn(T: Array) -> float:
    """Compute the median angle [rad] between poses (N, 4, 4) and the mean of the agreeing."""
    return float(np.median(angle((inverse(mean_pose(T)) @ T)[:, :3, :3])))
