"""Read chains of hinges from a compiled model.

A chain is what lies between a base body and a camera. Its axes and points are given in the base,
with every joint at angle zero, as `geometry.joints` has them.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.se3 import pose, rotation

_FREE, _BALL, _SLIDE, _HINGE = range(4)
"""MuJoCo's types of joints."""


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


def bodies_between(model: mujoco.MjModel, base: int, end: int) -> list[int]:
    """List the bodies (ids) beyond a base, as far as another body; VergenceError if it is not."""
    path, body = [], end
    while body != base:
        if body == 0:
            raise VergenceError(
                f"The body {model.body(end).name} does not lie beyond {model.body(base).name}."
            )
        path.append(body)
        body = int(model.body_parentid[body])
    return path[::-1]


def ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    """List a body (id) and all bodies before it, from the world outwards."""
    return [0, *bodies_between(model, 0, body)]


def joints_of(model: mujoco.MjModel, bodies: Sequence[int]) -> list[int]:
    """List the joints (ids) of bodies, in their order."""
    return [
        joint
        for body in bodies
        for joint in range(
            model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]
        )
    ]


def resting(model: mujoco.MjModel) -> Array:
    """Look up where joints are that stand still: the keyframe "home", or else the model's own."""
    keys = [k for k in range(model.nkey) if model.key(k).name == "home"]
    return model.key_qpos[keys[0]] if keys else model.qpos0


def model_chain(model: mujoco.MjModel, base: str, end: str, moving: Sequence[str]) -> ModelChain:
    """Read the chain of hinges from a base body to another one.

    `moving` names the joints that move; others stand still, as `resting` has them. VergenceError if
    a joint that moves is not a hinge, or `end` does not lie beyond the base.
    """
    bodies = bodies_between(model, model.body(base).id, model.body(end).id)
    rest, names, axes, points = resting(model), [], [], []
    T = np.eye(4)
    for body in bodies:
        T = T @ pose(_matrix(model.body_quat[body]), model.body_pos[body])
        for joint in joints_of(model, [body]):
            kind, name = model.jnt_type[joint], model.joint(joint).name
            first = model.jnt_qposadr[joint]
            angle = 0.0
            if name in moving:
                if kind != _HINGE:
                    raise VergenceError(
                        f"The joint {name} between {base} and {end} is a "
                        f"{('free', 'ball', 'slide')[kind]} joint; a head is described by hinges. "
                        "Let it stand still (leave it out of eyes and neck), or replace it by "
                        "hinges."
                    )
                names.append(name)
                axes.append(T[:3, :3] @ model.jnt_axis[joint])
                points.append(T[:3, :3] @ model.jnt_pos[joint] + T[:3, 3])
            elif kind == _SLIDE:
                T = T @ pose(t=(rest[first] - model.qpos0[first]) * model.jnt_axis[joint])
                continue
            elif kind == _BALL:
                T = _turned(T, _matrix(rest[first : first + 4]), model.jnt_pos[joint])
                continue
            elif kind == _HINGE:
                angle = rest[first]
            else:
                continue  # the pose of a floating base is that of its body
            if (turn := angle - model.qpos0[first]) != 0:
                T = _turned(T, rotation(turn * model.jnt_axis[joint]), model.jnt_pos[joint])
    shape = len(names), 3
    return ModelChain(tuple(names), np.reshape(axes, shape), np.reshape(points, shape), T)


def _matrix(quaternion: Array) -> Array:
    return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()


def _turned(T: Array, R: Array, point: Array) -> Array:
    """Turn a body at pose T (4, 4) by R (3, 3) about a point of it."""
    return T @ pose(R, point - R @ point)


def check_open(model: mujoco.MjModel, bodies: Sequence[int]) -> None:
    """Raise VergenceError if two bodies that move are connected to others."""
    moved = {body for body in bodies if model.body_jntnum[body]}
    of_sites = int(mujoco.mjtObj.mjOBJ_SITE)
    for k in range(model.neq):
        if model.eq_type[k] > int(mujoco.mjtEq.mjEQ_WELD) or not model.eq_active0[k]:
            continue
        ends = [int(model.eq_obj1id[k]), int(model.eq_obj2id[k])]
        if model.eq_objtype[k] == of_sites:
            ends = [int(model.site_bodyid[end]) for end in ends]
        if touched := moved & set(ends):
            raise VergenceError(
                f"The body {model.body(min(touched)).name} is part of a closed loop (an equality "
                "connects it to another body), and no chain of joints describes its motion."
            )
