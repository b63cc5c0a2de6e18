"""A head of the twin: its model, the head as designed, and the limits of its joints."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.gaze.commands import (
    USUAL_RANGE_RAD,
    USUAL_SPEED_RAD_S,
    JointLimits,
    posture_joints,
)
from vergence.geometry.head import HeadCalibration
from vergence.twin.designed_head import DesignedHead, designed_head, reading_name
from vergence.twin.head_file import HeadFile, JointFile, load_head_file
from vergence.twin.head_guess import completed
from vergence.twin.head_lens import chosen_lens, lens_of
from vergence.twin.model_file import load_model


@dataclass(frozen=True, eq=False)
class HeadModel:
    """A head as designed, in the model that it was read from."""

    spec: mujoco.MjSpec
    """The model, with the joints that head.toml adds."""
    model: mujoco.MjModel
    """Compiled from it."""
    stated: HeadFile
    """The description, completed from the model."""
    designed: DesignedHead
    limits: JointLimits
    """Ranges and speeds of the joints of a posture."""
    lens: str
    """Name of the lens that was chosen; empty: there is no choice."""


def load_head_model(path: Path | None = None, lens: str | None = None) -> HeadModel:
    """Read a head.toml and its model; None: the default head, and the first of its lenses.

    VergenceError if a file is missing or invalid, or makes no head that can be described.
    """
    stated, model_path = load_head_file(path)
    folder = model_path.parent if path is None else path.parent
    spec = load_model(model_path)
    add_joints(spec, stated)
    model = spec.compile()
    try:
        stated = completed(stated, model)
    except KeyError as error:  # MuJoCo lists the names that there are
        raise VergenceError(f"{model_path}: {str(error.args[0])[:300]}") from None
    lens = chosen_lens(stated, lens)
    lenses = {name: lens_of(stated, folder, name, model, lens) for name in stated.cameras}
    designed = designed_head(model, stated, lenses)
    limits = head_limits(model, stated, designed)
    return HeadModel(spec, model, stated, designed, limits, lens)


def nominal_head(lens: str | None = None) -> HeadCalibration:
    """Read the default head as designed, with one of its lenses; None: the first."""
    return load_head_model(lens=lens).designed.head


def add_joints(spec: mujoco.MjSpec, stated: HeadFile) -> None:
    """Add the hinges of head.toml that the model does not have; VergenceError: no such body.

    They take the place of a ball joint, as the last one of a leg of a parallel platform.
    """
    for name, joint in stated.joints.items():
        if joint.body is None:
            continue
        body = spec.body(joint.body)
        if body is None or joint.axis is None:
            lacks = "no axis" if body is not None else f"a body {joint.body!r} unknown to the model"
            raise VergenceError(f"The joint {name} that head.toml adds has {lacks}.")
        for ball in [j for j in body.joints if j.type == mujoco.mjtJoint.mjJNT_BALL]:
            spec.delete(ball)  # whose place the hinges take
        place = np.zeros(3) if joint.pos_m is None else joint.pos_m
        body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=joint.axis, pos=place)


def head_limits(model: mujoco.MjModel, stated: HeadFile, designed: DesignedHead) -> JointLimits:
    """Determine the limits of the neck's joints and of the readings.

    A joint of several readings divides its range and speed equally among them, so that no
    combination of their values leaves it; the range of a tendon is that of its reading.
    """
    head, eyes = designed.head, designed.eyes
    ranges = [_joint_range(model, stated, name) for name in designed.neck]
    speeds = [_speed(stated.joints.get(name), "neck") for name in designed.neck]
    for r, name in enumerate(head.kinematics.readings):
        own, speed = [np.array([-np.inf, np.inf])], np.inf
        for eye, joints in eyes.items():
            chain = head.kinematics.chains[eye]
            for k, joint in enumerate(joints):
                if factor := chain.mixing[k, r]:
                    share = factor * np.count_nonzero(chain.mixing[k])
                    by_joint = _joint_range(model, stated, joint) - chain.offset_rad[k]
                    own.append(np.sort(by_joint / share))
                    speed = min(speed, _speed(stated.joints.get(joint), "eyes") / abs(share))
        lower, upper = np.max(own, axis=0)[0], np.min(own, axis=0)[1]
        tendon = _tendon_range(model, name)
        lower, upper = (lower, upper) if tendon is None else tendon
        ranges.append(np.array([lower, max(lower, upper)]))
        speeds.append(speed)
    return JointLimits(np.reshape(ranges, (-1, 2)), np.array(speeds), posture_joints(head))


def _joint_range(model: mujoco.MjModel, stated: HeadFile, name: str) -> Array:
    """Look up the range (2,) [rad] of a joint."""
    given, joint = stated.joints.get(name), model.joint(name).id
    if given is not None and given.range_deg is not None:
        return np.radians(given.range_deg)
    if model.jnt_limited[joint]:
        return model.jnt_range[joint].copy()
    return np.array([-USUAL_RANGE_RAD, USUAL_RANGE_RAD])


def _speed(given: JointFile | None, part: str) -> float:
    """Look up the maximum speed [rad/s] of a joint: models state none."""
    if given is None or given.speed_deg_s is None:
        return USUAL_SPEED_RAD_S[part]
    return float(np.radians(given.speed_deg_s))


def _tendon_range(model: mujoco.MjModel, reading: str) -> Array | None:
    """Look up the range (2,) [rad] of a reading that is a tendon's length; None: it has none."""
    for k in range(model.ntendon):
        if reading_name(model.tendon(k).name) == reading and model.tendon_limited[k]:
            return model.tendon_range[k].copy()
    return None
