"""Move each joint of a head in turn, and then let its eyes follow a point, for a recording."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from vergence.arrays import Array
from vergence.gaze.foveation import gaze_angles
from vergence.geometry.head import base_pose
from vergence.geometry.se3 import inverse, transform
from vergence.twin.designed_head import DesignedHead
from vergence.twin.head_checks import body_in_world, pose_joints
from vergence.twin.model_chain import ancestors

AMPLITUDE_RAD = 0.3
"""Turn of a joint to either side [rad], within the usual ranges of eyes and necks."""
STEPS = 24
"""Postures in which a joint moves there and back."""
CIRCLE_M = np.array([0.5, 0.12, 0.08])
"""Distance ahead, and half the width and height of the circle that the eyes follow [m]."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """N postures of a head."""

    readings: Array
    """(N, r) [rad]."""
    neck: Array
    """(N, n) [rad]."""
    bodies: dict[str, Array]
    """(N, 4, 4) by body its pose in frame head, as that stands with a straight neck; of the body
    that carries neck and eyes, and those beyond."""
    points: Array
    """(N, 3) [m] what the eyes look at, in that frame; NaN: nothing."""


def sweep(model: mujoco.MjModel, designed: DesignedHead) -> Sweep:
    """Make postures that show how a head moves."""
    head, n = designed.head, len(designed.neck)
    wave = AMPLITUDE_RAD * np.sin(np.linspace(0, 2 * np.pi, STEPS))
    each = np.concatenate(
        [np.outer(wave, axis) for axis in np.eye(n + len(head.kinematics.readings))]
    )
    turn = np.linspace(0, 2 * np.pi, 2 * STEPS)
    circle = CIRCLE_M * np.stack([np.ones_like(turn), np.sin(turn), np.cos(turn)], axis=-1)
    T_lbase_head = inverse(base_pose(head, "left"))
    names = [next(c for c, m in head.cameras.items() if m.eye == eye) for eye in designed.eyes]
    gaze = gaze_angles(head, transform(T_lbase_head, circle), cameras=names)
    seen = np.isfinite(gaze).all(axis=-1)
    following = np.hstack([np.zeros((len(turn), n)), gaze])[seen]
    neck, readings = np.split(np.concatenate([each, following]), [n], axis=1)
    carried = model.body(
        model.joint((designed.neck or next(iter(designed.eyes.values())))[0]).bodyid[0]
    )
    root = int(carried.parentid[0])
    beyond = [b for b in range(1, model.nbody) if root in ancestors(model, b)]
    poses: dict[str, list[Array]] = {model.body(b).name: [] for b in beyond}
    straight = pose_joints(model, designed, 0 * readings[0], 0 * neck[0])
    T_head_world = inverse(body_in_world(straight, designed.base) @ designed.T_base_head)
    for row in range(len(neck)):
        data = pose_joints(model, designed, readings[row], neck[row])
        for body, found in poses.items():
            found.append(T_head_world @ body_in_world(data, body))
    points = np.concatenate([np.full((len(each), 3), np.nan), circle[seen]])
    return Sweep(readings, neck, {body: np.array(found) for body, found in poses.items()}, points)
