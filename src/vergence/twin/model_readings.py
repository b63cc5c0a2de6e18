"""Find what the readings of a model's joints are, where joints are coupled.

All couplings are linear equations: a mimic joint, two eyes that share a motor, version and
vergence. Readings are chosen as further equations until every joint is determined.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.twin.model_chain import DIGITS

_Row = dict[str, float]
"""Factors of joints, by name."""


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
    VergenceError if couplings are not linear.
    """
    relations, tendons = list(_equalities(model)), dict(_driven_tendons(model))
    unknown = list(joints)
    for name in unknown:  # which grows by what is coupled to it
        for row in [*(row for row, _ in relations), *tendons.values()]:
            if name in row:
                unknown += [other for other in row if other not in unknown]
    relations = [each for each in relations if set(each[0]) <= set(unknown)]
    followers = {next(iter(row)) for row, _ in relations}
    candidates: list[tuple[str, _Row]] = [
        *((name, row) for name, row in tendons.items() if set(row) <= set(unknown)),
        *((name, {name: 1.0}) for name in sorted(unknown, key=lambda name: name in followers)),
    ]
    rows = [row for row, _ in relations] + [row for _, row in candidates]
    dense = np.array([row.get(name, 0.0) for row in rows for name in unknown])
    dense = dense.reshape(len(rows), len(unknown))
    kept: list[int] = []
    for k in range(len(rows)):
        if np.linalg.matrix_rank(dense[[*kept, k]]) > len(kept):
            kept.append(k)
    n = sum(k < len(relations) for k in kept)
    inverse = np.linalg.inv(dense[kept])[: len(joints)]
    offset = inverse[:, :n] @ np.array([relations[k][1] for k in kept[:n]])
    mixing = np.round(inverse[:, n:], DIGITS) + 0.0
    used = [r for r in range(mixing.shape[1]) if mixing[:, r].any()]
    used.sort(key=lambda r: (np.flatnonzero(mixing[:, r])[0], r))
    names = tuple(candidates[kept[n + r] - len(relations)][0] for r in used)
    return Readings(names, mixing[:, used], np.round(offset, DIGITS) + 0.0)


def _equalities(model: mujoco.MjModel) -> Iterator[tuple[_Row, float]]:
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


def _driven_tendons(model: mujoco.MjModel) -> Iterator[tuple[str, _Row]]:
    """Yield the fixed tendons that have an actuator, with the coefficients of their joints."""
    of_joint = int(mujoco.mjtWrap.mjWRAP_JOINT)
    for a in range(model.nu):
        if model.actuator_trntype[a] == int(mujoco.mjtTrn.mjTRN_TENDON):
            tendon = model.actuator_trnid[a, 0]
            wraps = model.tendon_adr[tendon] + np.arange(model.tendon_num[tendon])
            if (model.wrap_type[wraps] == of_joint).all():
                names = [model.joint(joint).name for joint in model.wrap_objid[wraps]]
                yield (
                    model.tendon(tendon).name,
                    dict(zip(names, model.wrap_prm[wraps], strict=True)),
                )
