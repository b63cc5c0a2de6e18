"""How eyes and their cameras stand at readings, and how all that moves them changes their poses.

What two cameras show of a scene depends on their lenses and on one pose, of six numbers, whatever
joints and mountings it comes from: they are those of both eyes, or one at two moments.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array
from vergence.geometry.batches import batch_first, batch_last, product, times
from vergence.geometry.head import HeadCalibration, parameter_names
from vergence.geometry.joints import axis_error, joint_frames, pose_of
from vergence.geometry.kinematics import (
    EYES,
    Kinematics,
    Side,
    check_turns,
    checked_readings,
    eye_pose,
)
from vergence.geometry.parameters import camera_columns
from vergence.geometry.projection import camera_pose
from vergence.geometry.se3 import POSE, cross, hat, inverse, rigid_poses


@dataclass(frozen=True, eq=False)
class EyeMotion:
    """The pose of an eye in its base, and how it changes; in increments of `se3.boxplus`."""

    T_base_eye: Array
    """(..., 4, 4)."""
    by_moves: Array
    """(..., 6, m) by the angles of the joints, then by those errors of the joints that move an
    axis."""
    mixing: Array
    """(n, r): what turns the n angles, by the readings."""
    errors: tuple[tuple[int, Array | float], ...]
    """(a) in the order of joint_parameters: a column of by_moves, and its factor (...)."""

    def by_readings(self, by_moves: Array) -> Array:
        """Turn derivatives (..., k, m) by what moves the eye into those by readings (..., k, r)."""
        return product(by_moves[..., : len(self.mixing)], self.mixing)

    def by_errors(self, by_moves: Array) -> Array:
        """Turn derivatives (..., k, m) into those by the errors of the joints (..., k, a)."""
        rows = batch_last(by_moves, 2)
        found = np.empty((len(rows), len(self.errors), *rows.shape[2:]))
        for column, (move, factor) in enumerate(self.errors):
            np.multiply(rows[:, move], factor, out=found[:, column])
        return batch_first(found, 2)


def eye_motion(
    kinematics: Kinematics, eye: Side, readings: Array, *, errors: bool = True
) -> EyeMotion:
    """Compute how an eye stands at readings (..., r) [rad], and how that changes."""
    chain, parts = kinematics.chains[eye], batch_last(readings)
    R, t = joint_frames(chain, readings)
    axes = [times(R_joint, axis) for R_joint, axis in zip(R, chain.axes, strict=False)]
    moves: list[tuple[Array | None, Array]] = [(a, t[-1] - t[k]) for k, a in enumerate(axes)]
    factors: list[tuple[int, Array | float]] = []
    joints, names = kinematics.eyes[eye], kinematics.readings
    for k, name in kinematics.parameters[eye] if errors else ():
        error = axis_error(joints, k, name)
        if error is None:  # of the angle
            own = {name.removeprefix("factor_"): 1.0}
            if name in ("gain", "offset_rad"):
                own = joints[k].readings if name == "gain" else {}
            slope = sum(factor * parts[names.index(r)] for r, factor in own.items())
            factors.append((k, slope if own else 1.0))
            continue
        factors.append((len(moves), 1.0))
        tilts, direction = error
        along = times(R[k], direction)
        if tilts:
            # The axis is turned about the normal n: its turn R becomes exp(e n) R exp(-e n).
            moves.append((along - times(R[k + 1], direction), t[-1] - t[k]))
        else:
            moves.append((None, along))
    by_moves = np.empty((6, len(moves), *readings.shape[:-1]))
    for column, (turn, arm) in enumerate(moves):
        into = batch_first(by_moves[:, column])
        if turn is None:
            into[..., :3], into[..., 3:] = 0.0, arm
        else:
            into[..., :3], into[..., 3:] = turn, cross(turn, arm)
    T = pose_of(R[-1], t[-1], readings.shape[:-1])
    return EyeMotion(T, batch_first(by_moves, 2), chain.mixing, tuple(factors))


def eye_linearised(
    kinematics: Kinematics, eye: Side, readings: ArrayLike
) -> tuple[Array, Array, Array]:
    """Compute T_base_eye (..., 4, 4) and its derivatives, in the increment of `se3.boxplus`.

    By the errors of the joints (..., 6, a), in the order of joint_parameters, and by the readings
    (..., 6, r). Readings are (..., r) [rad]; VergenceError if they are not the head's r.
    """
    found = eye_motion(kinematics, eye, checked_readings(kinematics, readings))
    return found.T_base_eye, found.by_errors(found.by_moves), found.by_readings(found.by_moves)


def measured(joints: ArrayLike) -> bool:
    """Check whether readings are measured eye poses (..., 2, 4, 4) instead of angles (..., r)."""
    return np.shape(joints)[-3:] == (2, 4, 4)


def check_joints(kinematics: Kinematics, joints: Array) -> None:
    """Raise VergenceError for readings (..., r) in degrees, and for poses that are not rigid."""
    if measured(joints):
        rigid_poses("joints", joints)
    else:
        check_turns(kinematics, joints)


def eye_poses(head: HeadCalibration, joints: ArrayLike) -> Array:
    """Compute T_base_eye (..., 2, 4, 4) of the left and the right eye at readings (..., r) [rad].

    Measured poses (..., 2, 4, 4) are corrected by what the head states of their errors.
    VergenceError if it is neither.
    """
    if measured(joints):
        T, _ = rigid_poses("joints", np.asarray(joints, dtype=float))
        if head.pose_errors:
            T = T.copy()
            for eye, errors in head.pose_errors.items():
                e = EYES.index(eye)
                T[..., e, :, :] = errors.corrected(T[..., e, :, :])
        poses = batch_last(T, 3)
        return batch_first(np.ascontiguousarray(poses), 3)
    both = [eye_pose(head.kinematics, eye, joints) for eye in EYES]
    return batch_first(np.stack([batch_last(T, 2) for T in both]), 3)


def eye_motions(
    head: HeadCalibration, joints: Array, *, errors: bool = True
) -> tuple[EyeMotion, EyeMotion]:
    """Compute how the left and the right eye stand, and how that changes.

    At angles (..., r) [rad], or measured poses (..., 2, 4, 4), whose 12 increments count as
    readings and for which errors of the joints do nothing.
    """
    if not measured(joints):
        left, right = (eye_motion(head.kinematics, eye, joints, errors=errors) for eye in EYES)
        return left, right
    poses, increments = eye_poses(head, joints), np.eye(12).reshape(2, 6, 12)
    left, right = (
        EyeMotion(
            poses[..., k, :, :],
            np.eye(6),
            increments[k],
            ((0, 0.0),) * len(head.kinematics.parameters[eye]),
        )
        for k, eye in enumerate(EYES)
    )
    return left, right


_UNIT = np.eye(len(POSE))


@dataclass(frozen=True, eq=False)
class CameraMotion:
    """T_lbase_cam of a camera, and its increments (`se3.boxplus`)."""

    T_lbase_cam: Array
    """(4, 4)"""
    by_parameters: Array
    """(6, P) by the parameters of the head, as in `parameter_names`."""
    by_readings: Array
    """(6, r)"""


@dataclass(frozen=True, eq=False)
class RelativeMotion:
    """T_second_first of two cameras, and its increments (`se3.boxplus`)."""

    T_second_first: Array
    """(4, 4)"""
    by_parameters: Array
    """(6, P) by the parameters of the head, as in `parameter_names`."""
    by_first: Array
    """(6, r) by the readings at which the first camera is where it is."""
    by_second: Array
    """(6, r) by those of the second."""


def camera_motion(head: HeadCalibration, camera: str, joints: Array) -> CameraMotion:
    """Compute the pose of a camera of a head at readings (r,) [rad], and its derivatives."""
    mounted = head.camera(camera)
    T_base_eye, by_errors, by_readings = eye_linearised(head.kinematics, mounted.eye, joints)
    R, arm = T_base_eye[:3, :3], T_base_eye[:3, :3] @ mounted.T_eye_cam[:3, 3]
    of_eye = np.concatenate([by_errors, by_readings], axis=1)
    of_eye[3:] -= hat(arm) @ of_eye[:3]  # it turns the camera about the eye's origin
    mounting, of_base = _rotated(R, _UNIT), np.zeros_like(_UNIT)
    if mounted.eye == "right":
        back = head.T_rbase_lbase[:3, :3].T
        of_base = -_UNIT
        of_base[3:, :3] = hat(T_base_eye[:3, 3] + arm - head.T_rbase_lbase[:3, 3])
        of_base, mounting, of_eye = (_rotated(back, each) for each in (of_base, mounting, of_eye))
    errors = by_errors.shape[1]
    by_parameters = np.zeros((len(POSE), len(parameter_names(head))))
    # The first columns of a camera are those of its lens.
    moving = camera_columns(head, camera)[-2 * len(POSE) - errors :]
    by_parameters[:, moving] = np.concatenate([mounting, of_base, of_eye[:, :errors]], axis=1)
    T = camera_pose(mounted, head.T_rbase_lbase, T_base_eye)
    return CameraMotion(T, by_parameters, of_eye[:, errors:])


def _rotated(R: Array, increments: Array) -> Array:
    """Rotate increments (6, n) into other axes by R (3, 3)."""
    return np.concatenate([R @ increments[:3], R @ increments[3:]])


def relative_motion(first: CameraMotion, second: CameraMotion) -> RelativeMotion:
    """Compute the pose of the first camera in the second; of the two eyes, Eq. 11 linearised."""
    back = second.T_lbase_cam[:3, :3].T
    turned = -_UNIT  # what the second camera's increments do to the first, seen from it
    turned[3:, :3] = hat(first.T_lbase_cam[:3, 3] - second.T_lbase_cam[:3, 3])
    return RelativeMotion(
        inverse(second.T_lbase_cam) @ first.T_lbase_cam,
        _rotated(back, first.by_parameters + turned @ second.by_parameters),
        _rotated(back, first.by_readings),
        _rotated(back, turned @ second.by_readings),
    )
