"""Joint angles to poses: the eyes' pan and tilt, with imperfect axes, and the neck's chain.

Pan is a right-handed turn about +z (positive looks left), tilt about +y (positive looks down),
pan first: `R_base_eye = Rz(pan) Ry(tilt)`.
"""

from __future__ import annotations

from dataclasses import field
from typing import Literal

import numpy as np
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass

from vergence.arrays import Array, Vector3, Vectors3
from vergence.geometry.se3 import pose, rotation

Side = Literal["left", "right"]
EYES: tuple[Side, Side] = ("left", "right")
EYE_JOINTS = ("left_pan", "left_tilt", "right_pan", "right_tilt")
"""Order of the columns wherever the angles of both eyes stand in one (N, 4) array."""
NECK_JOINTS = ("neck_pitch", "neck_roll", "neck_yaw")


@dataclass(frozen=True, eq=False, config=ConfigDict(extra="forbid"))
class EyeAxes:
    """How the two axes of one eye differ from perfect ones; the default is perfect.

    True angle = gain * reading + offset.
    """

    pan_gain: float = 1.0
    tilt_gain: float = 1.0
    pan_offset_rad: float = 0.0
    tilt_offset_rad: float = 0.0
    nonorthogonality_rad: float = 0.0
    """Turn of the tilt axis about +x, out of the plane that is perpendicular to the pan axis."""
    axis_distance_m: float = 0.0
    """Distance of the tilt axis ahead (+x) of the pan axis, which it should intersect."""


def T_base_eye(angles: Array, axes: EyeAxes | None = None) -> Array:
    """Return the pose (..., 4, 4) of the eye in its fixed base frame: T_er(theta) of the paper.

    Args:
        angles: (..., 2) readings of pan and tilt [rad].
        axes: the eye's imperfections; None: none.
    """
    axes = EyeAxes() if axes is None else axes
    pan = axes.pan_gain * angles[..., 0] + axes.pan_offset_rad
    tilt = axes.tilt_gain * angles[..., 1] + axes.tilt_offset_rad
    tilt_axis = np.array([0, np.cos(axes.nonorthogonality_rad), np.sin(axes.nonorthogonality_rad)])
    turns = np.stack([pan[..., None] * np.array([0.0, 0.0, 1.0]), tilt[..., None] * tilt_axis])
    R_pan, R_tilt = rotation(turns)
    return pose(R_pan @ R_tilt, R_pan @ np.array([axes.axis_distance_m, 0.0, 0.0]))


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


def T_body_head(neck: Neck, angles: Array) -> Array:
    """Return the pose (..., 4, 4) of the head in frame body at neck angles (..., n) [rad]."""
    T = pose(np.broadcast_to(np.eye(3), (*angles.shape[:-1], 3, 3)))
    R = rotation(angles[..., None] * neck.axes)
    for k, point in enumerate(neck.points_m):
        T = T @ pose(R[..., k, :, :], point - R[..., k, :, :] @ point)
    return T @ pose(t=neck.head_m)
