"""Find what the readings of a model's joints are, where joints are coupled.

All couplings are linear equations: a mimic joint, two eyes that share a motor, version and
vergence. Readings are chosen as further equations until every joint is determined.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError

_Row = Mapping[str | tuple[str], float]
"""Factors of joints, by name, and of readings, by a tuple of the name alone."""
INDEPENDENT = 1e-9
"""Length of what a row has beyond those before it, from which it is independent of them."""
DIGITS = 12
"""Decimals of factors and offsets, which solving equations leaves."""


class Readings(NamedTuple):
    """How r readings move j joints: angles = mixing @ readings + offset."""

    names: tuple[str, ...]
    mixing: Array
    """(j, r)."""
    offset_rad: Array
    """(j,)."""


def model_readings(
    model: mujoco.MjModel,
    joints: Sequence[str],
    stated: Mapping[str, Mapping[str, float]] | None = None,
) -> Readings:
    """Find the readings that move joints of a model, and their factors.

    Equalities of joints (a URDF's mimic joints) and of fixed tendons couple joints. Fixed tendons
    with an actuator, such as version and vergence, are readings; other independent joints are
    readings of their own name. `stated` gives, by joint, the factors of readings that only
    head.toml knows. VergenceError if couplings are not linear, or contradict one another.
    """
    stated = stated or {}
    relations: list[tuple[_Row, float]] = [
        ({joint: 1.0} | {(name,): -factor for name, factor in factors.items()}, 0.0)
        for joint, factors in stated.items()
    ]
    relations += [each for each in _equalities(model) if next(iter(each[0])) not in stated]
    tendons = {model.tendon(t).name: _tendon(model, t) for t in _driven(model, "TENDON")}
    unknown: list[str | tuple[str]] = list(joints)
    for name in unknown:  # which grows by what is coupled to it
        for row in [*(row for row, _ in relations), *tendons.values()]:
            if name in row:
                unknown += [other for other in row if other not in unknown]
    relations = [each for each in relations if set(each[0]) <= set(unknown)]
    if any(np.isnan(constant) for _, constant in relations):
        raise VergenceError(
            f"An equality couples {' or '.join(joints)} by a polynomial that is not linear; a head "
            "is described by linear couplings."
        )
    followers = {next(iter(row)) for row, _ in relations}
    driven = {model.joint(j).name for j in _driven(model, "JOINT")}
    candidates: list[tuple[str, _Row]] = [
        *((name[0], {name: 1.0}) for name in unknown if isinstance(name, tuple)),
        *((name, row) for name, row in tendons.items() if set(row) <= set(unknown)),
        *(
            (name, {name: 1.0})
            for name in sorted(
                (name for name in unknown if isinstance(name, str)),
                key=lambda name: (name in followers, name not in driven),
            )
        ),
    ]
    rows = [row for row, _ in relations] + [row for _, row in candidates]
    dense = np.array([[row.get(name, 0.0) for name in unknown] for row in rows])
    kept = _independent(dense)
    fixed, chosen = (
        [k for k in kept if k < len(relations)],
        [k for k in kept if k >= len(relations)],
    )
    inverse, constants = np.linalg.inv(dense[kept]), np.array([c for _, c in relations])
    offset = inverse[:, : len(fixed)] @ constants[fixed] if fixed else np.zeros(len(unknown))
    if not np.allclose(dense[: len(relations)] @ offset, constants, atol=1e-9):
        raise VergenceError(f"The equalities that couple {', '.join(joints)} contradict.")
    mixing = np.round(inverse[: len(joints), len(fixed) :], DIGITS) + 0.0
    used = [r for r in range(len(chosen)) if mixing[:, r].any()]
    used.sort(key=lambda r: (np.flatnonzero(mixing[:, r])[0], r))
    names = tuple(candidates[chosen[r] - len(relations)][0] for r in used)
    return Readings(names, mixing[:, used], np.round(offset[: len(joints)], DIGITS) + 0.0)


def _independent(rows: Array) -> list[int]:
    """Select the rows that are not combinations of rows before them."""
    basis, kept = np.empty((0, rows.shape[1])), []
    for k, row in enumerate(rows):
        beyond = row - row @ basis.T @ basis
        if (length := np.linalg.norm(beyond)) > INDEPENDENT:
            basis = np.vstack([basis, beyond / length])
            kept.append(k)
    return kept


def _equalities(model: mujoco.MjModel) -> Iterator[tuple[_Row, float]]:
    """Yield the equations of joints, the dependent one first; constant NaN: not linear."""
    of_joints, of_tendons = int(mujoco.mjtEq.mjEQ_JOINT), int(mujoco.mjtEq.mjEQ_TENDON)
    for k in range(model.neq):
        if model.eq_type[k] not in (of_joints, of_tendons) or not model.eq_active0[k]:
            continue
        constant, factor, *curved = model.eq_data[k, :5].tolist()
        row: dict[str | tuple[str], float] = {}
        for sign, part in ((1.0, model.eq_obj1id[k]), (-factor, model.eq_obj2id[k])):
            if part < 0:
                continue
            if model.eq_type[k] == of_joints:
                terms = {model.joint(part).name: 1.0}
                constant += sign * model.qpos0[model.jnt_qposadr[part]]
            else:
                terms = _tendon(model, part)
                constant += sign * model.tendon_length0[part]
            for name, coefficient in terms.items():
                row[name] = row.get(name, 0.0) + sign * coefficient
        if row:
            yield row, np.nan if any(curved) else constant


def _tendon(model: mujoco.MjModel, tendon: int) -> _Row:
    """Look up the coefficients of a fixed tendon's joints; those of a spatial one are not there."""
    first = model.tendon_adr[tendon]
    wraps = range(first, first + model.tendon_num[tendon])
    return {
        model.joint(model.wrap_objid[w]).name: float(model.wrap_prm[w])
        for w in wraps
        if model.wrap_type[w] == mujoco.mjtWrap.mjWRAP_JOINT
    }


def _driven(model: mujoco.MjModel, kind: str) -> list[int]:
    """List the joints or the tendons (ids) that have an actuator."""
    wanted = getattr(mujoco.mjtTrn, f"mjTRN_{kind}")
    return [
        int(model.actuator_trnid[a, 0])
        for a in range(model.nu)
        if model.actuator_trntype[a] == wanted
    ]
