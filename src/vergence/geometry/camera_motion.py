"""The pose of a camera, and that of one camera to another, with derivatives by all that moves them.

The other one may be a camera of the other eye, or the same one at another moment. What two cameras
show of a scene depends on their lenses and on this one pose, of six numbers, whatever chain of
joints and mountings it comes from.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.geometry.eye_motion import eye_linearised
from vergence.geometry.head import HeadCalibration, parameter_names
from vergence.geometry.parameters import camera_columns
from vergence.geometry.projection import T_lbase_cam
from vergence.geometry.se3 import POSE, hat, inverse

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
    T = T_lbase_cam(mounted, head.T_rbase_lbase, T_base_eye)
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
