"""From a model and a complete description to the head as designed."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from vergence.arrays import Array
from vergence.errors import VergenceError, explain
from vergence.geometry.camera import Camera
from vergence.geometry.head import R_EYE_CAM, HeadCalibration, MountedCamera
from vergence.geometry.joints import PARALLEL, Joint
from vergence.geometry.kinematics import EYES, Kinematics, Side
from vergence.geometry.neck import Neck
from vergence.geometry.se3 import inverse, pose, transform
from vergence.twin.head_file import CameraFile, HeadFile
from vergence.twin.model_joints import ModelChain, ancestors, model_chain, model_readings

R_MJCAM_CAM = np.diag([1.0, -1.0, -1.0])
"""From OpenCV's frame of a camera to MuJoCo's, which looks along -z with +y up."""


@dataclass(frozen=True, eq=False)
class DesignedHead:
    """A head as designed, and where its parts are in the model."""

    head: HeadCalibration
    base: str
    """Body that is the head."""
    T_base_head: Array
    """(4, 4) pose of frame head in that body."""
    eyes: Mapping[Side, tuple[str, ...]]
    """Joints of each eye in the model, from the base outwards."""
    neck: tuple[str, ...]
    """Joints of the neck in the model, from the body outwards."""
    cameras: Mapping[str, str]
    """Body that carries each camera."""
    T_body_cam: Mapping[str, Array]
    """Pose (4, 4) of each camera in that body."""


def moving_joints(designed: DesignedHead) -> list[str]:
    """List the model's joints that move: the neck's and the eyes', each once."""
    return list(dict.fromkeys([*designed.neck, *sum(designed.eyes.values(), ())]))


def designed_head(
    model: mujoco.MjModel, stated: HeadFile, lenses: Mapping[str, Camera]
) -> DesignedHead:
    """Build the head as designed from a compiled model.

    `stated` is complete, see `head_guess.completed`; `lenses` are the intrinsics by camera. Frame
    head has its axes along `forward` and `up`. An eye's origin is its rotation centre; eyes with
    the same joints have it beside that, as far as their cameras are.
    VergenceError if joints are not hinges, or make no head that can be described.
    """
    assert stated.forward is not None
    assert stated.up is not None
    R_base_head = axes_along(stated.forward, stated.up)
    chains: dict[Side, ModelChain] = {}
    sides: dict[str, Side] = {}
    bodies, T_body_cam, T_base_cam, origins = {}, {}, {}, {}
    for name, camera in stated.cameras.items():
        assert camera.eye is not None
        eye, joints = camera.eye, stated.eyes.get(camera.eye, ())
        bodies[name], own = camera_in_body(model, name, camera)
        chain = model_chain(model, stated.base, bodies[name], joints)
        if lost := set(joints) - set(chain.joints):
            raise VergenceError(
                f"The {eye} eye has the joint {min(lost)}, which does not lie between "
                f"{stated.base} and its camera {name}."
            )
        if own is None:
            own = pose(chain.T_base_end[:3, :3].T @ R_base_head @ R_EYE_CAM, camera.pos_m)
        sides[name], T_body_cam[name], T_base_cam[name] = eye, own, chain.T_base_end @ own
        chains.setdefault(eye, chain)
    for eye, chain in chains.items():
        origins[eye] = _rotation_centre(chain)
        if len(chains) == 2 and chains["left"].joints == chains["right"].joints:
            camera = next(name for name in sides if sides[name] == eye)
            left, beside = R_base_head[:, 1], T_base_cam[camera][:3, 3] - origins[eye]
            origins[eye] = origins[eye] + beside @ left * left
    names: dict[Side, tuple[str, ...]] = {e: chains[e].joints for e in EYES if e in chains}
    factors, offsets = _readings(model, stated, list(dict.fromkeys(sum(names.values(), ()))))
    T_base_head = pose(R_base_head, sum(origins.values()) / len(origins))
    both, neck = len(origins) == 2, _neck(model, stated, T_base_head)
    t = R_base_head.T @ (origins["left"] - origins["right"]) if both else None
    try:
        eyes: dict[Side, tuple[Joint, ...]] = {eye: () for eye in EYES}
        for eye, chain in chains.items():
            eyes[eye] = _eye_joints(chain, pose(R_base_head, origins[eye]), factors, offsets)
        readings = dict.fromkeys(name for by_name in factors.values() for name in by_name)
        kinematics = Kinematics(eyes, tuple(readings))
        mounted = {}
        for name, eye in sides.items():
            T_eye_base = inverse(pose(R_base_head, origins[eye]))
            T_end_base = pose(t=-kinematics.chains[eye].end_m) @ T_eye_base
            mounted[name] = MountedCamera(eye, lenses[name], T_end_base @ T_base_cam[name])
        head = HeadCalibration(mounted, pose(t=t), kinematics, neck)
    except ValueError as error:
        raise VergenceError(f"{stated.model} is no head: {explain(error)}.") from None
    return DesignedHead(
        head, stated.base, T_base_head, names, stated.neck or (), bodies, T_body_cam
    )


def _readings(
    model: mujoco.MjModel, stated: HeadFile, joints: Sequence[str]
) -> tuple[dict[str, dict[str, float]], dict[str, float]]:
    """Find the factors of readings, and the offsets [rad], by joint: as stated, or the model's."""
    stated_factors = {name: joint.readings for name, joint in stated.joints.items()}
    free = [joint for joint in joints if not stated_factors.get(joint)]
    found = model_readings(model, free)
    by_model = {
        joint: {name: factor for name, factor in zip(found.names, row, strict=True) if factor}
        for joint, row in zip(free, found.mixing, strict=True)
    }
    every = stated_factors | by_model
    factors = {j: {reading_name(name): f for name, f in every[j].items()} for j in joints}
    return factors, dict(zip(free, found.offset_rad, strict=True))


def _eye_joints(
    chain: ModelChain,
    T_base_eye: Array,
    factors: Mapping[str, dict[str, float]],
    offsets: Mapping[str, float],
) -> tuple[Joint, ...]:
    """Describe the joints of a chain in the axes of its eye, by points near to its origin."""
    R, origin, joints = T_base_eye[:3, :3], T_base_eye[:3, 3], []
    for name, axis, point in zip(chain.joints, chain.axes, chain.points_m, strict=True):
        between = point - origin
        point_m = R.T @ (between - between @ axis * axis)
        joint = Joint(plain_name(name), R.T @ axis, factors[name], point_m)
        joints.append(replace(joint, offset_rad=offsets.get(name, 0.0)))
    return tuple(joints)


def axes_along(forward: Array, up: Array) -> Array:
    """Make the rotation (3, 3) of axes x along `forward` and z as near to `up` as possible."""
    if np.linalg.norm(np.cross(forward, up)) < 1e-6:
        raise VergenceError(
            f"A head looks along forward, and up is another direction; found {forward} and {up}. "
            "State them in head.toml."
        )
    x = forward / np.linalg.norm(forward)
    z = up - up @ x * x
    z = z / np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], axis=1)


def plain_name(joint: str) -> str:
    """Make the name of a joint of an eye: without the side, letters, digits and _ only."""
    words = re.split(r"[^A-Za-z0-9]+", joint)
    kept = [word for word in words if word.lower() not in ("left", "right", "l", "r", "")]
    return reading_name("_".join(kept) or "joint")[:40]


def reading_name(name: str) -> str:
    """Make a name that a reading may have of that of a joint or a tendon."""
    name = re.sub(r"[^A-Za-z0-9_:()/ -]", "_", name)
    return (name if name[0].isalpha() else f"joint_{name}")[:60]


def camera_in_body(
    model: mujoco.MjModel, name: str, camera: CameraFile
) -> tuple[str, Array | None]:
    """Look up the body that carries a camera, and its pose (4, 4) there; None: that of the head."""
    if camera.body is None:
        k = model.camera(camera.camera or name).id
        R = Rotation.from_quat(model.cam_quat[k], scalar_first=True).as_matrix()
        return model.body(model.cam_bodyid[k]).name, pose(R @ R_MJCAM_CAM, model.cam_pos[k])
    if camera.forward is None or camera.up is None:
        return camera.body, None
    R = axes_along(camera.forward, camera.up) @ R_EYE_CAM
    return camera.body, pose(R, camera.pos_m)


def _rotation_centre(chain: ModelChain) -> Array:
    """Find the point (3,) of the last axis nearest to the last axis that is not parallel to it."""
    if not len(chain.axes):
        return chain.T_base_end[:3, 3]
    axis, point = chain.axes[-1], chain.points_m[-1]
    for other, through in zip(chain.axes[-2::-1], chain.points_m[-2::-1], strict=True):
        normal = np.cross(axis, other)
        if (squared := normal @ normal) > PARALLEL**2:
            return point + np.cross(through - point, other) @ normal / squared * axis
    return point + (chain.T_base_end[:3, 3] - point) @ axis * axis


def _neck(model: mujoco.MjModel, stated: HeadFile, T_base_head: Array) -> Neck:
    """Read the neck: its body is the one before its first joint, with the head's axes."""
    if not stated.neck:
        return Neck()
    first = ancestors(model, int(model.jnt_bodyid[model.joint(stated.neck[0]).id]))
    chain = model_chain(model, "world", stated.base, stated.neck)
    before = model_chain(model, "world", model.body(first[-2]).name, ()).T_base_end[:3, 3]
    R, head_m = chain.T_base_end[:3, :3] @ T_base_head[:3, :3], T_base_head[:3, 3]
    end = (transform(chain.T_base_end, head_m) - before) @ R
    names = tuple(map(reading_name, chain.joints))
    return Neck(chain.axes @ R, (chain.points_m - before) @ R, end, names)
