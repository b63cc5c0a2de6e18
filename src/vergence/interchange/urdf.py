"""URDF of a calibrated head, for ROS: links, joints, and the cameras' optical frames.

Links: body, (one a neck joint), head, and for each eye left_base, left_pan, left_eye, and for each
camera left_wide (x forward) and left_wide_optical_frame (frame cam: z forward).

Joints are called as everywhere (left_pan, left_tilt, neck_pitch, ...) and their positions are the
encoders' readings. Where readings need a gain or an offset, the joint of that name turns an empty
link, and <joint>_true mimics it with URDF's multiplier and offset; transforms then agree exactly.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from vergence.arrays import Array
from vergence.files import write_whole
from vergence.geometry.head import HeadCalibration, T_head_base
from vergence.geometry.kinematics import EYES, NECK_JOINTS, Side
from vergence.geometry.se3 import inverse, pose
from vergence.interchange.limits import check_names

LIMIT_RAD = 1.5708
"""Of joints for which no limits are given: a calibration knows of none, and URDF demands some."""
EFFORT, VELOCITY = 100.0, 100.0
"""Likewise: large, so that they stand for none."""

R_LINK_OPTICAL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""From frame cam to a camera's link, which looks along x with z up (REP 103)."""

Limits = Mapping[str, tuple[float, float]]


def save(head: HeadCalibration, path: Path, *, limits: Limits | None = None) -> None:
    """Write a head as URDF.

    Args:
        head: intrinsics are left out: URDF has no field for them.
        path: of the file.
        limits: lower and upper limit [rad] by joint; for those left out ±LIMIT_RAD.

    Raises:
        VergenceError: there is no camera, or the file cannot be written.
    """
    check_names(head)
    robot = ElementTree.Element("robot", name="vergence_head")
    _neck(robot, head, limits or {})
    for eye in EYES:
        _eye(robot, head, eye, limits or {})
    ElementTree.indent(robot)
    text = ElementTree.tostring(robot, encoding="unicode")
    write_whole(path, f'<?xml version="1.0"?>\n{text}\n')


def _neck(robot: ElementTree.Element, head: HeadCalibration, limits: Limits) -> None:
    neck = head.neck
    count = len(neck.axes)
    standard = count == len(NECK_JOINTS)
    names = NECK_JOINTS if standard else tuple(f"neck_{k + 1}" for k in range(count))
    _link(robot, "body")
    parent, at = "body", np.zeros(3)
    for name, axis, point in zip(names, neck.axes, neck.points_m, strict=True):
        _joint(robot, name, "revolute", parent, name, pose(t=point - at), axis, limits)
        _link(robot, name)
        parent, at = name, point
    _joint(robot, "head_joint", "fixed", parent, "head", pose(t=neck.head_m - at))
    _link(robot, "head")


def _eye(robot: ElementTree.Element, head: HeadCalibration, eye: Side, limits: Limits) -> None:
    axes, base, pan, tilt = head.axes[eye], f"{eye}_base", f"{eye}_pan", f"{eye}_tilt"
    _joint(robot, f"{base}_joint", "fixed", "head", base, T_head_base(head, eye))
    _link(robot, base)
    z = np.array([0.0, 0.0, 1.0])
    _read(robot, pan, (axes.pan_gain, axes.pan_offset_rad), base, pan, np.eye(4), z, limits)
    _link(robot, pan)
    turn = axes.nonorthogonality_rad
    tilt_axis = np.array([0.0, np.cos(turn), np.sin(turn)])
    at = pose(t=[axes.axis_distance_m, 0.0, 0.0])
    reading = (axes.tilt_gain, axes.tilt_offset_rad)
    _read(robot, tilt, reading, pan, f"{eye}_eye", at, tilt_axis, limits)
    _link(robot, f"{eye}_eye")
    for name, mounted in head.cameras.items():
        if mounted.eye == eye:
            T_link_optical = pose(R_LINK_OPTICAL)
            T_eye_link = mounted.T_eye_cam @ inverse(T_link_optical)
            optical = f"{name}_optical_frame"
            _joint(robot, f"{name}_joint", "fixed", f"{eye}_eye", name, T_eye_link)
            _link(robot, name)
            _joint(robot, f"{name}_optical_joint", "fixed", name, optical, T_link_optical)
            _link(robot, optical)


def _read(
    robot: ElementTree.Element,
    name: str,
    reading: tuple[float, float],
    parent: str,
    child: str,
    T_parent_child: Array,
    axis: Array,
    limits: Limits,
) -> None:
    """Add a joint whose position is a reading: true angle = gain * reading + offset."""
    gain, offset = reading
    if (gain, offset) == (1.0, 0.0):
        _joint(robot, name, "revolute", parent, child, T_parent_child, axis, limits)
        return
    _joint(robot, name, "revolute", parent, f"{name}_reading", T_parent_child, axis, limits)
    _link(robot, f"{name}_reading")
    lower, upper = sorted(gain * limit + offset for limit in _limit(name, limits))
    true = {f"{name}_true": (lower, upper)}
    joint = _joint(robot, f"{name}_true", "revolute", parent, child, T_parent_child, axis, true)
    ElementTree.SubElement(joint, "mimic", joint=name, multiplier=_text(gain), offset=_text(offset))


def _link(robot: ElementTree.Element, name: str) -> None:
    ElementTree.SubElement(robot, "link", name=name)


def _limit(name: str, limits: Limits) -> tuple[float, float]:
    return limits.get(name, (-LIMIT_RAD, LIMIT_RAD))


def _joint(
    robot: ElementTree.Element,
    name: str,
    kind: str,
    parent: str,
    child: str,
    T_parent_child: Array,
    axis: Array | None = None,
    limits: Limits | None = None,
) -> ElementTree.Element:
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    xyz, rpy = T_parent_child[:3, 3], _rpy(T_parent_child[:3, :3])
    ElementTree.SubElement(joint, "origin", xyz=_text(*xyz), rpy=_text(*rpy))
    if axis is not None:
        lower, upper = _limit(name, limits or {})
        ElementTree.SubElement(joint, "axis", xyz=_text(*axis))
        ElementTree.SubElement(
            joint,
            "limit",
            lower=_text(lower),
            upper=_text(upper),
            effort=_text(EFFORT),
            velocity=_text(VELOCITY),
        )
    return joint


def _rpy(R: Array) -> tuple[float, float, float]:
    """Return roll, pitch, yaw [rad] of URDF: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    level = np.hypot(R[0, 0], R[1, 0])
    pitch = np.arctan2(-R[2, 0], level)
    if level < 1e-9:  # straight up or down: only the sum of roll and yaw has a meaning
        return float(np.arctan2(-R[1, 2], R[1, 1])), float(pitch), 0.0
    roll, yaw = np.arctan2(R[2, 1], R[2, 2]), np.arctan2(R[1, 0], R[0, 0])
    return float(roll), float(pitch), float(yaw)


def _text(*values: float) -> str:
    """Return numbers so that they read back exactly."""
    return " ".join(repr(float(value)) for value in values)
