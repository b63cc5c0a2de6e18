"""Measured poses of a target in place of the corners of a board: their errors and derivatives.

Devices that track a body, and detectors of single markers, give the pose T_cam_target of what they
see, with a covariance, instead of corners. The six numbers of `se3.boxminus`, whitened by that
covariance, take the place of the corners' coordinates, in three pairs: all else of the bundle
adjustment stays, and the noise level of a corner [px] becomes a factor on the stated deviations.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.head import MountedCamera
from vergence.geometry.projection import T_lbase_cam
from vergence.geometry.se3 import boxminus, cross, hat, inverse

PAIRS = 3
"""Pairs of numbers of a pose; they stand where the corners of a board would."""


@dataclass(frozen=True, eq=False)
class PoseObservations:
    """Poses of a target that cameras measured in V views: `Observations` for devices that do so."""

    T_cam_target: Mapping[str, Array]
    """By camera: (V, 4, 4); NaN where none was measured."""
    whitening: Mapping[str, Array]
    """By camera: (V, 6, 6), see MeasuredPoses."""
    placement: np.ndarray
    """As the three that follow, see Observations."""
    eye_angles: Array
    T_base_eye: Array | None
    timing: ClassVar[None] = None
    systematic_px: ClassVar[float] = 0.0


@dataclass(frozen=True, eq=False)
class MeasuredPoses:
    """What M detections of a target gave."""

    T_cam_target: Array
    """(M, 4, 4)."""
    whitening: Array
    """(M, 6, 6): turns errors, rotation [rad] and then translation [m] along the camera's axes,
    into independent ones of unit variance."""


def whitening(covariance: Array) -> Array:
    """Return (..., 6, 6) of covariances (..., 6, 6); VergenceError if one is not positive."""
    with suppress(np.linalg.LinAlgError):
        if np.isfinite(covariance).all():
            return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), dtype=float)
    raise VergenceError(
        "The covariance of a measured pose is symmetric and positive definite, rotation [rad] "
        "first and then translation [m]; found one that is not."
    )


def pose_errors(measured: MeasuredPoses, T_cam_target: Array) -> Array:
    """Return (M, 3, 2): expected poses (M, 4, 4) minus measured ones, whitened."""
    off = boxminus(T_cam_target, measured.T_cam_target)
    return (measured.whitening @ off[..., None]).reshape(-1, PAIRS, 2)


def expected_poses(
    mounted: MountedCamera, T_rbase_lbase: Array, T_base_eye: Array, T_lbase_target: Array
) -> Array:
    """Return T_cam_target (M, 4, 4) of one camera at eye poses and targets (M, 4, 4)."""
    return inverse(T_lbase_cam(mounted, T_rbase_lbase, T_base_eye)) @ T_lbase_target


def pose_jacobians(
    mounted: MountedCamera, T_rbase_lbase: Array, T_base_eye: Array, T_lbase_target: Array
) -> tuple[Array, Array, Array, Array]:
    """Return derivatives (M, 6, 6) of the increment of T_cam_target.

    By T_eye_cam, T_base_eye, T_rbase_lbase (zero for the left eye) and T_lbase_target; arguments
    are those of expected_poses.
    """
    right = mounted.eye == "right"
    origin = T_lbase_target[:, :3, 3]
    turned = origin @ T_rbase_lbase[:3, :3].T if right else origin
    in_base = turned + T_rbase_lbase[:3, 3] if right else turned
    arm = in_base - T_base_eye[:, :3, 3]
    R_base_eye = T_base_eye[:, :3, :3]
    from_camera = (arm[:, None] @ R_base_eye)[:, 0] - mounted.T_eye_cam[:3, 3]
    by_eye = np.broadcast_to(mounted.T_eye_cam[:3, :3].T, R_base_eye.shape)
    by_base = by_eye @ np.swapaxes(R_base_eye, 1, 2)
    by_lbase = by_base @ T_rbase_lbase[:3, :3] if right else by_base
    between = -_by_increment(by_base, turned) if right else np.zeros((len(origin), 6, 6))
    return (
        _by_increment(by_eye, from_camera),
        _by_increment(by_base, arm),
        between,
        -_by_increment(by_lbase, np.zeros_like(origin)),  # the target turns about its own origin
    )


def _by_increment(R: Array, arm: Array) -> Array:
    """Return derivatives (M, 6, 6) by the pose of a frame in which the target is looked at.

    R (M, 3, 3) turns the increment's axes into those of the camera, arm (M, 3) is the target's
    origin from that of the frame, along the increment's axes.
    """
    rows = np.zeros((len(arm), 6, 6))
    rows[:, :3, :3] = rows[:, 3:, 3:] = -R
    rows[:, 3:, :3] = cross(R, arm[:, None])
    return rows


def whitened(measured: MeasuredPoses, T_cam_target: Array, rows: Array) -> Array:
    """Return derivatives (M, 3, 2, n) of pose_errors, by those (M, 6, n) of the poses' increments.

    The rotation of an error changes by the inverse of the left Jacobian of SO(3), here to the
    fourth order in an error that is far below 1 rad.
    """
    turn = boxminus(T_cam_target, measured.T_cam_target)[:, :3]
    K, square = hat(turn), (turn**2).sum(axis=-1)[:, None, None]
    inner = rows.copy()
    inner[:, :3] += (-K / 2 + (1 / 12 + square / 720) * (K @ K)) @ rows[:, :3]
    return (measured.whitening @ inner).reshape(len(rows), PAIRS, 2, -1)
