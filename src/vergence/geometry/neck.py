"""The chain from the body to the head."""

from __future__ import annotations

from dataclasses import field

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass

from vergence.arrays import MAX_M, Array, Vector3, Vectors3
from vergence.errors import VergenceError, counted
from vergence.geometry.joints import Chain, ReadingName, chain_pose
from vergence.geometry.kinematics import MAX_JOINTS


@dataclass(frozen=True, eq=False, config=ConfigDict(extra="forbid"))
class Neck:
    """The chain from body to head: each joint turns about an axis through a point.

    Axes and points are given in the frame body with every joint at zero, where the axes of body
    and head are parallel.
    """

    axes: Vectors3 = field(default_factory=lambda: np.empty((0, 3)))
    """(n, 3) unit vectors, from the body outwards."""
    points_m: Vectors3 = field(default_factory=lambda: np.empty((0, 3)))
    """(n, 3) a point on each axis."""
    head_m: Vector3 = field(default_factory=lambda: np.zeros(3))
    """Origin of frame head."""
    joints: tuple[ReadingName, ...] = ()
    """Names of the joints (n,); empty: neck_1, neck_2 and so on."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints, from the body outwards, as postures and frames have them."""
        return self.joints or tuple(f"neck_{k + 1}" for k in range(len(self.axes)))

    def __post_init__(self) -> None:
        n = len(self.axes)
        if len(self.points_m) != n or n > MAX_JOINTS:
            raise ValueError(
                f"a neck has at most {MAX_JOINTS} joints and a point on each axis, found "
                f"{counted(n, 'axis', 'axes')} and {counted(len(self.points_m), 'point')}"
            )
        if self.joints and not len(set(self.joints)) == len(self.joints) == n:
            raise ValueError(
                f"a neck's {counted(n, 'joint')} have a name each, found {', '.join(self.joints)}"
            )
        largest = max(np.abs(self.points_m).max(initial=0.0), np.abs(self.head_m).max())
        if largest > MAX_M:
            raise ValueError(f"points are in metres, found {largest:g}")
        lengths = np.linalg.norm(self.axes, axis=1)
        if (np.abs(lengths - 1) > 1e-6).any():
            raise ValueError(f"axes are unit vectors, found one of length {lengths.max():.6g}")


def checked_neck_angles(neck: Neck, angles: ArrayLike) -> Array:
    """Check the neck angles (n,) [rad] of a frame; VergenceError if they are something else.

    A head without a neck stands still in its body, whatever the frame has.
    """
    angles, n = np.array(angles, float), len(neck.axes)  # a copy: a driver may reuse the array
    if n == 0:
        return np.empty(0)
    if angles.shape != (n,) or not np.isfinite(angles).all():
        raise VergenceError(
            f"A frame of this head has the {counted(n, 'neck angle')} {', '.join(neck.names)} "
            f"[rad], all finite; found an array of shape {angles.shape}: {angles.tolist()}."
        )
    return angles


def head_pose(neck: Neck, angles: Array) -> Array:
    """Compute the pose (..., 4, 4) of the head in frame body at neck angles (..., n) [rad]."""
    n = len(neck.axes)
    return chain_pose(Chain(neck.axes, neck.points_m, neck.head_m, np.eye(n), np.zeros(n)), angles)
