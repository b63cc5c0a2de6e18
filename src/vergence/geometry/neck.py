"""The chain from the body to the head."""

from __future__ import annotations

from dataclasses import field

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass

from vergence.arrays import MAX_M, Array, Vector3, Vectors3
from vergence.errors import VergenceError, counted
from vergence.geometry.chain import Chain, chain_pose
from vergence.geometry.kinematics import MAX_JOINTS

NECK_JOINTS = ("neck_pitch", "neck_roll", "neck_yaw")
"""The joints of the neck of this project's head, from the body outwards."""


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

    def __post_init__(self) -> None:
        if len(self.axes) != len(self.points_m):
            raise ValueError(
                f"a neck has a point on each axis, found "
                f"{counted(len(self.axes), 'axis', 'axes')} and "
                f"{counted(len(self.points_m), 'point')}"
            )
        if len(self.axes) > MAX_JOINTS:
            raise ValueError(f"a neck has at most {MAX_JOINTS} joints, found {len(self.axes)}")
        largest = max(np.abs(self.points_m).max(initial=0.0), np.abs(self.head_m).max())
        if largest > MAX_M:
            raise ValueError(f"points are in metres, found {largest:g}")
        lengths = np.linalg.norm(self.axes, axis=1)
        if (np.abs(lengths - 1) > 1e-6).any():
            raise ValueError(f"axes are unit vectors, found one of length {lengths.max():.6g}")


def checked_neck_angles(angles: ArrayLike) -> Array:
    """Return the neck angles (3,) [rad] of a frame; VergenceError if they are something else."""
    angles = np.array(angles, float)  # a copy, since a driver may write the next into the array
    if angles.shape != (len(NECK_JOINTS),) or not np.isfinite(angles).all():
        raise VergenceError(
            f"A frame has the {len(NECK_JOINTS)} neck angles {', '.join(NECK_JOINTS)} [rad], all "
            f"finite; found an array of shape {angles.shape}: {angles.tolist()}. Joints that the "
            "head does not have read zero."
        )
    return angles


def T_body_head(neck: Neck, angles: Array) -> Array:
    """Return the pose (..., 4, 4) of the head in frame body at neck angles (..., n) [rad]."""
    n = len(neck.axes)
    return chain_pose(Chain(neck.axes, neck.points_m, neck.head_m, np.eye(n), np.zeros(n)), angles)
