"""URDF of a calibrated head, for ROS: links, joints, and the cameras' optical frames.

Links: body, (one a neck joint), head, and for each eye left_base, left_pan, left_eye, and for each
camera left_wide (x forward) and left_wide_optical_frame (frame cam: z forward).

Joints have their usual names (left_pan, left_tilt, neck_pitch, ...), and their positions are the
encoders' readings. Where readings need a gain or an offset, the joint of that name turns an empty
link, and <joint>_true mimics it with URDF's multiplier and offset; transforms then agree exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration, T_head_base
from vergence.geometry.kinematics import EYES, NECK_JOINTS, Chain, eye_chain
from vergence.geometry.se3 import inverse, pose
from vergence.interchange.serialization import check_names
from vergence.writing import write_whole

LIMIT_RAD = (-1.5708, 1.5708)
EFFORT, VELOCITY = 100.0, 100.0
"""Limits that URDF requires and a calibration does not hold: large enough to have no effect."""

T_LINK_OPTICAL = pose(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]))
"""From frame cam to a camera's link, which looks along x with z up (REP 103)."""


def save(head: HeadCalibration, path: Path) -> None:
    """Write a head as URDF, without the cameras' intrinsics, for which it has no field.

    VergenceError if there is no camera, or the file cannot be written.
    """
    check_names(head)
    robot = ElementTree.Element("robot", name="vergence_head")
    ElementTree.SubElement(robot, "link", name="body")
    neck = head.neck
    n = len(neck.axes)
    names = NECK_JOINTS if n == len(NECK_JOINTS) else [f"neck_{k + 1}" for k in range(n)]
    links = ["body", *names]
    chain = Chain(neck.axes, neck.points_m, neck.head_m, np.eye(n), np.zeros(n))
    _add_chain(robot, chain, links, names)
    T_last_head = pose(t=neck.head_m - (neck.points_m[-1] if n else 0.0))
    _add_joint(robot, "head_joint", links[-1], "head", T_last_head)
    for eye in EYES:
        base, pan, tilt, link = (f"{eye}_{part}" for part in ("base", "pan", "tilt", "eye"))
        _add_joint(robot, f"{base}_joint", "head", base, T_head_base(head, eye))
        _add_chain(robot, eye_chain(head.axes[eye]), [base, pan, link], [pan, tilt])
        for name, mounted in head.cameras.items():
            if mounted.eye == eye:
                T_eye_link = mounted.T_eye_cam @ inverse(T_LINK_OPTICAL)
                _add_joint(robot, f"{name}_joint", link, name, T_eye_link)
                optical = f"{name}_optical_frame"
                _add_joint(robot, f"{name}_optical_joint", name, optical, T_LINK_OPTICAL)
    ElementTree.indent(robot)
    text = ElementTree.tostring(robot, encoding="unicode")
    write_whole(path, f'<?xml version="1.0"?>\n{text}\n')


def _add_chain(
    robot: ElementTree.Element, chain: Chain, links: Sequence[str], joints: Sequence[str]
) -> None:
    """Add a chain of n joints between n + 1 links: true angle = gain * reading + offset."""
    steps = np.diff(chain.points_m, axis=0, prepend=np.zeros((1, 3)))
    for k, (parent, child, name) in enumerate(zip(links[:-1], links[1:], joints, strict=True)):
        T, axis = pose(t=steps[k]), chain.axes[k]
        gain, offset = chain.mixing[k, k], chain.offset_rad[k]
        if (gain, offset) == (1.0, 0.0):
            _add_joint(robot, name, parent, child, T, axis)
            continue
        _add_joint(robot, name, parent, f"{name}_reading", T, axis)
        limit = tuple(sorted(gain * angle + offset for angle in LIMIT_RAD))
        true = _add_joint(robot, f"{name}_true", parent, child, T, axis, limit)
        relation = {"joint": name, "multiplier": _text(gain), "offset": _text(offset)}
        ElementTree.SubElement(true, "mimic", relation)


def _add_joint(
    robot: ElementTree.Element,
    name: str,
    parent: str,
    child: str,
    T_parent_child: Array,
    axis: Array | None = None,
    limit_rad: tuple[float, ...] = LIMIT_RAD,
) -> ElementTree.Element:
    """Add a joint, fixed without an axis, and the link that it moves; return the joint."""
    kind = "fixed" if axis is None else "revolute"
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    xyz, rpy = T_parent_child[:3, 3], _rpy(T_parent_child[:3, :3])
    ElementTree.SubElement(joint, "origin", xyz=_text(*xyz), rpy=_text(*rpy))
    if axis is not None:
        numbers = dict(lower=limit_rad[0], upper=limit_rad[1], effort=EFFORT, velocity=VELOCITY)
        ElementTree.SubElement(joint, "axis", xyz=_text(*axis))
        ElementTree.SubElement(joint, "limit", {key: _text(v) for key, v in numbers.items()})
    ElementTree.SubElement(robot, "link", name=child)
    return joint


def _rpy(R: Array) -> tuple[float, float, float]:
    """Return roll, pitch, yaw [rad] of URDF: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    level = np.hypot(R[0, 0], R[1, 0])
    pitch = np.arctan2(-R[2, 0], level)
    if level < 1e-9:  # straight up or down: only the sum of roll and yaw has a meaning
        return np.arctan2(-R[1, 2], R[1, 1]), pitch, 0.0
    return np.arctan2(R[2, 1], R[2, 2]), pitch, np.arctan2(R[1, 0], R[0, 0])


def _text(*values: float) -> str:
    """Return numbers so that they read back exactly."""
    return " ".join(repr(float(value)) for value in values)
