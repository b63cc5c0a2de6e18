"""Check a head that was read from a model: against MuJoCo, and for what its user should look at."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from vergence.arrays import Array
from vergence.errors import listed
from vergence.findings import Finding, note, warning
from vergence.geometry.head import base_pose, camera_pose_in_base
from vergence.geometry.kinematics import eye_joint_angles
from vergence.geometry.neck import head_pose
from vergence.geometry.se3 import inverse, pose
from vergence.twin.designed_head import DesignedHead
from vergence.twin.head_file import HeadFile
from vergence.twin.head_guess import turns_about_two
from vergence.twin.model_chain import resting


def pose_joints(
    model: mujoco.MjModel, designed: DesignedHead, readings: Array, neck: Array
) -> mujoco.MjData:
    """Place all bodies at readings (r,) and angles (n,) of the neck [rad]."""
    data = mujoco.MjData(model)
    data.qpos[:] = resting(model)
    for eye, joints in designed.eyes.items():
        angles = eye_joint_angles(designed.head.kinematics, eye, readings)
        for joint, angle in zip(joints, angles, strict=True):
            data.joint(joint).qpos[0] = angle
    for joint, angle in zip(designed.neck, neck, strict=True):
        data.joint(joint).qpos[0] = angle
    mujoco.mj_kinematics(model, data)
    return data


def body_in_world(data: mujoco.MjData, name: str) -> Array:
    """Look up the pose (4, 4) of a body in the world."""
    body = data.body(name)
    return pose(body.xmat.reshape(3, 3), body.xpos)


def disagreement(model: mujoco.MjModel, designed: DesignedHead, postures: int = 20) -> float:
    """Compare the head's kinematics with MuJoCo's at random postures of eyes and neck.

    Returns the largest difference of an element of a pose: of a camera in frame head, and of frame
    head in frame body. Readings and angles are within 1 rad.
    """
    head, rng, worst = designed.head, np.random.default_rng(0), 0.0
    straight = np.zeros(len(designed.neck))
    T_world_body = np.eye(4)
    for k in range(postures + 1):
        readings = rng.uniform(-1, 1, len(head.kinematics.readings))
        neck = rng.uniform(-1, 1, len(straight)) if k else straight
        data = pose_joints(model, designed, readings, neck)
        T_world_head = body_in_world(data, designed.base) @ designed.T_base_head
        if not k:
            T_world_body = T_world_head @ inverse(head_pose(head.neck, straight))
        pairs = [(T_world_head, T_world_body @ head_pose(head.neck, neck))]
        for name, mounted in head.cameras.items():
            T_world_cam = body_in_world(data, designed.cameras[name]) @ designed.T_body_cam[name]
            T_head_cam = base_pose(head, mounted.eye) @ camera_pose_in_base(head, name, readings)
            pairs.append((T_world_cam, T_world_head @ T_head_cam))
        worst = max(worst, *(float(np.abs(a - b).max()) for a, b in pairs))
    return worst


def doubts(model: mujoco.MjModel, stated: HeadFile, found: DesignedHead) -> Iterator[Finding]:
    """Yield what the user should check of a head whose complete description is `stated`."""
    links = [name for name, camera in stated.cameras.items() if camera.body is not None]
    if links:
        yield warning(
            "guessed-camera",
            f"Links are taken for cameras: {listed(links)}. Check where they look (pos_m, forward, "
            "up) and state their lenses (fov_deg).",
        )
    small = [
        name
        for name, camera in stated.cameras.items()
        if camera.body is None and camera.size is None
        if model.cam_resolution[model.camera(camera.camera or name).id].max() <= 1
    ]
    if small:
        yield note(
            "guessed-size",
            f"The model states no resolution for {listed(small)}: 640 x 480 pixels are assumed.",
        )
    for eye in found.eyes:
        if not turns_about_two(joint.axis for joint in found.head.kinematics.eyes[eye]):
            yield warning(
                "one-axis",
                f"The {eye} eye turns about one axis: that does not determine where its camera is, "
                "and calibration needs a second one.",
            )
    if len(found.eyes) == 1:
        yield note(
            "one-eye", "The head has one eye: points need a board or an object of known size."
        )
    elif found.eyes["left"] == found.eyes["right"]:
        yield note("fixed-pair", "Both eyes have the same joints: they do not converge.")
    used = {camera.camera or name for name, camera in stated.cameras.items()}
    if others := [n for n in (model.camera(k).name for k in range(model.ncam)) if n not in used]:
        yield note("other-cameras", f"Not a camera of the eyes: {listed(others)}.")
