"""Chains of revolute joints: from readings to the pose of what hangs at the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from vergence.arrays import Array
from vergence.geometry.components import (
    Component,
    Rows,
    Vector,
    components,
    plus,
    product,
    sine_cosine,
    stacked,
    times,
)


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
    def turns(self) -> tuple[_Turn, ...]:
        """The joints, from the base outwards."""
        ends = [*self.points_m, self.end_m]
        return tuple(
            _Turn(
                axis=axis,
                step=(ends[k + 1] - ends[k]).tolist(),
                entries=_rodrigues(axis),
                mixing=[(r, f) for r, f in enumerate(self.mixing[k].tolist()) if f],
                offset_rad=float(self.offset_rad[k]),
            )
            for k, axis in enumerate(self.axes.tolist())
        )

    @cached_property
    def nonzero(self) -> list[tuple[int, int, float]]:
        """The entries of the mixing that are not zero: (joint, reading, factor)."""
        return [(k, *each) for k, turn in enumerate(self.turns) for each in turn.mixing]


class _Turn(NamedTuple):
    """A joint of a chain, in plain numbers."""

    axis: list[float]
    step: list[float]
    """From this joint to the next one, or to the end."""
    entries: list[tuple[int, int, float, float]]
    """Terms of Rodrigues' formula that are not zero: row, column, and the entries of the turn's
    generator and of its square, which the sine and one minus the cosine are multiplied by."""
    mixing: list[tuple[int, float]]
    """Readings that move it, and their factors."""
    offset_rad: float


_ONE = np.eye(4).tolist()


def _rodrigues(axis: list[float]) -> list[tuple[int, int, float, float]]:
    """Return the `entries` of a turn about an axis: G = hat(axis), and G^2 = a a^T - a^T a I."""
    x, y, z = axis
    generator, square = ((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)), x * x + y * y + z * z
    found = [
        (i, j, generator[i][j], axis[i] * axis[j] - (square if i == j else 0.0))
        for i in range(3)
        for j in range(3)
    ]
    return [entry for entry in found if entry[2] or entry[3]]


def chain_pose(chain: Chain, readings: Array) -> Array:
    """Return the pose (..., 4, 4) of the chain's end in its base at readings (..., r) [rad]."""
    R, t = joint_frames(chain, by_reading(readings))
    return pose_of(R[-1], t[-1], readings.shape[:-1])


def by_reading(readings: Array) -> list[Component]:
    """Return readings (..., r) by components."""
    return components(readings.transpose(-1, *range(readings.ndim - 1)))


def pose_of(R: Rows, t: Vector, shape: tuple[int, ...]) -> Array:
    """Return poses (*shape, 4, 4)."""
    rows = [[*row, each] for row, each in zip(R, t, strict=True)]
    return batch_first(stacked([*rows, _ONE[3]], shape, ndim=2))


def batch_first(array: Array) -> Array:
    """Return an array (a, b, ...) as (..., a, b)."""
    return array.transpose(*range(2, array.ndim), 0, 1) if array.ndim > 2 else array


def joint_frames(chain: Chain, readings: Sequence[Component]) -> tuple[list[Rows], list[Vector]]:
    """Return n + 1 rotations and origins: of each joint before it turns, and of the chain's end."""
    R: list[Rows] = [[row[:3] for row in _ONE[:3]]]
    t: list[Vector] = [(chain.points_m[0] if len(chain.axes) else chain.end_m).tolist()]
    for joint in chain.turns:
        angle = joint.offset_rad
        for reading, factor in joint.mixing:
            angle = angle + factor * readings[reading]
        sine, cosine = sine_cosine(angle)
        versine, turn = 1 - cosine, [list(row) for row in R[0]]
        for i, j, of_sine, of_versine in joint.entries:
            if of_sine:
                turn[i][j] = turn[i][j] + of_sine * sine
            if of_versine:
                turn[i][j] = turn[i][j] + of_versine * versine
        R.append(product(R[-1], turn) if len(R) > 1 else turn)
        t.append(plus(t[-1], times(R[-1], joint.step)) if any(joint.step) else t[-1])
    return R, t
