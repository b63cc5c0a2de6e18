"""The pose of a camera, and that of one camera to another, with derivatives by all that moves them.

The other one may be a camera of the other eye, or the same one at another moment. What two cameras
show of a scene depends on their lenses and on this one pose, of six numbers, whatever chain of
joints and mountings it comes from.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.geometry.eye_motion import eye_motion
from vergence.geometry.head import HeadCalibration
from vergence.geometry.parameter_names import POSE
from vergence.geometry.parameters import camera_columns, parameter_names
from vergence.geometry.projection import T_lbase_cam
from vergence.geometry.se3 import hat, inverse, pose


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
    """Return the pose of a camera of a head at readings (r,) [rad], and its derivatives."""
    mounted = head.camera(camera)
    eye = eye_motion(head.kinematics, mounted.eye, joints.tolist())
    T_base_eye = pose(eye.R, eye.t)
    R, arm = T_base_eye[:3, :3], T_base_eye[:3, :3] @ mounted.T_eye_cam[:3, 3]
    by_angles = np.array(eye.by_angles).reshape(-1, len(POSE)).T
    by_readings = np.zeros((len(POSE), len(joints)))
    for joint, reading, factor in eye.angle_by_readings:
        by_readings[:, reading] += factor * by_angles[:, joint]
    by_errors = [
        np.array(change) if joint is None else by_angles[:, joint] * change
        for joint, change in eye.by_errors
    ]
    of_eye = np.column_stack([*by_errors, by_readings])
    of_eye[3:] -= hat(arm) @ of_eye[:3]  # it turns the camera about the eye's origin
    of_base, mounting = np.zeros((2, len(POSE), len(POSE)))
    mounting[:3, :3] = mounting[3:, 3:] = R
    T = T_lbase_cam(mounted, head.T_rbase_lbase, T_base_eye)
    if mounted.eye == "right":
        back = head.T_rbase_lbase[:3, :3].T
        from_left = T_base_eye[:3, 3] + arm - head.T_rbase_lbase[:3, 3]
        of_base[:3, :3] = of_base[3:, 3:] = -back
        of_base[3:, :3] = back @ hat(from_left)
        of_eye, mounting = (
            np.concatenate([back @ each[:3], back @ each[3:]]) for each in (of_eye, mounting)
        )
    by_parameters = np.zeros((len(POSE), len(parameter_names(head))))
    # The first columns of a camera are those of its lens.
    moving = camera_columns(head, camera)[-2 * len(POSE) - len(by_errors) :]
    by_parameters[:, moving] = np.column_stack([mounting, of_base, of_eye[:, : len(by_errors)]])
    return CameraMotion(T, by_parameters, of_eye[:, len(by_errors) :])


def relative_motion(first: CameraMotion, second: CameraMotion) -> RelativeMotion:
    """Return how the first camera stands to the second; of the two eyes, Eq. 11 linearised."""
    back = second.T_lbase_cam[:3, :3].T
    between = hat(first.T_lbase_cam[:3, 3] - second.T_lbase_cam[:3, 3])

    def of_first(by: Array) -> Array:
        return np.concatenate([back @ by[:3], back @ by[3:]])

    def of_second(by: Array) -> Array:
        return np.concatenate([-back @ by[:3], back @ (between @ by[:3] - by[3:])])

    return RelativeMotion(
        inverse(second.T_lbase_cam) @ first.T_lbase_cam,
        of_first(first.by_parameters) + of_second(second.by_parameters),
        of_first(first.by_readings),
        of_second(second.by_readings),
    )
