"""Chains of revolute joints: from readings to the pose of what hangs at the end."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vergence.arrays import Array
from vergence.geometry.batches import (
    batch_first,
    batch_last,
    ignoring_invalid,
    product,
    times,
)
from vergence.geometry.se3 import hat


@dataclass(frozen=True, eq=False)
class Chain:
    """n revolute joints from a base outwards, moved by r readings.

    Axes and points are given in the base with every joint at zero, where all frames are parallel.
    """

    axes: Array
    """(n, 3) unit vectors."""
    points_m: Array
    """(n, 3) a point on each axis."""
    end_m: Array
    """(3,) origin of the frame at the end of the chain."""
    mixing: Array
    """(n, r): angles = mixing @ readings + offset."""
    offset_rad: Array
    """(n,)."""

    @cached_property
    def steps_m(self) -> Array:
        """(n, 3) from each joint to the next one, or to the end."""
        return np.diff(np.vstack([self.points_m, self.end_m]), axis=0)

    @cached_property
    def moving(self) -> list[list[tuple[int, float]]]:
        """By joint the readings that move it, and their factors."""
        return [
            [(r, factor) for r, factor in enumerate(row) if factor] for row in self.mixing.tolist()
        ]

    @cached_property
    def rodrigues(self) -> Array:
        """(n, 9, 3) by which cosine, sine and 1 - cosine of an angle make the turn of its joint."""
        outer = self.axes[:, :, None] * self.axes[:, None]
        unit = np.broadcast_to(np.eye(3), outer.shape)
        return np.stack([unit, hat(self.axes), outer], axis=-1).reshape(-1, 9, 3)


@ignoring_invalid
def joint_frames(chain: Chain, readings: Array) -> tuple[list[Array], list[Array]]:
    """Compute rotation and origin of each joint before it turns, and then of the chain's end.

    They are n + 1 rotations (..., 3, 3) and as many origins (..., 3) at readings (..., r) [rad].
    """
    parts, batch = batch_last(readings), readings.shape[:-1]
    R, t = [np.eye(3)], [chain.points_m[0] if len(chain.axes) else chain.end_m]
    for k, (basis, step) in enumerate(zip(chain.rodrigues, chain.steps_m, strict=True)):
        angle = chain.offset_rad[k] + sum(factor * parts[r] for r, factor in chain.moving[k])
        cosine, sine = np.cos(angle), np.sin(angle)
        terms = np.array([cosine, sine, 1 - cosine]).reshape(3, math.prod(batch))
        turn = batch_first((basis @ terms).reshape(3, 3, *batch), 2)
        R.append(product(R[-1], turn) if k else turn)
        t.append(t[-1] + times(R[-1], step) if step.any() else t[-1])
    return R, t


def chain_pose(chain: Chain, readings: Array) -> Array:
    """Compute the pose (..., 4, 4) of a chain's end in its base at readings (..., r) [rad]."""
    R, t = joint_frames(chain, readings)
    return pose_of(R[-1], t[-1], readings.shape[:-1])


def pose_of(R: Array, t: Array, batch: tuple[int, ...]) -> Array:
    """Join rotations and translations, which broadcast, to poses (*batch, 4, 4)."""
    T = batch_first(np.empty((4, 4, *batch)), 2)
    T[..., :3, :3], T[..., :3, 3], T[..., 3, :] = R, t, [0.0, 0.0, 0.0, 1.0]
    return T
