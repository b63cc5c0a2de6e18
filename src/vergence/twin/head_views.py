"""Show a head that was read from a model: a picture, and postures for a recording."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import mujoco
import numpy as np

from vergence.arrays import Array
from vergence.geometry.camera import normalise
from vergence.geometry.se3 import inverse, transform
from vergence.twin import no_opengl
from vergence.twin.designed_head import DesignedHead, moving_joints
from vergence.twin.head_checks import pose_joints
from vergence.twin.model_chain import body_pose

WAVE_RAD = 0.3 * np.sin(np.linspace(0, 2 * np.pi, 24))
"""Angles of a joint there and back, within the usual ranges of eyes and necks."""
AXIS_M, VIEW_M = 0.06, 0.1
"""Drawn length of a joint's axis, and depth of a camera's view [m]."""
SIZE_PX = 960, 720
"""Width and height of the picture."""


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
    head, T = designed.head, designed.T_base_head
    zero = np.zeros(len(head.kinematics.readings)), np.zeros(len(designed.neck))
    data = pose_joints(model, designed, *zero)
    mujoco.mj_forward(model, data)
    lines = [(0.0015, (0.1, 0.4, 0.9, 1.0), ends) for ends in _axes(data, designed)]
    for name, mounted in head.cameras.items():
        camera = mounted.intrinsics
        corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * (np.array(camera.size) - 1.0)
        rays = VIEW_M * np.column_stack([normalise(camera, corners), np.ones(4)])
        T_world_cam = body_pose(data, designed.cameras[name]) @ designed.T_body_cam[name]
        tips, colour = transform(T_world_cam, rays), (0.9, 0.5, 0.1, 1.0)
        for k in range(4):
            lines.append((0.0005, colour, np.array([T_world_cam[:3, 3], tips[k]])))
            lines.append((0.0005, colour, np.array([tips[k - 1], tips[k]])))
    T = body_pose(data, designed.base) @ T
    view, behind = mujoco.MjvCamera(), T[:3, :3] @ [-1.0, -0.7, -0.4]
    view.lookat, view.distance = T[:3, 3], 0.7
    view.azimuth = np.degrees(np.arctan2(behind[1], behind[0]))
    view.elevation = np.degrees(np.arctan2(behind[2], np.hypot(*behind[:2])))
    model.vis.global_.offwidth, model.vis.global_.offheight = SIZE_PX
    model.vis.map.znear = 0.02 / model.stat.extent
    model.vis.headlight.ambient, model.vis.headlight.diffuse = [0.5] * 3, [0.5] * 3
    try:
        renderer = mujoco.Renderer(model, *SIZE_PX[::-1])
    except Exception as error:  # each backend raises its own kind
        raise no_opengl(error) from error
    with renderer:
        renderer.update_scene(data, view)
        for width_m, colour, (start, end) in lines:
            geom = renderer.scene.geoms[renderer.scene.ngeom]
            capsule = int(mujoco.mjtGeom.mjGEOM_CAPSULE)
            mujoco.mjv_initGeom(geom, capsule, np.zeros(3), np.zeros(3), np.zeros(9), colour)
            mujoco.mjv_connector(geom, capsule, width_m, start, end)
            renderer.scene.ngeom += 1
        return renderer.render()
