"""From a model and a complete description to the head as designed.

Frame head has its axes along `forward` and `up`. The origin of an eye is where its last axis comes
nearest to the one before, its rotation centre if they meet; eyes with the same joints have it
beside that, as far as their cameras are.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

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
from vergence.geometry.se3 import inverse, pose
from vergence.twin.head_file import CameraFile, HeadFile
from vergence.twin.model_chain import ModelChain, model_chain
from vergence.twin.model_readings import model_readings

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
    """By eye its joints in the model, from the base outwards."""
    neck: tuple[str, ...]
    """The neck's joints in the model, from the body outwards."""
    cameras: Mapping[str, str]
    """By camera the body that carries it."""
    T_body_cam: Mapping[str, Array]
    """By camera its pose (4, 4) in that body."""


def designed_head(
    model: mujoco.MjModel, stated: HeadFile, lenses: Mapping[str, Camera]
) -> DesignedHead:
    """Build the head as designed from a compiled model.

    `stated` is complete, see `head_guess.completed`; `lenses` are the intrinsics by camera.
    VergenceError if joints are not hinges, or make no head that can be described.
    """
    assert stated.base is not None
    assert stated.forward is not None
    assert stated.up is not None
    base, bodies = stated.base, {n: camera_body(model, n, c) for n, c in stated.cameras.items()}
    R_base_head = axes_along(stated.forward, stated.up)
    chains: dict[Side, ModelChain] = {}
    T_base_cam, T_body_cam, origins = {}, {}, {}
    for name, camera in stated.cameras.items():
        assert camera.eye is not None
        wanted = stated.eyes.get(camera.eye, ())
        chain = model_chain(model, base, bodies[name], wanted)
        if lost := set(wanted) - set(chain.joints):
            raise VergenceError(
                f"The {camera.eye} eye has the joint {min(lost)}, which does not lie between "
                f"{base} and its camera {name}."
            )
        T_body_cam[name] = camera_in_body(model, name, stated)
        T_base_cam[name] = chain.T_base_end @ T_body_cam[name]
        if camera.eye not in chains:
            chains[camera.eye], origins[camera.eye] = chain, _rotation_centre(chain)
    chains = {eye: chains[eye] for eye in EYES if eye in chains}
    if len(chains) == 2 and chains["left"].joints == chains["right"].joints:
        left = R_base_head[:, 1]
        for eye in EYES:
            camera = next(n for n, camera in stated.cameras.items() if camera.eye == eye)
            beside = (T_base_cam[camera][:3, 3] - origins[eye]) @ left
            origins[eye] = origins[eye] + beside * left
    centre = np.mean(list(origins.values()), axis=0)
    joints = list(dict.fromkeys(joint for chain in chains.values() for joint in chain.joints))
    factors = {n: j.readings for n, j in stated.joints.items() if j.readings and n in joints}
    readings = model_readings(model, joints, factors)
    rows = dict(zip(joints, zip(readings.mixing, readings.offset_rad, strict=True), strict=True))
    eyes: dict[Side, tuple[Joint, ...]] = dict.fromkeys(EYES, ())
    try:
        for eye, chain in chains.items():
            eyes[eye] = tuple(
                Joint(
                    name=plain_name(name),
                    axis=R_base_head.T @ axis,
                    readings={
                        reading_name(reading): factor
                        for reading, factor in zip(readings.names, rows[name][0], strict=True)
                        if factor
                    },
                    point_m=R_base_head.T @ _nearest(point, axis, origins[eye]),
                    offset_rad=rows[name][1],
                )
                for name, axis, point in zip(chain.joints, chain.axes, chain.points_m, strict=True)
            )
        kinematics = Kinematics(eyes, tuple(map(reading_name, readings.names)))
        mounted = {}
        for name, camera in stated.cameras.items():
            assert camera.eye is not None
            T_base_eye = pose(R_base_head, origins[camera.eye])
            end_m = kinematics.chains[camera.eye].end_m
            T_eye_cam = pose(t=-end_m) @ inverse(T_base_eye) @ T_base_cam[name]
            mounted[name] = MountedCamera(camera.eye, lenses[name], T_eye_cam)
        both = len(origins) == 2
        t = R_base_head.T @ (origins["left"] - origins["right"]) if both else np.zeros(3)
        head = HeadCalibration(
            mounted, pose(t=t), kinematics, _neck(model, stated, R_base_head, centre)
        )
    except ValueError as error:
        raise VergenceError(
            f"{stated.model} is no head that can be described: {explain(error)}."
        ) from None
    names: dict[Side, tuple[str, ...]] = {eye: chain.joints for eye, chain in chains.items()}
    T_base_head = pose(R_base_head, centre)
    neck = stated.neck or ()
    return DesignedHead(head, base, T_base_head, names, neck, bodies, T_body_cam)


def axes_along(forward: Array, up: Array) -> Array:
    """Make the rotation (3, 3) of axes x along `forward` and z as near to `up` as possible."""
    x = np.array(forward) / np.linalg.norm(forward)
    z = np.array(up) - up @ x * x
    if np.linalg.norm(z) < 1e-6 * np.linalg.norm(up):
        raise VergenceError(f"forward and up are two directions; found {forward} and {up}.")
    z = z / np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], axis=1)


def plain_name(joint: str) -> str:
    """Make the name of a joint of an eye: without the side, letters, digits and _ only."""
    words = re.split(r"[^A-Za-z0-9]+", joint)
    kept = [word for word in words if word.lower() not in ("left", "right", "l", "r", "")]
    name = "_".join(kept) or "joint"
    return (name if name[0].isalpha() else f"joint_{name}")[:40]


def reading_name(name: str) -> str:
    """Make a name that a reading may have of that of a joint or a tendon."""
    name = re.sub(r"[^A-Za-z0-9_:()/ -]", "_", name)
    return (name if name[0].isalpha() else f"joint_{name}")[:60]


def camera_body(model: mujoco.MjModel, name: str, camera: CameraFile) -> str:
    """Look up the body that carries a camera."""
    if camera.body is not None:
        return model.body(camera.body).name
    return model.body(model.cam_bodyid[model.camera(camera.camera or name).id]).name


def camera_place(model: mujoco.MjModel, name: str, camera: CameraFile) -> Array:
    """Look up where (3,) [m] a camera is in the body that carries it."""
    if camera.body is None:
        return model.cam_pos[model.camera(camera.camera or name).id]
    return np.zeros(3) if camera.pos_m is None else camera.pos_m


def camera_in_body(model: mujoco.MjModel, name: str, stated: HeadFile) -> Array:
    """Compute the pose (4, 4) of a camera (OpenCV) in the body that carries it."""
    camera, at = stated.cameras[name], camera_place(model, name, stated.cameras[name])
    if camera.body is None:
        k = model.camera(camera.camera or name).id
        R = Rotation.from_quat(model.cam_quat[k], scalar_first=True).as_matrix()
        return pose(R @ R_MJCAM_CAM, at)
    forward, up = camera.forward, camera.up
    if forward is None or up is None:
        assert stated.base is not None
        assert camera.eye is not None
        assert stated.forward is not None
        assert stated.up is not None
        T = model_chain(model, stated.base, camera.body, stated.eyes.get(camera.eye, ())).T_base_end
        forward = T[:3, :3].T @ stated.forward if forward is None else forward
        up = T[:3, :3].T @ stated.up if up is None else up
    return pose(axes_along(forward, up) @ R_EYE_CAM, at)


def _nearest(point: Array, axis: Array, to: Array) -> Array:
    """Find the point of an axis nearest to a point, relative to that point."""
    between = point - to
    return between - between @ axis * axis


def _rotation_centre(chain: ModelChain) -> Array:
    """Find the point (3,) of the last axis nearest to the last axis that is not parallel to it."""
    if not len(chain.axes):
        return chain.T_base_end[:3, 3]
    axis, point = chain.axes[-1], chain.points_m[-1]
    for other, through in zip(chain.axes[-2::-1], chain.points_m[-2::-1], strict=True):
        normal = np.cross(axis, other)
        if (squared := normal @ normal) > PARALLEL**2:
            along = np.cross(through - point, other) @ normal / squared
            return point + along * axis
    return point + (chain.T_base_end[:3, 3] - point) @ axis * axis


def _neck(model: mujoco.MjModel, stated: HeadFile, R_base_head: Array, centre: Array) -> Neck:
    """Read the neck: its body is the one before its first joint, with the head's axes."""
    if not stated.neck:
        return Neck()
    assert stated.base is not None
    names = {model.joint(j).name: j for j in range(model.njnt)}
    first = int(model.jnt_bodyid[names[stated.neck[0]]])
    world, body = model.body(0).name, model.body(int(model.body_parentid[first])).name
    chain = model_chain(model, world, stated.base, stated.neck)
    origin = model_chain(model, world, body, ()).T_base_end[:3, 3]
    R = chain.T_base_end[:3, :3] @ R_base_head
    head = chain.T_base_end[:3, :3] @ centre + chain.T_base_end[:3, 3]
    joints = tuple(map(reading_name, chain.joints))
    points, end = (chain.points_m - origin) @ R, (head - origin) @ R
    return Neck(chain.axes @ R, points, end, joints)
