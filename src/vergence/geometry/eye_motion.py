"""How eyes stand at readings of their joints, and how their poses change with all that moves them.

For one eye of any chain, and for both eyes of a head, whose poses may be measured instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array
from vergence.geometry.chain import batch_first, by_reading, joint_frames, pose_of
from vergence.geometry.components import (
    Component,
    Rows,
    Vector,
    components,
    cross,
    minus,
    pose_components,
    stacked,
    times,
)
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


def eye_linearised(
    kinematics: Kinematics, eye: Side, readings: ArrayLike
) -> tuple[Array, Array, Array]:
    """Return T_base_eye (..., 4, 4) and its derivatives, in the increment of `se3.boxplus`.

    By the errors of the joints (..., 6, a), in the order of joint_parameters, and by the readings
    (..., 6, r). Readings are (..., r) [rad]; VergenceError if they are not the head's r.
    """
    readings = checked_readings(kinematics, readings)
    motion, shape = eye_motion(kinematics, eye, by_reading(readings)), readings.shape[:-1]
    by_angles = [stacked(twist, shape) for twist in motion.by_angles]
    by_errors = np.empty((6, len(motion.by_errors), *shape))
    by_readings = np.zeros((6, len(kinematics.readings), *shape))
    for column, (joint, change) in enumerate(motion.by_errors):
        twist = stacked(change, shape) if joint is None else by_angles[joint] * change
        by_errors[:, column] = twist
    for joint, reading, factor in motion.angle_by_readings:
        by_readings[:, reading] += factor * by_angles[joint]
    return pose_of(motion.R, motion.t, shape), batch_first(by_errors), batch_first(by_readings)


class EyeMotion(NamedTuple):
    """The pose of an eye in its base and its derivatives, by components."""

    R: Rows
    t: Vector
    by_angles: list[Vector]
    """The increments (6) by the angles of the joints."""
    angle_by_readings: list[tuple[int, int, float]]
    """Joint, reading, and the derivative of the one's angle by the other."""
    by_errors: list[tuple[int | None, Any]]
    """By error of the joints, in the order of joint_parameters: a joint and the derivative of its
    angle; or, of an axis, None and the increment (6)."""


def eye_motion(kinematics: Kinematics, eye: Side, readings: Sequence[Component]) -> EyeMotion:
    """Return the pose of an eye and its derivatives at readings, by components."""
    turns = kinematics.chains[eye].turns
    R, t = joint_frames(kinematics.chains[eye], readings)
    by_angles, by_errors = [], []
    for k, turn in enumerate(turns):  # a joint turns the end about its axis
        axis = times(R[k], turn.axis)
        by_angles.append([*axis, *cross(axis, minus(t[-1], t[k]))])
    for error in kinematics.errors[eye]:
        k, direction = error.joint, error.direction
        if direction is None:
            factor = error.constant
            for reading, each in error.mixing:
                factor = factor + each * readings[reading]
            by_errors.append((k, factor))
        elif error.tilts:
            # The axis is turned about the normal n: its turn R becomes exp(e n) R exp(-e n).
            turned = minus(times(R[k], direction), times(R[k + 1], direction))
            by_errors.append((None, [*turned, *cross(turned, minus(t[-1], t[k]))]))
        else:
            by_errors.append((None, [0.0, 0.0, 0.0, *times(R[k], direction)]))
    return EyeMotion(R[-1], t[-1], by_angles, kinematics.chains[eye].nonzero, by_errors)


def measured(joints: ArrayLike) -> bool:
    """Return whether readings are measured eye poses (..., 2, 4, 4) instead of angles (..., r)."""
    return np.shape(joints)[-3:] == (2, 4, 4)


def check_joints(kinematics: Kinematics, joints: Array) -> None:
    """Raise VergenceError for readings (..., r) in degrees, and for poses that are not rigid."""
    if measured(joints):
        check_rigid("joints", joints)
    else:
        check_turns(kinematics, joints)


def eye_poses(head: HeadCalibration, joints: ArrayLike) -> Array:
    """Return T_base_eye (..., 2, 4, 4) of the left and the right eye at readings (..., r) [rad].

    Measured poses (..., 2, 4, 4) are returned as they are. VergenceError if it is neither.
    """
    if measured(joints):
        return np.asarray(joints, dtype=float)
    first = [
        np.moveaxis(T_base_eye(head.kinematics, eye, joints), (-2, -1), (0, 1)) for eye in EYES
    ]
    return np.moveaxis(np.stack(first), (0, 1, 2), (-3, -2, -1))


def eye_motions(head: HeadCalibration, joints: Array) -> tuple[EyeMotion, EyeMotion]:
    """Return the poses of the left and the right eye and their derivatives, by components.

    Readings are (n, r) angles [rad] or (n, 2, 4, 4) poses, whose increments stand for angles and
    readings. All of a posture is NaN if one number is.
    """
    finite = np.isfinite(joints)
    if not finite.all():
        usable = finite.reshape(len(joints), -1).all(axis=1)
        joints = np.where(usable.reshape(-1, *(1,) * (joints.ndim - 1)), joints, np.nan)
    if not measured(joints):
        readings = components(joints.T)
        left, right = (eye_motion(head.kinematics, eye, readings) for eye in EYES)
        return left, right
    left, right = (
        EyeMotion(
            *pose_components(joints[:, k]),
            by_angles=[*np.eye(6).tolist()],
            angle_by_readings=[(i, 6 * k + i, 1.0) for i in range(6)],
            by_errors=[(0, 0.0)] * len(head.kinematics.errors[eye]),
        )
        for k, eye in enumerate(EYES)
    )
    return left, right
