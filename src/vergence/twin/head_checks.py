"""Check a head that was read from a model, and show it: a picture, and postures for a recording."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import mujoco
import numpy as np

from vergence.arrays import Array
from vergence.errors import listed
from vergence.geometry.head import base_pose, camera_pose_in_base
from vergence.geometry.kinematics import eye_joint_angles
from vergence.geometry.neck import head_pose
from vergence.geometry.se3 import inverse, transform
from vergence.twin import no_opengl
from vergence.twin.designed_head import moving_joints
from vergence.twin.head_model import HeadModel
from vergence.twin.model_joints import at_rest, body_pose

WAVE_RAD = 0.3 * np.sin(np.linspace(0, 2 * np.pi, 24))
"""Angles of a joint there and back, within the usual ranges of eyes and necks."""
AXIS_M = 0.06
"""Drawn length of a joint's axis, and twice the depth of a camera."""
SIZE_PX = 960, 720
"""Width and height of the picture."""


def pose_joints(of: HeadModel, readings: Array, neck: Array) -> mujoco.MjData:
    """Place all bodies at readings (r,) and angles (n,) of the neck [rad]."""
    designed, data = of.designed, at_rest(of.model, ())
    for joint, angle in zip(designed.neck, neck, strict=True):
        data.joint(joint).qpos[0] = angle
    for eye, joints in designed.eyes.items():
        angles = eye_joint_angles(designed.head.kinematics, eye, readings)
        for joint, angle in zip(joints, angles, strict=True):
            data.joint(joint).qpos[0] = angle
    mujoco.mj_kinematics(of.model, data)
    return data


def disagreement(of: HeadModel) -> float:
    """Find the largest error of a camera's pose [m, 1] at 20 random postures within 1 rad."""
    designed, head, differences = of.designed, of.designed.head, []
    r, n = len(head.kinematics.readings), len(designed.neck)
    T_head_world = _straight(of)
    T_body_world = head_pose(head.neck, np.zeros(n)) @ T_head_world
    rng = np.random.default_rng(0)
    for _ in range(20):
        readings, neck = rng.uniform(-1, 1, r), rng.uniform(-1, 1, n)
        data = pose_joints(of, readings, neck)
        for name, mounted in head.cameras.items():
            T_world_cam = body_pose(data, designed.cameras[name]) @ designed.T_body_cam[name]
            T_head_cam = base_pose(head, mounted.eye) @ camera_pose_in_base(head, name, readings)
            differences.append(T_body_world @ T_world_cam - head_pose(head.neck, neck) @ T_head_cam)
    return float(np.abs(differences).max())


def _straight(of: HeadModel) -> Array:
    """Compute the pose (4, 4) of the world in frame head with a straight neck."""
    data = at_rest(of.model, moving_joints(of.designed))
    return inverse(body_pose(data, of.designed.base) @ of.designed.T_base_head)


def doubts(of: HeadModel) -> list[str]:
    """Say what the user should check of a head."""
    found, links = [], [name for name, camera in of.stated.cameras.items() if camera.body]
    if links:
        found.append(
            f"Links are taken for cameras: {listed(links)}. Check where they look (pos_m, forward, "
            "up), and state their lenses (fov_deg or camera_info)."
        )
    if min(map(len, of.designed.eyes.values())) < 2:
        found.append("An eye with one joint can look, but its calibration needs a second axis.")
    return found


class View(NamedTuple):
    """A posture of a head; the world is frame head with a straight neck."""

    posture: Array
    """(j,) angles of the neck's joints and readings of the eyes [rad]."""
    bodies: dict[str, Array]
    """Poses (4, 4) by body."""
    axes: dict[str, Array]
    """Ends (2, 3) [m] of the axis by joint."""


def sweep(of: HeadModel) -> Iterator[View]:
    """Move each joint of the neck and each reading of the eyes in turn, within its limits."""
    n, T_head_world = len(of.designed.neck), _straight(of)
    names = [of.model.body(b).name for b in range(1, of.model.nbody)]
    half, each = AXIS_M / 2 * np.array([[-1.0], [1.0]]), np.eye(len(of.limits.joints))
    for posture in np.clip(np.kron(each, WAVE_RAD[:, None]), *of.limits.setpoint_range_rad.T):
        data = pose_joints(of, posture[n:], posture[:n])
        bodies = {name: T_head_world @ body_pose(data, name) for name in names}
        joints = [data.joint(name) for name in moving_joints(of.designed)]
        axes = {j.name: transform(T_head_world, j.xanchor + half * j.xaxis) for j in joints}
        yield View(posture, bodies, axes)


def picture(of: HeadModel) -> np.ndarray:
    """Render the head (H, W, 3), RGB, with axes and views; VergenceError without OpenGL."""
    model, data = of.model, at_rest(of.model, moving_joints(of.designed))
    view, option, shown = mujoco.MjvCamera(), mujoco.MjvOption(), mujoco.mjtVisFlag
    mujoco.mj_forward(model, data)
    T = body_pose(data, of.designed.base) @ of.designed.T_base_head
    x, y, z = T[:3, :3] @ [-1.0, -0.7, -0.4]
    view.lookat, view.distance, view.azimuth = T[:3, 3], 0.7, np.degrees(np.arctan2(y, x))
    view.elevation = np.degrees(np.arctan2(z, np.hypot(x, y)))
    for flag in (shown.mjVIS_JOINT, shown.mjVIS_CAMERA, shown.mjVIS_TRANSPARENT):
        option.flags[flag] = True
    model.vis.global_.offwidth, model.vis.global_.offheight = SIZE_PX
    model.vis.headlight.ambient, model.vis.headlight.diffuse = [0.5] * 3, [0.5] * 3
    model.vis.map.znear, model.stat.meansize = 0.02 / model.stat.extent, AXIS_M / 2
    model.vis.scale.frustum, model.vis.scale.jointlength = 3.0, 3.0  # times that
    model.vis.scale.jointwidth = 0.1
    try:
        renderer = mujoco.Renderer(model, *SIZE_PX[::-1])
    except Exception as error:  # each backend raises its own kind
        raise no_opengl(error) from error
    with renderer:
        renderer.update_scene(data, view, option)
        return renderer.render()
