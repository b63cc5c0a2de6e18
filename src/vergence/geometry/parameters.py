"""A head as a vector of named parameters: what is estimated, and what covariances speak of.

For each camera fx, fy, cx, cy [px], k1, k2, p1, p2, k3 and the 6 increments of T_eye_cam; the 6
increments of T_rbase_lbase; the 6 fields of EyeAxes for each eye; the time offset [s]. Poses change
by `se3.boxplus`: rotation [rad], then translation [m], along the axes of the frame that they map
into.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry import se3
from vergence.geometry.camera import Camera
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import AXES, EYES, EyeAxes, axes_row, eye_chain
from vergence.geometry.se3 import pose, rotation

INTRINSICS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
POSE = ("rx", "ry", "rz", "tx", "ty", "tz")
PER_CAMERA = len(INTRINSICS) + len(POSE)


def parameter_names(cameras: Iterable[str]) -> tuple[str, ...]:
    """Return the names of the parameters of a head with these cameras, in their order."""
    own = (*INTRINSICS, *(f"T_eye_cam.{name}" for name in POSE))
    return (
        *(f"{camera}.{name}" for camera in cameras for name in own),
        *(f"T_rbase_lbase.{name}" for name in POSE),
        *(f"{eye}.{name}" for eye in EYES for name in AXES),
        "time_offset_s",
    )


def camera_columns(head: HeadCalibration, camera: str) -> np.ndarray:
    """Return which parameters (27,) the pixels of a camera depend on.

    Those of its lens, of T_eye_cam, of T_rbase_lbase and of the axes of its eye.
    """
    own = PER_CAMERA * list(head.cameras).index(camera) + np.arange(PER_CAMERA)
    base = PER_CAMERA * len(head.cameras) + np.arange(len(POSE))
    axes = base[-1] + 1 + len(AXES) * EYES.index(head.cameras[camera].eye) + np.arange(len(AXES))
    return np.concatenate([own, base, axes])


def lens_vector(camera: Camera) -> Array:
    """Return (9,) in the order of INTRINSICS."""
    K = camera.matrix
    return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *camera.distortion])


def lens_of_vector(camera: Camera, values: Array) -> Camera:
    """Return a camera with other values (9,); ValueError if a focal length is not positive."""
    fx, fy, cx, cy, *distortion = values
    matrix = np.array([[fx, camera.matrix[0, 1], cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return replace(camera, matrix=matrix, distortion=np.array(distortion))


def boxplus(head: HeadCalibration, change: Array) -> HeadCalibration:
    """Return a head whose parameters are changed by (c,), in the order of parameter_names.

    ValueError if a focal length would not stay positive.
    """
    C = len(head.cameras)
    own, rest = change[: PER_CAMERA * C].reshape(C, PER_CAMERA), change[PER_CAMERA * C :]
    cameras = {
        name: replace(
            mounted,
            intrinsics=lens_of_vector(
                mounted.intrinsics, lens_vector(mounted.intrinsics) + row[: len(INTRINSICS)]
            ),
            T_eye_cam=se3.boxplus(mounted.T_eye_cam, row[len(INTRINSICS) :]),
        )
        for (name, mounted), row in zip(head.cameras.items(), own, strict=True)
    }
    axes = {
        eye: EyeAxes(*(axes_row(head.axes[eye]) + row).tolist())
        for eye, row in zip(EYES, rest[6:18].reshape(2, len(AXES)), strict=True)
    }
    return replace(
        head,
        cameras=cameras,
        T_rbase_lbase=se3.boxplus(head.T_rbase_lbase, rest[:6]),
        axes=axes,
        time_offset_s=head.time_offset_s + float(rest[18]),
    )


def change_named(head: HeadCalibration, names: Sequence[str], change: Array) -> HeadCalibration:
    """Return a head with named parameters changed by (c,); VergenceError: an unknown name."""
    known = {name: k for k, name in enumerate(parameter_names(head.cameras))}
    unknown = [name for name in names if name not in known]
    if unknown:
        raise VergenceError(f"This head has no parameter {unknown[0]!r}.")
    full = np.zeros(len(known))
    full[[known[name] for name in names]] = change
    return boxplus(head, full)


def boxminus(head: HeadCalibration, reference: HeadCalibration) -> dict[str, float]:
    """Return by name how much each parameter of a head differs from that of a reference.

    Offsets of the joints are counted as turns of the bases and mountings: see without_offsets. The
    reference has at least the same cameras.
    """
    head, reference = without_offsets(head), without_offsets(reference)
    others = {name: reference.camera(name) for name in head.cameras}
    values = _vector(head) - _vector(replace(reference, cameras=others))
    poses = [
        se3.boxminus(mounted.T_eye_cam, others[name].T_eye_cam)
        for name, mounted in head.cameras.items()
    ]
    between = se3.boxminus(head.T_rbase_lbase, reference.T_rbase_lbase)
    values[np.isnan(values)] = np.concatenate([*poses, between])
    return dict(zip(parameter_names(head.cameras), values.tolist(), strict=True))


def parameter_values(head: HeadCalibration) -> dict[str, float | None]:
    """Return by name the value of each parameter; None for those of poses."""
    values = [None if np.isnan(value) else value for value in _vector(head).tolist()]
    return dict(zip(parameter_names(head.cameras), values, strict=True))


def _vector(head: HeadCalibration) -> Array:
    """Return (c,) the values of the parameters; NaN for those of poses."""
    pose = np.full(len(POSE), np.nan)
    own = [part for each in head.cameras.values() for part in (lens_vector(each.intrinsics), pose)]
    axes = [axes_row(head.axes[eye]) for eye in EYES]
    return np.concatenate([*own, pose, *axes, [head.time_offset_s]])


def without_offsets(head: HeadCalibration) -> HeadCalibration:
    """Return a head that does the same without offsets of its joints.

    Rz(pan + o) = Rz(o) Rz(pan) turns the base frame; an offset of tilt, whose axis is fixed behind
    pan, turns the mountings of the cameras. Two calibrations can be compared only in the same
    choice, and this is the one that bundle adjustment makes.
    """
    axes, bases, mounts = {}, {}, {}
    for eye in EYES:
        own = head.axes[eye]
        chain = eye_chain(own)
        bases[eye], mounts[eye] = (
            pose(R) for R in rotation(chain.offset_rad[:, None] * chain.axes)
        )
        axes[eye] = replace(own, pan_offset_rad=0.0, tilt_offset_rad=0.0)
    cameras = {
        name: replace(mounted, T_eye_cam=mounts[mounted.eye] @ mounted.T_eye_cam)
        for name, mounted in head.cameras.items()
    }
    T_rbase_lbase = bases["right"].T @ head.T_rbase_lbase @ bases["left"]
    return replace(head, cameras=cameras, axes=axes, T_rbase_lbase=T_rbase_lbase)
