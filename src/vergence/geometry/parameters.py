"""A head as a vector of named parameters: what is estimated, and what covariances speak of.

For each camera the intrinsics (`camera.intrinsics_names`) and the increments of T_eye_cam; those of
T_rbase_lbase; for each eye the errors of its joints (`joints.joint_parameters`), such as
left.pan_gain; the time offset [s]. Poses change by `se3.boxplus`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from vergence.arrays import MAX_M, Array, replace_unchecked
from vergence.errors import VergenceError
from vergence.geometry import se3
from vergence.geometry.camera import MAX_NUMBER, MIN_FOCAL_PX, Camera
from vergence.geometry.head import HeadCalibration, MountedCamera, parameter_names
from vergence.geometry.joints import change_joints, joint_value
from vergence.geometry.kinematics import EYES, Kinematics
from vergence.geometry.lens import PINHOLE
from vergence.geometry.se3 import POSE, inverse, pose, rotation


def named_columns(head: HeadCalibration, names: Sequence[str]) -> list[int]:
    """Find named parameters among all of a head; VergenceError: an unknown name."""
    known = _places(parameter_names(head))
    if unknown := [name for name in names if name not in known]:
        raise VergenceError(f"This head has no parameter {unknown[0]!r}.")
    return [known[name] for name in names]


@lru_cache(maxsize=64)
def _places(names: tuple[str, ...]) -> dict[str, int]:
    return {name: k for k, name in enumerate(names)}


def is_gain(name: str) -> bool:
    """Check whether a parameter is the gain of a joint, or the factor of one of its readings."""
    owner, _, own = name.partition(".")
    return owner in EYES and (own.endswith("_gain") or "_factor_" in own)


def camera_columns(head: HeadCalibration, camera: str) -> np.ndarray:
    """Find the parameters (n + 12 + a,) that the pixels of a camera depend on.

    The n of its lens, those of T_eye_cam and of T_rbase_lbase, and the a of the joints of its eye.
    """
    owners = camera, "T_rbase_lbase", head.cameras[camera].eye
    return np.array(_owned(parameter_names(head), owners))


@lru_cache(maxsize=64)
def _owned(names: tuple[str, ...], owners: tuple[str, ...]) -> tuple[int, ...]:
    return tuple(
        k for owner in owners for k, name in enumerate(names) if name.startswith(f"{owner}.")
    )


def _size(mounted: MountedCamera) -> int:
    return len(PINHOLE) + len(mounted.intrinsics.distortion) + len(POSE)


def lens_vector(camera: Camera) -> Array:
    """Collect the intrinsics (n,) in the order of intrinsics_names."""
    K = camera.matrix
    return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *camera.distortion])


def lens_of_vector(camera: Camera, values: Array) -> Camera:
    """Make a camera with other values (n,); ValueError if a focal length is not positive."""
    fx, fy, cx, cy, *distortion = values
    matrix = np.array([[fx, camera.matrix[0, 1], cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    new = {"matrix": matrix, "distortion": np.array(distortion)}
    possible = min(fx, fy) >= MIN_FOCAL_PX and np.abs(values).max() <= MAX_NUMBER
    return replace_unchecked(camera, **new) if possible else replace(camera, **new)  # says why not


def boxplus(head: HeadCalibration, change: Array) -> HeadCalibration:
    """Change the parameters of a head by (c,), in the order of parameter_names.

    ValueError if a focal length would not stay positive, or a change is not possible.
    """
    if not change.any():
        return head
    if not np.isfinite(change).all():
        raise ValueError("the parameters of a head change by finite numbers, found NaN or infinity")
    whole, first = {}, 0
    for name, mounted in head.cameras.items():
        whole[name] = change[first : first + _size(mounted)]
        first += _size(mounted)
    moved = {name: own for name, own in whole.items() if own.any()}
    between, rest = change[first : first + len(POSE)], change[first + len(POSE) :]
    T = np.stack([*(head.cameras[name].T_eye_cam for name in moved), head.T_rbase_lbase])
    T = se3.boxplus(T, np.stack([*(own[-len(POSE) :] for own in moved.values()), between]))
    if np.abs(T[:, :3, 3]).max() > MAX_M:
        raise ValueError(f"translations are at most {MAX_M:g} m, found one that is larger")
    cameras = dict(head.cameras)
    for T_eye_cam, (name, own) in zip(T[:-1], moved.items(), strict=True):
        lens = cameras[name].intrinsics
        lens = lens_of_vector(lens, lens_vector(lens) + own[: -len(POSE)])
        cameras[name] = replace_unchecked(cameras[name], intrinsics=lens, T_eye_cam=T_eye_cam)
    eyes = {}
    for eye in EYES:
        count = len(head.kinematics.parameters[eye])
        eyes[eye] = change_joints(head.kinematics.eyes[eye], rest[:count])
        rest = rest[count:]
    kinematics = replace_unchecked(head.kinematics, eyes=eyes)
    changed = replace_unchecked(head, cameras=cameras, T_rbase_lbase=T[-1], kinematics=kinematics)
    later = float(rest[0])
    return replace(changed, time_offset_s=head.time_offset_s + later) if later else changed


def change_named(head: HeadCalibration, names: Sequence[str], change: Array) -> HeadCalibration:
    """Change named parameters of a head by (c,); VergenceError: an unknown name."""
    full = np.zeros(len(parameter_names(head)))
    full[named_columns(head, names)] = change
    return boxplus(head, full)


def change_between(
    head: HeadCalibration, reference: HeadCalibration, names: Sequence[str]
) -> Array:
    """Compute the change (c,) of named parameters from a reference to a head."""
    change = dict(zip(parameter_names(head), _apart(head, reference).tolist(), strict=True))
    return np.array([change[name] for name in names])


def _apart(head: HeadCalibration, reference: HeadCalibration) -> Array:
    """Compute the change of all parameters from a reference to a head: see `boxminus`."""
    parts = []
    for name, mounted in head.cameras.items():
        other = reference.camera(name)
        lens, other_lens = mounted.intrinsics, other.intrinsics
        if lens.model != other_lens.model:
            raise VergenceError(
                f"{name} has a {lens.model} lens here and a {other_lens.model} one there: "
                "coefficients of different lens models cannot be compared."
            )
        parts.append(lens_vector(lens) - lens_vector(other_lens))
        parts.append(se3.boxminus(mounted.T_eye_cam, other.T_eye_cam))
    parts.append(se3.boxminus(head.T_rbase_lbase, reference.T_rbase_lbase))
    parts.append(np.subtract(_joint_values(head), _joint_values(reference)))
    return np.concatenate([*parts, [head.time_offset_s - reference.time_offset_s]])


def boxminus(head: HeadCalibration, reference: HeadCalibration) -> dict[str, float]:
    """Compute by name how much each parameter of a head differs from that of a reference.

    Offsets of the joints are counted as turns of the bases and mountings: see without_offsets. The
    reference has at least the same cameras. VergenceError if a camera has another lens model there.
    """
    head, reference = without_offsets(head), without_offsets(reference)
    return dict(zip(parameter_names(head), _apart(head, reference).tolist(), strict=True))


def parameter_values(head: HeadCalibration) -> dict[str, float | None]:
    """Collect by name the value of each parameter; None for those of poses."""
    pose, lenses = [None] * len(POSE), [lens_vector(c.intrinsics) for c in head.cameras.values()]
    values = [value for lens in lenses for value in (*lens.tolist(), *pose)]
    values += [*pose, *_joint_values(head), head.time_offset_s]
    return dict(zip(parameter_names(head), values, strict=True))


def _joint_values(head: HeadCalibration) -> list[float]:
    return [
        joint_value(head.kinematics.eyes[eye][k], name)
        for eye in EYES
        for k, name in head.kinematics.parameters[eye]
    ]


def redundant_offsets(kinematics: Kinematics) -> set[str]:
    """List the names of offsets that no image shows: see `without_offsets`."""
    return {
        f"{eye}.{joints[k].name}_offset_rad"
        for eye, joints in kinematics.eyes.items()
        for k in (0, -1)
        if joints
    }


def without_offsets(head: HeadCalibration) -> HeadCalibration:
    """Move the offsets of the first and last joints into the bases and mountings.

    Rz(pan + o) = Rz(o) Rz(pan) turns the base frame; an offset of tilt turns the mountings of the
    cameras. No image shows the difference, and bundle adjustment makes this choice.
    """
    eyes, bases, mounts = {}, {}, {}
    for eye in EYES:
        joints, chain = list(head.kinematics.eyes[eye]), head.kinematics.chains[eye]
        bases[eye], mounts[eye] = np.eye(4), np.eye(4)
        if len(joints):
            R = rotation(chain.offset_rad[[0, -1], None] * chain.axes[[0, -1]])
            # About the point of the first axis, and about the origin of the eye.
            around = pose(t=chain.points_m[0])
            bases[eye] = around @ pose(R[0]) @ inverse(around)
            mounts[eye] = pose(R[1]) if len(joints) > 1 else np.eye(4)
            for k in (0, -1):
                joints[k] = replace(joints[k], offset_rad=0.0)
        eyes[eye] = tuple(joints)
    cameras = {
        name: replace(mounted, T_eye_cam=mounts[mounted.eye] @ mounted.T_eye_cam)
        for name, mounted in head.cameras.items()
    }
    T_rbase_lbase = inverse(bases["right"]) @ head.T_rbase_lbase @ bases["left"]
    kinematics = replace(head.kinematics, eyes=eyes)
    return replace(head, cameras=cameras, kinematics=kinematics, T_rbase_lbase=T_rbase_lbase)
