"""From the MJCF model to a nominal head, to an as-built head, and back to a compiled model.

The names that the model uses are looked up here and nowhere else.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration, MountedCamera, base_pose, pair_names
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import EYES, Kinematics, Side
from vergence.geometry.neck import Neck
from vergence.geometry.se3 import pose, rotation
from vergence.twin.profile import ErrorProfile, Lens
from vergence.twin.scene import Scene, load_spec

NECK_JOINTS = "neck_pitch", "neck_roll", "neck_yaw"
CAMERAS = ("left_wide", "right_wide", "left_narrow", "right_narrow")

R_MJCAM_CAM = np.diag([1.0, -1.0, -1.0])  # MuJoCo's cameras look along -z with +y up

FOCAL_MM: dict[Lens, float] = {"2.8mm": 2.8, "4.0mm": 4.0}
# Barrel distortion that is usual for such lenses on a 1/2" sensor: 10 % and 4 % at the edge.
DISTORTION: dict[Lens, tuple[float, ...]] = {
    "2.8mm": (-0.12, 0.02, 0.0005, -0.0005, 0.0),
    "4.0mm": (-0.09, 0.015, 0.0005, -0.0005, 0.0),
}


LEAST_JOINTS = 2
"""Fewest joints of an eye: those of the MJCF file."""


def hinges(kinematics: Kinematics) -> dict[Side, list[str]]:
    """Name the model's joints by eye, from the head outwards; those after the second are added."""
    return {
        eye: [
            f"{eye}_pan",
            f"{eye}_tilt",
            *(f"{eye}_joint_{k + 1}" for k in range(LEAST_JOINTS, len(kinematics.eyes[eye]))),
        ]
        for eye in EYES
    }


def nominal_head(lens: Lens, kinematics: Kinematics | None = None) -> HeadCalibration:
    """Build the head as designed, with a lens in the wide cameras.

    Without kinematics an eye pans, then tilts. VergenceError if an eye has fewer than two joints.
    """
    kinematics = kinematics or Kinematics()
    for eye, joints in kinematics.eyes.items():
        if len(joints) < LEAST_JOINTS:
            raise VergenceError(
                f"An eye of the twin has {LEAST_JOINTS} joints or more, the {eye} one was given "
                f"{len(joints)}."
            )
    spec = load_spec()
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    bases = {eye: data.body(f"{eye}_pan").xpos for eye in EYES}
    body = data.body("body").xpos
    joints = [data.joint(name) for name in NECK_JOINTS]
    cameras = {}
    for name in CAMERAS:
        camera, eye = model.camera(name), EYES[name.startswith("right")]
        width, height = (int(size) for size in model.cam_resolution[camera.id])
        pitch_m = model.cam_sensorsize[camera.id, 0] / width
        wide = name.endswith("wide")
        focal_m = FOCAL_MM[lens] * 1e-3 if wide else model.cam_intrinsic[camera.id, 0]
        matrix = np.diag([focal_m / pitch_m, focal_m / pitch_m, 1.0])
        matrix[:2, 2] = (width - 1) / 2, (height - 1) / 2
        cameras[name] = MountedCamera(
            eye=eye,
            intrinsics=Camera(
                width=width,
                height=height,
                matrix=matrix,
                distortion=np.array(DISTORTION[lens]) if wide else np.zeros(5),
            ),
            T_eye_cam=pose(
                Rotation.from_quat(camera.quat, scalar_first=True).as_matrix() @ R_MJCAM_CAM,
                camera.pos - kinematics.chains[eye].end_m,
            ),
        )
    return HeadCalibration(
        cameras=cameras,
        T_rbase_lbase=pose(t=bases["left"] - bases["right"]),
        kinematics=kinematics,
        neck=Neck(
            axes=np.array([joint.xaxis for joint in joints]),
            points_m=np.array([joint.xanchor - body for joint in joints]),
            head_m=(bases["left"] + bases["right"]) / 2 - body,
            joints=NECK_JOINTS,
        ),
    )


def as_built_head(nominal: HeadCalibration, profile: ErrorProfile, seed: int) -> HeadCalibration:
    """Draw the true head from the nominal one and the standard deviations of a profile.

    All profiles draw the same random numbers.
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
    if mounting.baseline_mm is not None:
        T_rbase_lbase[:3, 3] *= mounting.baseline_mm * 1e-3 / np.linalg.norm(T_rbase_lbase[:3, 3])
    T_rbase_lbase = T_rbase_lbase @ pose(
        rotation(rng.normal(0, np.radians(mounting.base_rotation_deg), 3)),
        rng.normal(0, mounting.base_translation_mm * 1e-3, 3),
    )
    eyes: dict[Side, tuple[Joint, ...]] = {}
    for eye, turn, distance in zip(
        EYES, profile.axes.nonorthogonality_deg, profile.axes.distance_mm, strict=True
    ):
        first, second, *more = nominal.kinematics.eyes[eye]
        second = replace(
            second, nonorthogonality_rad=np.radians(turn), axis_distance_m=distance * 1e-3
        )
        eyes[eye] = first, second, *more
    kinematics = replace(nominal.kinematics, eyes=eyes)
    return replace(nominal, cameras=cameras, T_rbase_lbase=T_rbase_lbase, kinematics=kinematics)


def check_calibration_of(truth: HeadCalibration, calibration: HeadCalibration) -> None:
    """Raise VergenceError if a calibration cannot be that of the twin, given as built.

    Main cameras, readings, baseline and focal lengths are compared.
    """
    names, found = pair_names(truth), ""
    if absent := [name for name in names if name not in calibration.cameras]:
        found = f"it has no camera {absent[0]}, it has {', '.join(calibration.cameras)}"
    elif calibration.kinematics.readings != truth.kinematics.readings:
        found = f"it is moved by {', '.join(calibration.kinematics.readings)}"
    else:
        for what, unit, size in (
            ("its baseline", "mm", lambda head: 1e3 * np.linalg.norm(head.T_rbase_lbase[:3, 3])),
            *(
                (f"{name}.fx", "px", lambda head, n=name: head.cameras[n].intrinsics.matrix[0, 0])
                for name in names
            ),
        ):
            ours, twins = size(calibration), size(truth)
            if abs(ours / twins - 1) > 0.1:  # calibrations err by a few percent
                found = f"{what} is {ours:.1f} {unit}, the twin's {twins:.1f} {unit}"
                break
    if found:
        raise VergenceError(
            f"This calibration is of another head than the twin: {found}. Give the --profile and "
            "the --seed with which its dataset was recorded, with 2.8 mm lenses."
        )


def compile_head(
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
    spec = load_spec(scene)
    if furnish is not None:
        furnish(spec)
    for eye, names in hinges(head.kinematics).items():
        T = base_pose(head, eye)
        chain = head.kinematics.chains[eye]
        # The first joint turns the one body, all others the other.
        base, outer = spec.body(f"{eye}_pan"), spec.body(f"{eye}_eye")
        base.pos = T[:3, 3]
        base.quat = Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)
        for name in names[LEAST_JOINTS:]:
            like = spec.find_default("tilt")
            outer.add_joint(like, name=name)
            joint = mujoco.mjtTrn.mjTRN_JOINT
            spec.add_actuator(like, name=name, target=name, trntype=joint)
        for name, axis, point in zip(names, chain.axes, chain.points_m, strict=True):
            hinge = spec.joint(name)
            hinge.axis = axis
            hinge.pos = point
    for name, mounted in head.cameras.items():
        camera, T = spec.camera(name), mounted.T_eye_cam
        nominal_width = camera.resolution[0]
        # Its body stands at the origin of the eye's base, not at the end of the chain.
        camera.pos = head.kinematics.chains[mounted.eye].end_m + T[:3, 3]
        camera.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        R_eye_mjcam = T[:3, :3] @ R_MJCAM_CAM
        camera.quat = Rotation.from_matrix(R_eye_mjcam).as_quat(scalar_first=True)
        intrinsics, size = mounted.intrinsics, np.array(overscan[name])
        centre = (np.array(intrinsics.size) - 1) / 2
        camera.sensor_size = camera.sensor_size[0] / nominal_width * size
        camera.resolution = size
        camera.focal_pixel = intrinsics.matrix[[0, 1], [0, 1]]
        camera.focal_length = [0, 0]
        camera.principal_pixel = centre - intrinsics.matrix[:2, 2]
    return spec.compile()


def body_pose(data: mujoco.MjData, name: str) -> Array:
    """Compute the pose (4, 4) of a body in the world."""
    body = data.body(name)
    return pose(body.xmat.reshape(3, 3), body.xpos)
