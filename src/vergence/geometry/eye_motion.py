"""How eyes stand at readings of their joints, and how their poses change with all that moves them.

For one eye of any chain, and for both eyes of a head, whose poses may be measured instead.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array
from vergence.geometry.batches import batch_first, batch_last, rows_in_memory, times
from vergence.geometry.chain import angle_twists, joint_frames, pose_of, twist
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import (
    EYES,
    Kinematics,
    Side,
    T_base_eye,
    check_turns,
    checked_readings,
)
from vergence.geometry.se3 import check_rigid

EyeMotion = tuple[Array, Array, Array]
"""T_base_eye (..., 4, 4), and its increments (`se3.boxplus`) by the errors of the joints
(..., 6, a), in the order of joint_parameters, and by the readings (..., 6, r)."""


def eye_linearised(kinematics: Kinematics, eye: Side, readings: ArrayLike) -> EyeMotion:
    """Compute the pose of an eye and its derivatives at readings (..., r) [rad].

    VergenceError if they are not the head's r.
    """
    readings = checked_readings(kinematics, readings)
    chain, batch = kinematics.chains[eye], readings.shape[:-1]
    R, t = joint_frames(chain, readings)
    by_angles, parts = angle_twists(R, t, chain.axes), batch_last(readings)
    errors = kinematics.errors[eye]
    by_errors = batch_first(np.zeros((6, len(errors), *batch)), 2)
    by_readings = batch_first(np.zeros((6, readings.shape[-1], *batch)), 2)
    for column, error in enumerate(errors):
        k, into = error.joint, by_errors[..., column]
        if error.direction is None:  # of an angle
            slope = error.constant + sum(factor * parts[r] for r, factor in error.mixing)
            into[...] = by_angles[k] * np.asarray(slope)[..., None]
        elif error.tilts:
            # The axis is turned about the normal n: its turn R becomes exp(e n) R exp(-e n).
            turn = times(R[k], error.direction) - times(R[k + 1], error.direction)
            into[...] = twist(turn, t[-1] - t[k])
        else:
            into[..., 3:] = times(R[k], error.direction)
    for k, moving in enumerate(chain.moving):
        for r, factor in moving:
            by_readings[..., r] += factor * by_angles[k]
    return pose_of(R[-1], t[-1], batch), by_errors, by_readings


def measured(joints: ArrayLike) -> bool:
    """Check whether readings are measured eye poses (..., 2, 4, 4) instead of angles (..., r)."""
    return np.shape(joints)[-3:] == (2, 4, 4)


def check_joints(kinematics: Kinematics, joints: Array) -> None:
    """Raise VergenceError for readings (..., r) in degrees, and for poses that are not rigid."""
    if measured(joints):
        check_rigid("joints", joints)
    else:
        check_turns(kinematics, joints)


def eye_poses(head: HeadCalibration, joints: ArrayLike) -> Array:
    """Compute T_base_eye (..., 2, 4, 4) of the left and the right eye at readings (..., r) [rad].

    Measured poses (..., 2, 4, 4) are returned as they are. VergenceError if it is neither.
    """
    if measured(joints):
        return rows_in_memory(np.asarray(joints, dtype=float), 3)
    both = [T_base_eye(head.kinematics, eye, joints) for eye in EYES]
    return batch_first(np.stack([batch_last(T, 2) for T in both]), 3)


def eyes_linearised(head: HeadCalibration, joints: Array) -> tuple[EyeMotion, EyeMotion]:
    """Compute the poses of the left and the right eye and their derivatives.

    At angles (..., r) [rad], or measured poses (..., 2, 4, 4), whose 12 increments count as
    readings and for which the joints have no errors.
    """
    if not measured(joints):
        left, right = (eye_linearised(head.kinematics, eye, joints) for eye in EYES)
        return left, right
    poses, increments = eye_poses(head, joints), np.eye(12).reshape(2, 6, 12)
    left, right = (
        (poses[..., k, :, :], np.zeros((6, len(head.kinematics.errors[eye]))), increments[k])
        for k, eye in enumerate(EYES)
    )
    return left, right
