"""Check a head that was read from a model: against MuJoCo, and for what its user should look at."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import mujoco
import numpy as np

from vergence.arrays import Array
from vergence.errors import listed
from vergence.geometry.head import base_pose, camera_pose_in_base
from vergence.geometry.kinematics import eye_joint_angles
from vergence.geometry.neck import head_pose
from vergence.geometry.se3 import inverse
from vergence.twin.designed_head import DesignedHead
from vergence.twin.head_file import HeadFile
from vergence.twin.model_chain import at_rest, body_pose


def pose_joints(
    model: mujoco.MjModel, designed: DesignedHead, readings: Array, neck: Array
) -> mujoco.MjData:
    """Place all bodies at readings (r,) and angles (n,) of the neck [rad]."""
    data = at_rest(model, ())
    for joint, angle in zip(designed.neck, neck, strict=True):
        data.joint(joint).qpos[0] = angle
    for eye, joints in designed.eyes.items():
        angles = eye_joint_angles(designed.head.kinematics, eye, readings)
        for joint, angle in zip(joints, angles, strict=True):
            data.joint(joint).qpos[0] = angle
    mujoco.mj_kinematics(model, data)
    return data


def disagreement(model: mujoco.MjModel, designed: DesignedHead) -> float:
    """Compare the head's kinematics with MuJoCo's at 20 random postures of eyes and neck.

    Returns the largest difference of an element of a pose: of a camera in frame head, and of frame
    head in frame body. Readings and angles are within 1 rad.
    """
    head, rng, differences = designed.head, np.random.default_rng(0), []
    r, n = len(head.kinematics.readings), len(designed.neck)
    T_world_body = np.eye(4)
    for k in range(21):
        readings, neck = rng.uniform(-1, 1, r), rng.uniform(-1, 1, n) * (k > 0)
        data = pose_joints(model, designed, readings, neck)
        T_world_head = body_pose(data, designed.base) @ designed.T_base_head
        if not k:
            T_world_body = T_world_head @ inverse(head_pose(head.neck, neck))
        differences.append(T_world_head - T_world_body @ head_pose(head.neck, neck))
        for name, mounted in head.cameras.items():
            T_world_cam = body_pose(data, designed.cameras[name]) @ designed.T_body_cam[name]
            T_head_cam = base_pose(head, mounted.eye) @ camera_pose_in_base(head, name, readings)
            differences.append(T_world_cam - T_world_head @ T_head_cam)
    return float(np.abs(differences).max())


def doubts(stated: HeadFile, designed: DesignedHead) -> list[str]:
    """Say what the user should check of a head whose complete description is `stated`."""
    found, eyes = [], designed.eyes
    if links := [name for name, camera in stated.cameras.items() if camera.body is not None]:
        found.append(
            f"Links are taken for cameras: {listed(links)}. Check where they look (pos_m, forward, "
            "up), and state their lenses (fov_deg or camera_info)."
        )
    if min(map(len, eyes.values())) < 2:
        found.append(
            "An eye with one joint can look, but one axis does not determine where its camera is: "
            "calibration needs a second one."
        )
    if len(eyes) == 2 and eyes["left"] == eyes["right"]:
        found.append("Both eyes have the same joints: they do not converge.")
    return found
