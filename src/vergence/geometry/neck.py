"""The chain from the body to the head."""

from __future__ import annotations

from dataclasses import field
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass

from vergence.arrays import MAX_M, Array, Vector3, Vectors3
from vergence.errors import VergenceError, counted
from vergence.geometry.joints import Chain, chain_pose
from vergence.geometry.kinematics import MAX_JOINTS

NeckJoint = Literal["neck_pitch", "neck_roll", "neck_yaw"]
NECK_JOINTS: tuple[NeckJoint, ...] = get_args(NeckJoint)
"""The joints of a neck in the order of frames and postures; that of this project's head, from the
body outwards."""


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
    joints: tuple[NeckJoint, ...] = ()
    """Which joint turns about each axis (n,). Without names three axes are those of NECK_JOINTS; a
    frame does not tell the angles of others."""

    @property
    def names(self) -> tuple[NeckJoint, ...]:
        """Names of the joints, from the body outwards; empty: they have none."""
        return self.joints or (NECK_JOINTS if len(self.axes) == len(NECK_JOINTS) else ())

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


def checked_neck_angles(angles: ArrayLike) -> Array:
    """Check the neck angles (3,) [rad] of a frame; VergenceError if they are something else."""
    angles = np.array(angles, float)  # a copy, since a driver may write the next into the array
    if angles.shape != (len(NECK_JOINTS),) or not np.isfinite(angles).all():
        raise VergenceError(
            f"A frame has the {len(NECK_JOINTS)} neck angles {', '.join(NECK_JOINTS)} [rad], all "
            f"finite; found an array of shape {angles.shape}: {angles.tolist()}. Joints that the "
            "head does not have read zero."
        )
    return angles


def chain_angles(neck: Neck, neck_angles: Array) -> Array:
    """Select the angles (..., n) [rad] of a neck's joints among those of a frame or a posture.

    These begin with those of NECK_JOINTS. VergenceError if the neck's joints have no names.
    """
    check_named(neck)
    return neck_angles[..., [NECK_JOINTS.index(name) for name in neck.names]]


def check_named(neck: Neck) -> None:
    """Raise VergenceError for a neck whose joints a frame has no angles of."""
    if len(neck.names) != len(neck.axes):
        raise VergenceError(
            f"The neck of this calibration has {counted(len(neck.axes), 'joint')} without names, "
            f"and a frame has the angles {', '.join(NECK_JOINTS)}: name the joints by these, "
            "`joints` under `neck` in the calibration file."
        )


def head_pose(neck: Neck, angles: Array) -> Array:
    """Compute the pose (..., 4, 4) of the head in frame body at neck angles (..., n) [rad]."""
    n = len(neck.axes)
    return chain_pose(Chain(neck.axes, neck.points_m, neck.head_m, np.eye(n), np.zeros(n)), angles)
