"""Check a head that was read from a model, and show it: a picture, and postures for a recording."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import mujoco
import numpy as np

from vergence.arrays import Array
from vergence.errors import listed
from vergence.geometry.camera import normalise
from vergence.geometry.head import base_pose, camera_pose_in_base
from vergence.geometry.kinematics import eye_joint_angles
from vergence.geometry.neck import head_pose
from vergence.geometry.se3 import inverse, transform
from vergence.twin import no_opengl
from vergence.twin.designed_head import DesignedHead, moving_joints
from vergence.twin.head_file import HeadFile
from vergence.twin.model_chain import at_rest, body_pose

WAVE_RAD = 0.3 * np.sin(np.linspace(0, 2 * np.pi, 24))
"""Angles of a joint there and back, within the usual ranges of eyes and necks."""
AXIS_M, VIEW_M = 0.06, 0.1
"""Drawn length of a joint's axis, and depth of a camera's view [m]."""
SIZE_PX = 960, 720
"""Width and height of the picture."""
BLUE, ORANGE = (0.1, 0.4, 0.9, 1.0), (0.9, 0.5, 0.1, 1.0)
"""Colours of axes and views."""
CAPSULE = int(mujoco.mjtGeom.mjGEOM_CAPSULE)
"""Shape of the lines."""


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

    Returns the largest difference of an element of a camera's pose in frame body. Readings and
    angles are within 1 rad.
    """
    head, rng, differences = designed.head, np.random.default_rng(0), []
    r, n = len(head.kinematics.readings), len(designed.neck)
    straight = body_pose(pose_joints(model, designed, np.zeros(r), np.zeros(n)), designed.base)
    T_body_world = head_pose(head.neck, np.zeros(n)) @ inverse(straight @ designed.T_base_head)
    for _ in range(20):
        readings, neck = rng.uniform(-1, 1, r), rng.uniform(-1, 1, n)
        data = pose_joints(model, designed, readings, neck)
        for name, mounted in head.cameras.items():
            T_world_cam = body_pose(data, designed.cameras[name]) @ designed.T_body_cam[name]
            T_head_cam = base_pose(head, mounted.eye) @ camera_pose_in_base(head, name, readings)
            differences.append(T_body_world @ T_world_cam - head_pose(head.neck, neck) @ T_head_cam)
    return float(np.abs(differences).max())


def doubts(stated: HeadFile, designed: DesignedHead) -> list[str]:
    """Say what the user should check of a head whose complete description is `stated`."""
    found, links = [], [name for name, camera in stated.cameras.items() if camera.body is not None]
    if links:
        found.append(
            f"Links are taken for cameras: {listed(links)}. Check where they look (pos_m, forward, "
            "up), and state their lenses (fov_deg or camera_info)."
        )
    if min(map(len, designed.eyes.values())) < 2:
        found.append("An eye with one joint can look, but its calibration needs a second axis.")
    return found


class View(NamedTuple):
    """A posture of a head; the world is frame head with a straight neck."""

    readings: Array
    """(r,) [rad]."""
    neck: Array
    """(n,) [rad]."""
    bodies: dict[str, Array]
    """(4, 4) by body its pose."""
    axes: Array
    """(k, 2, 3) [m] both ends of the axes of the neck's joints, then of the eyes'."""


def sweep(model: mujoco.MjModel, designed: DesignedHead) -> Iterator[View]:
    """Move each joint of the neck and each reading of the eyes in turn."""
    n, r = len(designed.neck), len(designed.head.kinematics.readings)
    straight = pose_joints(model, designed, np.zeros(r), np.zeros(n))
    T_head_world = inverse(body_pose(straight, designed.base) @ designed.T_base_head)
    names = [model.body(b).name for b in range(1, model.nbody)]
    for posture in np.kron(np.eye(n + r), WAVE_RAD[:, None]):
        data = pose_joints(model, designed, posture[n:], posture[:n])
        bodies = {name: T_head_world @ body_pose(data, name) for name in names}
        axes = transform(T_head_world, _axes(data, designed))
        yield View(posture[n:], posture[:n], bodies, axes)


def _axes(data: mujoco.MjData, designed: DesignedHead) -> Array:
    """Compute both ends (k, 2, 3) of the drawn axes of neck and eyes, in the world."""
    joints = [data.joint(name) for name in moving_joints(designed)]
    half = AXIS_M / 2 * np.array([[-1.0], [1.0]])
    return np.array([joint.xanchor + half * joint.xaxis for joint in joints])


def picture(model: mujoco.MjModel, designed: DesignedHead) -> np.ndarray:
    """Render the head (H, W, 3), RGB, with axes and views; VergenceError without OpenGL."""
    head, n = designed.head, len(designed.neck)
    data = pose_joints(model, designed, np.zeros(len(head.kinematics.readings)), np.zeros(n))
    mujoco.mj_forward(model, data)
    lines = [(0.0015, BLUE, ends) for ends in _axes(data, designed)]
    for name, mounted in head.cameras.items():
        T = body_pose(data, designed.cameras[name]) @ designed.T_body_cam[name]
        corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * (
            np.array(mounted.intrinsics.size) - 1.0
        )
        rays = np.column_stack([normalise(mounted.intrinsics, corners), np.ones(4)])
        tips = transform(T, VIEW_M * rays)
        for k in range(4):
            lines.append((0.0005, ORANGE, np.array([T[:3, 3], tips[k]])))
            lines.append((0.0005, ORANGE, np.array([tips[k - 1], tips[k]])))
    T = body_pose(data, designed.base) @ designed.T_base_head
    view, (x, y, z) = mujoco.MjvCamera(), T[:3, :3] @ [-1.0, -0.7, -0.4]
    view.lookat, view.distance = T[:3, 3], 0.7
    view.azimuth = np.degrees(np.arctan2(y, x))
    view.elevation = np.degrees(np.arctan2(z, np.hypot(x, y)))
    model.vis.global_.offwidth, model.vis.global_.offheight = SIZE_PX
    model.vis.headlight.ambient, model.vis.headlight.diffuse = [0.5] * 3, [0.5] * 3
    model.vis.map.znear = 0.02 / model.stat.extent
    try:
        renderer = mujoco.Renderer(model, *SIZE_PX[::-1])
    except Exception as error:  # each backend raises its own kind
        raise no_opengl(error) from error
    with renderer:
        renderer.update_scene(data, view)
        for width_m, colour, (start, end) in lines:
            geom, capsule = (
                renderer.scene.geoms[renderer.scene.ngeom],
                mujoco.mjtGeom.mjGEOM_CAPSULE,
            )
            mujoco.mjv_initGeom(geom, int(capsule), np.zeros(3), np.zeros(3), np.zeros(9), colour)
            mujoco.mjv_connector(geom, int(capsule), width_m, start, end)
            renderer.scene.ngeom += 1
        return renderer.render()
