"""Show a head that was read from a model: a picture, and postures for a recording."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import mujoco
import numpy as np

from vergence.arrays import Array
from vergence.gaze.foveation import gaze_angles
from vergence.geometry.camera import normalise
from vergence.geometry.head import base_pose
from vergence.geometry.se3 import inverse, transform
from vergence.twin import no_opengl
from vergence.twin.designed_head import DesignedHead, moving_joints
from vergence.twin.head_checks import pose_joints
from vergence.twin.model_chain import body_pose

AMPLITUDE_RAD = 0.3
"""Turn of a joint to either side [rad], within the usual ranges of eyes and necks."""
STEPS = 24
"""Postures in which a joint moves there and back."""
CIRCLE_M = np.array([0.5, 0.12, 0.08])
"""Distance ahead, and half the width and height of the circle that the eyes follow [m]."""
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
    point: Array
    """(3,) [m] what the eyes look at; NaN: nothing."""


def sweep(model: mujoco.MjModel, designed: DesignedHead) -> Iterator[View]:
    """Move each joint in turn, and then let the eyes follow a point."""
    head, n = designed.head, len(designed.neck)
    wave = AMPLITUDE_RAD * np.sin(np.linspace(0, 2 * np.pi, STEPS))
    moves = np.kron(np.eye(n + len(head.kinematics.readings)), wave[:, None])
    turn = np.linspace(0, 2 * np.pi, 2 * STEPS)
    circle = CIRCLE_M * np.stack([np.ones_like(turn), np.sin(turn), np.cos(turn)], axis=-1)
    names = [next(c for c, m in head.cameras.items() if m.eye == eye) for eye in designed.eyes]
    gaze = gaze_angles(head, transform(inverse(base_pose(head, "left")), circle), cameras=names)
    looks = np.hstack([np.zeros((len(turn), n)), gaze])
    points = np.concatenate([np.full((len(moves), 3), np.nan), circle])
    T_head_world = np.eye(4)
    for k, (posture, point) in enumerate(zip([*moves, *looks], points, strict=True)):
        if np.isfinite(posture).all():  # or the eyes cannot look there
            neck, readings = posture[:n], posture[n:]
            data = pose_joints(model, designed, readings, neck)
            if not k:
                T_head_world = inverse(body_pose(data, designed.base) @ designed.T_base_head)
            names = [model.body(b).name for b in range(1, model.nbody)]
            bodies = {body: T_head_world @ body_pose(data, body) for body in names}
            axes = transform(T_head_world, _axes(data, designed))
            yield View(readings, neck, bodies, axes, point)


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
