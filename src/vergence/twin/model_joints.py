"""Read joints from a compiled model: chains of hinges, and the readings that move coupled ones."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.se3 import inverse, pose, transform

DIGITS = 12
"""Decimals of what is read from a model [m, 1]: sums in the world are rounded to them."""


@dataclass(frozen=True, eq=False)
class ModelChain:
    """Hinges between a base body and another one, with every joint at angle zero."""

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


def at_rest(model: mujoco.MjModel, moving: Iterable[str]) -> mujoco.MjData:
    """Place all bodies with joints that move at zero, and others at the keyframe "home", if any."""
    data = mujoco.MjData(model)
    home = "home" in [model.key(k).name for k in range(model.nkey)]
    data.qpos[:] = model.key("home").qpos if home else model.qpos0
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

    Joints that are not in `moving` stand still. VergenceError if one that moves is not a hinge.
    """
    before, moving = joints_to(model, base), set(moving)
    joints = [joint for joint in joints_to(model, end) if joint in moving and joint not in before]
    for joint in joints:
        if not is_hinge(model, joint):
            raise VergenceError(f"The joint {joint} of a head is a hinge; it is of another kind.")
    data = at_rest(model, moving)
    T = inverse(body_pose(data, base))
    axes = [T[:3, :3] @ data.joint(joint).xaxis for joint in joints]
    points = [transform(T, data.joint(joint).xanchor) for joint in joints]
    T_base_end = T @ body_pose(data, end)
    T_base_end[:3, 3] = np.round(T_base_end[:3, 3], DIGITS) + 0.0
    points_m = np.round(np.reshape(points, (-1, 3)), DIGITS) + 0.0
    return ModelChain(tuple(joints), np.reshape(axes, (-1, 3)), points_m, T_base_end)


class Readings(NamedTuple):
    """How r readings move j joints: angles = mixing @ readings + offset."""

    names: tuple[str, ...]
    mixing: Array
    """(j, r)."""
    offset_rad: Array
    """(j,)."""


def model_readings(model: mujoco.MjModel, joints: Sequence[str]) -> Readings:
    """Find the readings that move joints of a model, and their factors.

    Equalities couple joints, as a URDF's mimic joints do. Fixed tendons with an actuator, such as
    version and vergence, are readings; other independent joints are readings of their own name.
    All are linear equations: readings are added until every joint is determined. VergenceError if
    couplings are not linear.
    """
    relations, tendons = list(_equalities(model)), dict(_driven_tendons(model))
    unknown = list(joints)
    for name in unknown:  # which grows by what is coupled to it
        for row in [*(row for row, _ in relations), *tendons.values()]:
            if name in row:
                unknown += [other for other in row if other not in unknown]
    relations = [each for each in relations if set(each[0]) <= set(unknown)]
    followers = {next(iter(row)) for row, _ in relations}
    readings = {name: row for name, row in tendons.items() if set(row) <= set(unknown)}
    candidates = [
        *readings.items(),
        *((name, {name: 1.0}) for name in sorted(unknown, key=lambda name: name in followers)),
    ]
    rows = [row for row, _ in relations] + [row for _, row in candidates]
    dense = np.array([[row.get(name, 0.0) for name in unknown] for row in rows])
    kept: list[int] = []
    for k in range(len(rows)):
        if np.linalg.matrix_rank(dense[[*kept, k]]) > len(kept):
            kept.append(k)
    n = sum(k < len(relations) for k in kept)
    solution = np.linalg.inv(dense[kept])[: len(joints)]
    offset = solution[:, :n] @ np.array([relations[k][1] for k in kept[:n]])
    mixing = np.round(solution[:, n:], DIGITS) + 0.0
    used = [r for r in range(mixing.shape[1]) if mixing[:, r].any()]
    used.sort(key=lambda r: (np.flatnonzero(mixing[:, r])[0], r))
    names = tuple(candidates[kept[n + r] - len(relations)][0] for r in used)
    return Readings(names, mixing[:, used], np.round(offset, DIGITS) + 0.0)


def _equalities(model: mujoco.MjModel) -> Iterator[tuple[dict[str, float], float]]:
    """Yield the equations of coupled joints, the dependent one first."""
    for k in range(model.neq):
        if model.eq_type[k] != int(mujoco.mjtEq.mjEQ_JOINT) or not model.eq_active0[k]:
            continue
        constant, factor, *curved = model.eq_data[k, :5].tolist()
        follower = model.joint(model.eq_obj1id[k])
        if any(curved):
            raise VergenceError(f"The coupling of the joint {follower.name} is not linear.")
        row, constant = {follower.name: 1.0}, constant + model.qpos0[follower.qposadr[0]]
        if model.eq_obj2id[k] >= 0:
            leader = model.joint(model.eq_obj2id[k])
            row[leader.name] = -factor
            constant -= factor * model.qpos0[leader.qposadr[0]]
        yield row, constant


def _driven_tendons(model: mujoco.MjModel) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield the fixed tendons that have an actuator, with the coefficients of their joints."""
    of_joint = int(mujoco.mjtWrap.mjWRAP_JOINT)
    for a in range(model.nu):
        if model.actuator_trntype[a] == int(mujoco.mjtTrn.mjTRN_TENDON):
            tendon = model.actuator_trnid[a, 0]
            wraps = model.tendon_adr[tendon] + np.arange(model.tendon_num[tendon])
            if (model.wrap_type[wraps] == of_joint).all():
                names = [model.joint(joint).name for joint in model.wrap_objid[wraps]]
                row = dict(zip(names, model.wrap_prm[wraps], strict=True))
                yield model.tendon(tendon).name, row
