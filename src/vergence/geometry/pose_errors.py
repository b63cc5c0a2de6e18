"""Errors of measured eye poses that are smooth functions of the posture, as those of an arm are.

An arm's links differ from its model, and its poses then err alike in neighbouring postures. The
errors are interpolated between postures in which they are known, by a Gaussian process with a
squared exponential kernel, and vanish far from all of them.
"""

from __future__ import annotations

import numpy as np
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass

from vergence.arrays import Array, Matrix, Transforms, VectorN
from vergence.geometry.se3 import boxplus, hat, known_poses

MAX_POSES = 10_000  # a limit for files of strangers


@dataclass(frozen=True, eq=False, config=ConfigDict(extra="forbid", allow_inf_nan=False))
class PoseErrors:
    """What to add to the measured poses T_base_eye of an eye."""

    poses: Transforms
    """(N, 4, 4) in which the errors are known."""
    lengths: VectorN
    """Scales of the kernel (2,): of places [m], and of the elements of rotations."""
    weights: Matrix
    """(N, 6) of the kernels about the poses, as increments of `se3.boxplus`."""
    constant: VectorN
    """(12,) increments of constant transformations before and after the poses, which are those of
    the board and of T_eye_cam: they are taken off the interpolated errors."""

    def __post_init__(self) -> None:
        N = len(self.poses)
        shapes = self.lengths.shape, self.weights.shape, self.constant.shape
        if shapes != ((2,), (N, 6), (12,)) or not (self.lengths > 0).all() or N > MAX_POSES:
            raise ValueError(
                f"errors of poses have two lengths, at most {MAX_POSES:,} poses with 6 weights "
                f"each, and 12 numbers that are constant; found shapes {shapes} for {N} poses"
            )

    def corrected(self, T: Array) -> Array:
        """Add what is known of the errors to poses (..., 4, 4) as read; NaN stays NaN."""
        known = known_poses(T)
        read, found = T[known], T.copy()
        change = kernel(read, self.poses, self.lengths) @ self.weights
        change -= constant_transformations(read) @ self.constant
        found[known] = boxplus(read, change)
        return found


def kernel(T: Array, others: Array, lengths: Array) -> Array:
    """Compute the correlation (N, M) of the errors of poses (N, 4, 4) and (M, 4, 4)."""
    a, b = (
        np.concatenate(
            [each[:, :3, 3] / lengths[0], each[:, :3, :3].reshape(-1, 9) / lengths[1]], axis=1
        )
        for each in (T, others)
    )
    return np.exp(-((a[:, None] - b) ** 2).sum(axis=2))


def constant_transformations(T: Array) -> Array:
    """Compute increments (N, 6, 12) of poses (N, 4, 4) by transformations before and after them."""
    R, t = T[:, :3, :3], T[:, :3, 3]
    by = np.zeros((len(T), 6, 12))
    by[:, :3, :3] = by[:, 3:, 3:6] = np.eye(3)
    by[:, 3:, :3] = -hat(t)
    by[:, :3, 6:9] = by[:, 3:, 9:] = R
    return by
