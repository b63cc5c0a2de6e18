"""A head of the twin: its model, the head as designed, and the limits of its joints."""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from vergence.errors import VergenceError
from vergence.gaze.commands import USUAL_RANGE_RAD, USUAL_SPEED_RAD_S, JointLimits, posture_joints
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration
from vergence.interchange import ros
from vergence.twin.designed_head import DesignedHead, designed_head, moving_joints, reading_name
from vergence.twin.head_file import CameraFile, HeadFile, JointFile, LensFile, load_head_file
from vergence.twin.head_guess import completed
from vergence.twin.model_file import load_model

USUAL_SIZE = 640, 480
"""Size of the images [px] of a camera for which neither head.toml nor the model has one."""


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
    if lens and lens not in stated.lenses:
        known = ", ".join(stated.lenses) or "none to choose from"
        raise VergenceError(f"This head has no lens {lens!r}; it has {known}.")
    lens = lens or next(iter(stated.lenses), "")
    spec = load_model(model_path)
    add_joints(spec, stated)
    model = spec.compile()
    try:
        stated = completed(stated, model)
    except KeyError as error:  # MuJoCo lists the names that there are
        raise VergenceError(f"{model_path}: {str(error.args[0])[:300]}") from None
    lenses, choice = {}, stated.lenses.get(lens)
    for name, camera in stated.cameras.items():
        own = camera if choice is None or name not in choice.cameras else choice
        lenses[name] = intrinsics(model, folder, name, camera, own)
    designed = designed_head(model, stated, lenses)
    return HeadModel(spec, model, stated, designed, head_limits(model, stated, designed), lens)


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
            raise VergenceError(
                f"The joint {name} that head.toml adds needs an axis and a body of the model; "
                f"found the body {joint.body!r} and the axis {joint.axis}."
            )
        for ball in [j for j in body.joints if j.type == mujoco.mjtJoint.mjJNT_BALL]:
            spec.delete(ball)
        place = np.zeros(3) if joint.pos_m is None else joint.pos_m
        body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=joint.axis, pos=place)


def intrinsics(
    model: mujoco.MjModel, folder: Path, name: str, camera: CameraFile, lens: LensFile
) -> Camera:
    """Determine the intrinsics of a camera with a lens, by head.toml in a folder or the model.

    VergenceError if neither states them.
    """
    if lens.camera_info is not None:
        return next(iter(ros.load(folder / lens.camera_info).values()))
    size, matrix, shift = camera.size or USUAL_SIZE, np.eye(3), np.zeros(2)
    k = None if camera.body is not None else model.camera(camera.camera or name).id
    if camera.size is None and k is not None and min(model.cam_resolution[k]) > 1:
        size = tuple(model.cam_resolution[k].tolist())  # 1 x 1: the model has none
    if lens.fov_deg is not None:
        focal = size[0] / 2 / np.tan(np.radians(lens.fov_deg) / 2)
    elif k is not None and model.cam_sensorsize[k].any():
        pitch_m = model.cam_sensorsize[k] / np.array(size, np.float32)
        if np.isclose(*pitch_m, rtol=1e-5):  # square pixels, as far as the model's numbers tell
            pitch_m = pitch_m[[0, 0]]
        focal, shift = np.split(model.cam_intrinsic[k] / np.tile(pitch_m, 2), 2)
        focal = focal if lens.focal_mm is None else lens.focal_mm * 1e-3 / pitch_m[0]
    elif k is not None and lens.focal_mm is None:
        focal = size[1] / 2 / np.tan(np.radians(model.cam_fovy[k]) / 2)
    else:
        raise VergenceError(f"The lens of {name} is not known; give its fov_deg or camera_info.")
    matrix[[0, 1], [0, 1]] = focal
    matrix[:2, 2] = (np.array(size) - 1) / 2 - shift
    width, height = size
    return Camera(width, height, matrix, np.array(lens.distortion), lens.model)


def head_limits(model: mujoco.MjModel, stated: HeadFile, designed: DesignedHead) -> JointLimits:
    """Determine the limits of the neck's joints and of the readings.

    A joint of several readings divides its range and speed equally among them, so that no
    combination of their values leaves it; the range of a tendon is that of its reading.
    """
    by_joint, kinematics = {}, designed.head.kinematics
    for name in moving_joints(designed):
        own, joint = stated.joints.get(name, JointFile()), model.joint(name).id
        usual_rad = np.array([-USUAL_RANGE_RAD, USUAL_RANGE_RAD])
        range_rad = model.jnt_range[joint] if model.jnt_limited[joint] else usual_rad
        range_rad = range_rad if own.range_deg is None else np.radians(own.range_deg)
        speed = USUAL_SPEED_RAD_S["neck" if name in designed.neck else "eyes"]
        speed = speed if own.speed_deg_s is None else float(np.radians(own.speed_deg_s))
        by_joint[name] = range_rad, speed
    limited = np.flatnonzero(model.tendon_limited)
    tendons = {reading_name(model.tendon(k).name): model.tendon_range[k] for k in limited}
    limits = [by_joint[name] for name in designed.neck]
    for r, name in enumerate(kinematics.readings):
        ranges, speeds = [np.array([-np.inf, np.inf])], [np.inf]
        for eye, joints in designed.eyes.items():
            chain = kinematics.chains[eye]
            for k in np.flatnonzero(chain.mixing[:, r]):
                share = chain.mixing[k, r] * np.count_nonzero(chain.mixing[k])
                range_rad, speed = by_joint[joints[k]]
                ranges.append(np.sort((range_rad - chain.offset_rad[k]) / share))
                speeds.append(speed / abs(share))
        lower, upper = tendons.get(name, (np.max(ranges, axis=0)[0], np.min(ranges, axis=0)[1]))
        limits.append((np.array([lower, max(lower, upper)]), min(speeds)))
    ranges = np.reshape([range_rad for range_rad, _ in limits], (-1, 2))
    speeds = np.array([speed for _, speed in limits])
    return JointLimits(ranges, speeds, posture_joints(designed.head))
