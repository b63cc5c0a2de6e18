"""From a head as designed to an as-built one, and to a compiled model of it in its room."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration, MountedCamera, base_pose
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import EYES, Side
from vergence.geometry.se3 import inverse, pose, rotation
from vergence.twin.designed_head import R_MJCAM_CAM, DesignedHead, moving_joints
from vergence.twin.head_model import HeadModel
from vergence.twin.model_joints import at_rest, body_pose, model_chain
from vergence.twin.profile import ErrorProfile
from vergence.twin.scene import Scene, load_room

PREFIX = "head/"
"""Prefix of the names of the head's parts that the room has too."""
EYES_AT_M = np.array([0.0, 0.0, 1.2])
"""Where frame head is in the room with the neck at zero."""
SERVO_RAD_S = 500.0
"""Bandwidth of a servo of a joint for which the model has none; it lags by 4 ms."""
SENSOR_PITCH_M = np.float32(1e-5)
"""Size of a pixel [m], which cancels: MuJoCo asks for it."""
HIDDEN = 5
"""Group of geoms that no camera sees; recordings show them."""
STEP_S = 0.001
"""Step of the physics [s]."""


def as_built_head(
    nominal: HeadCalibration, profile: ErrorProfile, seed: int, *, shared: int = 0
) -> HeadCalibration:
    """Draw the true head from the nominal one and the standard deviations of a profile.

    All profiles draw the same random numbers. Joints that both eyes share, from the base outwards,
    are as designed, and so are then the bases of the eyes.
    """
    rng = np.random.default_rng([seed, 1])
    mounting, optics = profile.mounting, profile.optics
    cameras = {}
    for name, mounted in nominal.cameras.items():
        turn = rng.normal(0, np.radians(mounting.rotation_deg), 3)
        shift = rng.normal(0, mounting.translation_mm * 1e-3, 3)
        focal = 1 + rng.normal(0, optics.focal_percent / 100)
        principal = rng.normal(0, optics.principal_px, 2)
        camera = mounted.intrinsics
        matrix = camera.matrix.copy()
        matrix[[0, 1], [0, 1]] *= focal
        matrix[:2, 2] += principal
        cameras[name] = MountedCamera(
            eye=mounted.eye,
            intrinsics=replace(
                camera, matrix=matrix, distortion=camera.distortion * optics.distortion
            ),
            T_eye_cam=pose(t=shift) @ mounted.T_eye_cam @ pose(rotation(turn)),
        )
    T_rbase_lbase = nominal.T_rbase_lbase.copy()
    turn = rng.normal(0, np.radians(mounting.base_rotation_deg), 3)
    shift = rng.normal(0, mounting.base_translation_mm * 1e-3, 3)
    if not shared and all(nominal.kinematics.eyes.values()):
        if mounting.baseline_mm is not None:
            distance_m = np.linalg.norm(T_rbase_lbase[:3, 3])
            T_rbase_lbase[:3, 3] *= mounting.baseline_mm * 1e-3 / distance_m
        T_rbase_lbase = T_rbase_lbase @ pose(rotation(turn), shift)
    eyes: dict[Side, tuple[Joint, ...]] = {}
    for eye, turn_deg, distance_mm in zip(
        EYES, profile.axes.nonorthogonality_deg, profile.axes.distance_mm, strict=True
    ):
        joints = list(nominal.kinematics.eyes[eye])
        if len(joints) > 1 >= shared:
            joints[1] = replace(
                joints[1],
                nonorthogonality_rad=np.radians(turn_deg),
                axis_distance_m=distance_mm * 1e-3,
            )
        eyes[eye] = tuple(joints)
    kinematics = replace(nominal.kinematics, eyes=eyes)
    return replace(nominal, cameras=cameras, T_rbase_lbase=T_rbase_lbase, kinematics=kinematics)


def shared_joints(designed: DesignedHead) -> tuple[str, ...]:
    """List the model's joints that move both eyes, from the base outwards."""
    left, right = (designed.eyes.get(eye, ()) for eye in EYES)
    return tuple(name for name in left if name in right)


def compile_head(
    of: HeadModel,
    head: HeadCalibration,
    overscan: dict[str, tuple[int, int]],
    *,
    scene: Scene = "room",
    furnish: Callable[[mujoco.MjSpec], None] | None = None,
) -> mujoco.MjModel:
    """Compile a scene with an as-built head, whose lens distortion the renderer adds.

    `overscan` is the width and height [px] to render by camera, at the camera's own focal length;
    the image lies in the middle of it. `furnish` changes the scene, for example its board.
    """
    spec, designed = of.spec.copy(), of.designed
    _let_stand_still(spec, of)
    _add_servos(spec, of)
    _build_eyes(spec, of, head)
    _mount_cameras(spec, of, head, overscan)
    room = load_room(scene)
    for each in (spec, room):
        each.option.timestep = STEP_S
        each.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    chain = model_chain(of.model, "world", designed.base, designed.neck)
    T_world_model = pose(t=EYES_AT_M) @ inverse(chain.T_base_end @ designed.T_base_head)
    T_world_model = np.round(T_world_model, 9) + 0.0  # exact where the model stands upright
    frame = room.worldbody.add_frame(pos=T_world_model[:3, 3], quat=_quaternion(T_world_model))
    room.attach(spec, frame=frame, prefix=PREFIX)
    for parts in (room.bodies, room.joints, room.cameras):
        taken = {part.name for part in parts}
        for part in parts:
            plain = part.name.removeprefix(PREFIX)
            part.name = part.name if plain in taken else plain
    for actuator in room.actuators:
        actuator.target = actuator.target.removeprefix(PREFIX)
    if furnish is not None:
        furnish(room)
    model = room.compile()
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)  # nothing collides
    _hide_eyeballs(model)
    return model


def _hide_eyeballs(model: mujoco.MjModel) -> None:
    """Hide from the cameras what is mounted with them: models place cameras inside of meshes."""
    mounted = model.body_weldid[model.cam_bodyid]
    hidden = np.isin(model.body_weldid[model.geom_bodyid], mounted[mounted > 0])
    model.geom_group[hidden & (model.geom_group < 3)] = HIDDEN  # 3 and more: not drawn


def _quaternion(T: Array) -> Array:
    return Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)


def _place(part: mujoco.MjsBody | mujoco.MjsCamera, T: Array) -> None:
    """Put a body or a camera of a specification at a pose (4, 4) in its parent."""
    part.pos, part.quat = T[:3, 3], _quaternion(T)
    part.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT


def _let_stand_still(spec: mujoco.MjSpec, of: HeadModel) -> None:
    """Delete all joints that neither turn an eye nor are the neck's, and what refers to them.

    Joints that move begin at zero. What stands in the world of the model is deleted too.
    """
    model, moving = of.model, moving_joints(of.designed)
    data = at_rest(model, moving)
    for k in np.flatnonzero(data.qpos != model.qpos0):
        joint = int(np.flatnonzero(model.jnt_qposadr <= k)[-1])
        body = model.body(model.jnt_bodyid[joint])
        if model.jnt_type[joint] != int(mujoco.mjtJoint.mjJNT_FREE):
            parent = body_pose(data, model.body(body.parentid[0]).name)
            _place(spec.body(body.name), inverse(parent) @ body_pose(data, body.name))
    damped = {joint.name for joint in spec.joints if np.any(joint.damping)}
    servos = [
        actuator
        for actuator in spec.actuators
        if actuator.target in moving
        and _is_position_servo(actuator)
        and (actuator.biasprm[2] != 0 or actuator.target in damped)  # it comes to rest
    ]
    if {actuator.target for actuator in servos} != set(moving):
        servos = []  # weak ones beside the twin's would give way
    for part in [
        *(a for a in spec.actuators if a not in servos),
        *spec.sensors, *spec.tendons, *spec.equalities, *spec.keys, *spec.excludes, *spec.pairs,
        *(joint for joint in spec.joints if joint.name not in moving),
        *spec.worldbody.geoms, *spec.lights,
    ]:  # fmt: skip
        spec.delete(part)
    for joint in spec.joints:
        joint.ref = 0.0
        if not servos:
            for name in ("damping", "stiffness", "frictionloss"):
                setattr(joint, name, np.zeros_like(getattr(joint, name)))


def _is_position_servo(actuator: mujoco.MjsActuator) -> bool:
    """Check whether an actuator sends its joint to an angle."""
    kinds = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtBias.mjBIAS_AFFINE
    proportional = actuator.gainprm[0] > 0 and actuator.biasprm[1] == -actuator.gainprm[0]
    return (actuator.trntype, actuator.biastype) == kinds and bool(proportional)


def _add_servos(spec: mujoco.MjSpec, of: HeadModel) -> None:
    """Give joints critically damped servos, and bodies no weight, where the model has no servos."""
    if spec.actuators:
        return
    model, data = of.model, at_rest(of.model, moving_joints(of.designed))
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    for name in moving_joints(of.designed):
        own = inertia[model.joint(name).dofadr[0], model.joint(name).dofadr[0]]
        kp, kv = own * SERVO_RAD_S**2, 2 * own * SERVO_RAD_S
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=kp, kv=kv)
    for body in spec.bodies[1:]:
        body.gravcomp = 1.0


def _build_eyes(spec: mujoco.MjSpec, of: HeadModel, head: HeadCalibration) -> None:
    """Move the bases and axes of the eyes to where they are as built."""
    model, designed, shared = of.model, of.designed, shared_joints(of.designed)
    for eye, names in designed.eyes.items():
        chain = head.kinematics.chains[eye]
        T_base_lbase = designed.T_base_head @ base_pose(designed.head, eye)
        T_base_built = designed.T_base_head @ base_pose(head, eye)
        moved = False
        for name, axis, point in zip(names, chain.axes, chain.points_m, strict=True):
            body = int(model.jnt_bodyid[model.joint(name).id])
            own = spec.body(model.body(body).name)
            T_eye_body = inverse(T_base_lbase) @ _pose_in_base(of, own.name)
            if not moved and not shared:
                parent = model.body(model.body_parentid[body]).name
                T_base_parent = _pose_in_base(of, parent)
                _place(own, inverse(T_base_parent) @ T_base_built @ T_eye_body)
                moved = True
            joint, R = spec.joint(name), T_eye_body[:3, :3]
            joint.axis = R.T @ axis
            joint.pos = R.T @ (point - T_eye_body[:3, 3])


def _pose_in_base(of: HeadModel, body: str) -> Array:
    """Compute the pose (4, 4) of a body in the base as designed, with every joint at zero."""
    return model_chain(of.model, of.designed.base, body, moving_joints(of.designed)).T_base_end


def _mount_cameras(
    spec: mujoco.MjSpec,
    of: HeadModel,
    head: HeadCalibration,
    overscan: dict[str, tuple[int, int]],
) -> None:
    """Give the model the cameras of an as-built head, and no others."""
    designed = of.designed
    for camera in list(spec.cameras):
        spec.delete(camera)
    for name, mounted in head.cameras.items():
        body = designed.cameras[name]
        T_base_lbase = designed.T_base_head @ base_pose(designed.head, mounted.eye)
        T_body_eye = inverse(_pose_in_base(of, body)) @ T_base_lbase
        # At zero the eye has the axes of its base, and its origin is at the end of the chain.
        at = pose(t=head.kinematics.chains[mounted.eye].end_m) @ mounted.T_eye_cam
        camera = spec.body(body).add_camera(name=name)
        _place(camera, T_body_eye @ at @ pose(R_MJCAM_CAM))
        intrinsics, size = mounted.intrinsics, np.array(overscan[name])
        centre = (np.array(intrinsics.size) - 1) / 2
        camera.resolution = size
        camera.sensor_size = size * SENSOR_PITCH_M
        camera.focal_pixel = intrinsics.matrix[[0, 1], [0, 1]]
        camera.focal_length = [0, 0]
        camera.principal_pixel = centre - intrinsics.matrix[:2, 2]


def body_in_room(model: mujoco.MjModel, name: str) -> str:
    """Look up the name that a body of the head has in the model of head and room."""
    names = {model.body(k).name for k in range(model.nbody)}
    return PREFIX + name if PREFIX + name in names else name
