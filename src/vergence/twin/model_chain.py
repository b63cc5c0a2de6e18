"""Read chains of hinges from a compiled model.

A chain is what lies between a base body and another one. Its axes and points are given in the base,
with every joint at angle zero, as `geometry.joints` has them.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.se3 import inverse, pose, transform

DIGITS = 12
"""Decimals of what is read from a model [m, 1]: sums in the world are rounded to them."""


@dataclass(frozen=True, eq=False)
class ModelChain:
    """Hinges between a base body and another one."""

    joints: tuple[str, ...]
    """From the base outwards."""
    axes: Array
    """(n, 3) unit vectors in the base."""
    points_m: Array
    """(n, 3) a point on each axis, in the base."""
    T_base_end: Array
    """(4, 4) pose of the other body."""


def ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    """List a body (id) and all bodies before it, from the world outwards."""
    path = [body]
    while path[-1]:
        path.append(int(model.body_parentid[path[-1]]))
    return path[::-1]


def joints_to(model: mujoco.MjModel, body: str) -> list[str]:
    """List the joints that move a body, from the world outwards."""
    first, count = model.body_jntadr, model.body_jntnum
    path = ancestors(model, model.body(body).id)
    return [model.joint(j).name for b in path for j in range(first[b], first[b] + count[b])]


def is_hinge(model: mujoco.MjModel, joint: str) -> bool:
    """Check whether a joint is a hinge."""
    return int(model.joint(joint).type[0]) == int(mujoco.mjtJoint.mjJNT_HINGE)


def resting(model: mujoco.MjModel) -> Array:
    """Look up where joints are that stand still: the keyframe "home", or else the model's own."""
    home = "home" in [model.key(k).name for k in range(model.nkey)]
    return model.key("home").qpos if home else model.qpos0


def at_rest(model: mujoco.MjModel, moving: Iterable[str]) -> mujoco.MjData:
    """Place all bodies with joints that move at zero, and others as `resting` has them."""
    data = mujoco.MjData(model)
    data.qpos[:] = resting(model)
    for joint in moving:
        data.joint(joint).qpos[0] = 0.0
    mujoco.mj_kinematics(model, data)
    return data


def body_pose(data: mujoco.MjData, name: str) -> Array:
    """Compute the pose (4, 4) of a body in the world."""
    body = data.body(name)
    return pose(body.xmat.reshape(3, 3), body.xpos)


def model_chain(model: mujoco.MjModel, base: str, end: str, moving: Iterable[str]) -> ModelChain:
    """Read the chain of hinges from a base body to another one.

    `moving` names the joints that move; others stand still, as `at_rest` has them. VergenceError if
    a joint that moves is not a hinge.
    """
    before, moving = joints_to(model, base), set(moving)
    joints = [joint for joint in joints_to(model, end) if joint in moving and joint not in before]
    for joint in joints:
        if not is_hinge(model, joint):
            raise VergenceError(f"The joint {joint} of a head is a hinge; it is of another kind.")
    data, digits = at_rest(model, moving), 17 if base == "world" else DIGITS
    T = inverse(body_pose(data, base))
    axes = [T[:3, :3] @ data.joint(joint).xaxis for joint in joints]
    points = [transform(T, data.joint(joint).xanchor) for joint in joints]
    T_base_end = T @ body_pose(data, end)
    T_base_end[:3, 3] = np.round(T_base_end[:3, 3], digits) + 0.0
    rounded = np.round(np.reshape(points, (-1, 3)), digits) + 0.0
    return ModelChain(tuple(joints), np.reshape(axes, (-1, 3)), rounded, T_base_end)
