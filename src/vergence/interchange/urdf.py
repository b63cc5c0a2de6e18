"""URDF of a calibrated head, for ROS: links, joints, and the cameras' optical frames.

Links: body, (one a neck joint), head, and for each eye with a camera left_base, left_pan, left_eye,
and for each camera left_wide (x forward) and left_wide_optical_frame (frame cam: z forward). An eye
whose pose is measured floats in its base: whoever measures it publishes the transform.

Joints have their usual names (left_pan, left_tilt, neck_pitch, ...), and their positions are the
encoders' readings. Where readings need a gain or an offset, the joint of that name turns an empty
link, and <joint>_true mimics it with URDF's multiplier and offset; transforms then agree exactly.

Every link that moves has inertia, without which MuJoCo and Gazebo refuse it, and MuJoCo is told to
keep the links that do not move against their parents, which are its cameras' frames.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.files import write_whole
from vergence.gaze.commands import JointLimits
from vergence.geometry.head import R_EYE_CAM, HeadCalibration, base_pose
from vergence.geometry.kinematics import EYES, Kinematics, Side
from vergence.geometry.se3 import inverse, pose
from vergence.interchange.serialization import check_names

LIMIT_RAD = 1.5708
"""Limit of joints without a stated one [rad], a quarter turn each way: URDF requires limits."""
EFFORT, VELOCITY = 100.0, 100.0
"""Limits of torque [N m] and of speed [rad/s] that URDF requires, large enough to have no
effect."""
MASS_KG, INERTIA_KG_M2 = 0.05, 2e-5
"""Mass and inertia of a moving link, those of a ball of 32 mm radius: a calibration holds none."""

T_LINK_OPTICAL = pose(R_EYE_CAM)
"""From frame cam to a camera's link, which looks along x with z up (REP 103)."""


_Limit = tuple[float, float, float]
"""Lower and upper end [rad] of a joint's range, and its speed [rad/s]."""
_USUAL: _Limit = -LIMIT_RAD, LIMIT_RAD, VELOCITY


def save(head: HeadCalibration, path: Path, limits: JointLimits | None = None) -> None:
    """Write a head as URDF, without the cameras' intrinsics, for which it has no field.

    `limits` are those of the neck's joints and of the readings, by name; others get LIMIT_RAD.
    VergenceError if there is no camera, two links or joints would have one name, or the file cannot
    be written.
    """
    check_names(head)
    stated: dict[str, _Limit] = {}
    if limits is not None:
        rows = zip(limits.joints, limits.range_rad.tolist(), limits.speed_rad_s, strict=True)
        stated = {name: (*ends, float(speed)) for name, ends, speed in rows}
    robot = ElementTree.Element("robot", name="vergence_head")
    mujoco = ElementTree.SubElement(robot, "mujoco")
    ElementTree.SubElement(mujoco, "compiler", fusestatic="false")
    ElementTree.SubElement(robot, "link", name="body")
    neck = head.neck
    n = len(neck.axes)
    names = [*map(_identifier, neck.names)]
    links = ["body", *names]
    for k, step in enumerate(np.diff(neck.points_m, axis=0, prepend=np.zeros((1, 3)))):
        limit = stated.get(neck.names[k], _USUAL)
        _add_joint(robot, names[k], links[k], names[k], pose(t=step), neck.axes[k], limit)
    T_last_head = pose(t=neck.head_m - (neck.points_m[-1] if n else 0.0))
    _add_joint(robot, "head_joint", links[-1], "head", T_last_head)
    floating = head.accuracy is not None and head.accuracy.eye_motion == "poses"
    for eye in EYES:
        cameras = {name: each for name, each in head.cameras.items() if each.eye == eye}
        if not cameras:
            continue
        base, link = f"{eye}_base", f"{eye}_eye"
        _add_joint(robot, f"{base}_joint", "head", base, base_pose(head, eye))
        if floating:
            _add_joint(robot, f"{link}_joint", base, link, np.eye(4)).set("type", "floating")
        else:
            _add_eye(robot, head.kinematics, eye, base, link, stated)
        for name, mounted in cameras.items():
            T_eye_link = mounted.T_eye_cam @ inverse(T_LINK_OPTICAL)
            _add_joint(robot, f"{name}_joint", link, name, T_eye_link)
            optical = f"{name}_optical_frame"
            _add_joint(robot, f"{name}_optical_joint", name, optical, T_LINK_OPTICAL)
    _check_different("link", [link.get("name", "") for link in robot.iter("link")])
    _check_different("joint", [joint.get("name", "") for joint in robot.iter("joint")])
    _check_different("joint", [_identifier(name) for name in head.kinematics.readings])
    ElementTree.indent(robot)
    text = ElementTree.tostring(robot, encoding="unicode")
    write_whole(path, f'<?xml version="1.0"?>\n{text}\n')


def _add_eye(
    robot: ElementTree.Element,
    kinematics: Kinematics,
    eye: Side,
    base: str,
    end: str,
    stated: Mapping[str, _Limit],
) -> None:
    """Add the joints of an eye between two links: angle = sum of factor * reading + offset.

    A joint with one reading has the reading's name. Other joints mimic their readings, with one
    turn about the axis for each; a reading that is not a joint's angle gets a link of its own.
    """
    chain, parent, at = kinematics.chains[eye], base, np.zeros(3)
    factors = np.concatenate([c.mixing for c in kinematics.chains.values()])
    largest = np.abs(factors).max(axis=0, initial=0.0)
    for k, joint in enumerate(kinematics.eyes[eye]):
        T, at = pose(t=chain.points_m[k] - at), chain.points_m[k]
        terms = [r for r in kinematics.used(eye) if chain.mixing[k, r]]
        last = k == len(chain.axes) - 1
        child = end if last else f"{eye}_{joint.name}"
        one = kinematics.readings[terms[0]]
        limits = {
            r: stated.get(
                kinematics.readings[r],
                (-LIMIT_RAD / largest[r], LIMIT_RAD / largest[r], VELOCITY),
            )
            for r in terms
        }
        users = sum(np.count_nonzero(c.mixing[:, terms[0]]) for c in kinematics.chains.values())
        alone = len(terms) == 1 and users == 1
        if alone and (chain.mixing[k, terms[0]], chain.offset_rad[k]) == (1.0, 0.0):
            limit = limits[terms[0]]
            _add_joint(robot, _identifier(one), parent, child, T, chain.axes[k], limit)
            parent = child
            continue
        offset = chain.offset_rad[k]
        for r in terms:
            name, factor = _identifier(kinematics.readings[r]), chain.mixing[k, r]
            if robot.find(f"link[@name='{name}_reading']") is None:
                _add_joint(robot, name, parent, f"{name}_reading", T, chain.axes[k], limits[r])
            true = f"{eye}_{joint.name}_true" + ("" if len(terms) == 1 else f"_{name}")
            through = child if r == terms[-1] else true
            *ends, speed = limits[r]
            lower, upper = sorted(factor * end + offset for end in ends)
            limit = lower, upper, abs(factor) * speed
            follower = _add_joint(robot, true, parent, through, T, chain.axes[k], limit)
            relation = {"joint": name, "multiplier": _text(factor), "offset": _text(offset)}
            ElementTree.SubElement(follower, "mimic", relation)
            parent, T, offset = through, np.eye(4), 0.0
    if not len(chain.axes):
        _add_joint(robot, f"{end}_joint", base, end, np.eye(4))


def _check_different(what: str, names: list[str]) -> None:
    for name, count in Counter(names).most_common(1):
        if count > 1:
            raise VergenceError(
                f"The URDF would have two {what}s called {name}; rename the camera, the joint or "
                "the reading of that name in the calibration's file."
            )


def _identifier(name: str) -> str:
    """Convert the name of a reading to letters, digits and _."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name)


def _add_joint(
    robot: ElementTree.Element,
    name: str,
    parent: str,
    child: str,
    T_parent_child: Array,
    axis: Array | None = None,
    limit: _Limit = _USUAL,
) -> ElementTree.Element:
    """Add a joint, revolute if it has an axis, and the link that it moves; return the joint."""
    joint = ElementTree.SubElement(
        robot, "joint", name=name, type="fixed" if axis is None else "revolute"
    )
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)
    turn = Rotation.from_matrix(T_parent_child[:3, :3])
    rpy = turn.as_euler("xyz", suppress_warnings=True)  # straight up or down any yaw will do
    ElementTree.SubElement(joint, "origin", xyz=_text(*T_parent_child[:3, 3]), rpy=_text(*rpy))
    link = ElementTree.SubElement(robot, "link", name=child)
    if axis is not None:
        numbers = zip(("lower", "upper", "velocity", "effort"), (*limit, EFFORT), strict=True)
        ElementTree.SubElement(joint, "axis", xyz=_text(*axis))
        ElementTree.SubElement(joint, "limit", {key: _text(value) for key, value in numbers})
        inertial = ElementTree.SubElement(link, "inertial")
        ElementTree.SubElement(inertial, "mass", value=_text(MASS_KG))
        moment = _text(INERTIA_KG_M2)
        inertia = {"ixx": moment, "iyy": moment, "izz": moment, "ixy": "0", "ixz": "0", "iyz": "0"}
        ElementTree.SubElement(inertial, "inertia", inertia)
    return joint


def _text(*values: float) -> str:
    """Format numbers so that they read back exactly, a negative zero without its sign."""
    return " ".join(repr(float(value) + 0.0) for value in values)
