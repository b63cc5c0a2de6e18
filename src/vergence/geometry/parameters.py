"""The numbers of a head by their names, as covariances speak of them: differences and changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle.problem import (
    AXES,
    PER_CAMERA,
    axes_row,
    calibration_names,
    changed_lens,
    lens_vector,
    moved,
    pose_difference,
)
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration, MountedCamera
from vergence.geometry.kinematics import EYES, EyeAxes
from vergence.geometry.se3 import pose, rotation


def without_offsets(head: HeadCalibration) -> HeadCalibration:
    """Return a head that does the same without offsets of its joints.

    Rz(pan + o) = Rz(o) Rz(pan) turns the base frame; an offset of tilt, whose axis is fixed behind
    pan, turns the mountings of the cameras. Two calibrations can be compared only in the same
    choice, and this is the one that `refine` makes.
    """
    axes, turned, mounts = {}, {}, {}
    for eye in EYES:
        own = head.axes[eye]
        across = np.array([0, np.cos(own.nonorthogonality_rad), np.sin(own.nonorthogonality_rad)])
        turned[eye] = pose(rotation(np.array([0.0, 0.0, own.pan_offset_rad])))
        mounts[eye] = pose(rotation(own.tilt_offset_rad * across))
        axes[eye] = replace(own, pan_offset_rad=0.0, tilt_offset_rad=0.0)
    cameras = {
        name: replace(mounted, T_eye_cam=mounts[mounted.eye] @ mounted.T_eye_cam)
        for name, mounted in head.cameras.items()
    }
    T_rbase_lbase = turned["right"].T @ head.T_rbase_lbase @ turned["left"]
    return replace(head, cameras=cameras, axes=axes, T_rbase_lbase=T_rbase_lbase)


def difference(head: HeadCalibration, reference: HeadCalibration) -> dict[str, float]:
    """Return by name how much each parameter of a head differs from that of a reference.

    Args:
        head: whose cameras are compared; offsets of the joints are as without_offsets has them.
        reference: with at least the same cameras.
    """
    head, reference = without_offsets(head), without_offsets(reference)
    values: list[float] = []
    for name, mounted in head.cameras.items():
        other = reference.camera(name)
        values.extend(lens_vector(mounted.intrinsics) - lens_vector(other.intrinsics))
        values.extend(pose_difference(mounted.T_eye_cam, other.T_eye_cam))
    values.extend(pose_difference(head.T_rbase_lbase, reference.T_rbase_lbase))
    for eye in EYES:
        values.extend(np.subtract(axes_row(head.axes[eye]), axes_row(reference.axes[eye])))
    values.append(head.time_offset_s - reference.time_offset_s)
    names = calibration_names(tuple(head.cameras))
    return dict(zip(names, map(float, values), strict=True))


def values_of(head: HeadCalibration) -> dict[str, float | None]:
    """Return by name the value of each parameter; None for those of poses."""
    values: list[float | None] = []
    for mounted in head.cameras.values():
        values += [*map(float, lens_vector(mounted.intrinsics)), *[None] * 6]
    values += [None] * 6
    for eye in EYES:
        values += axes_row(head.axes[eye])
    values.append(head.time_offset_s)
    return dict(zip(calibration_names(tuple(head.cameras)), values, strict=True))


def changed(head: HeadCalibration, parameters: Sequence[str], change: Array) -> HeadCalibration:
    """Return a head with the named parameters changed by (c,).

    Raises:
        VergenceError: a parameter has an unknown name.
    """
    names = calibration_names(tuple(head.cameras))
    by = np.zeros(len(names))
    for name, amount in zip(parameters, change, strict=True):
        if name not in names:
            raise VergenceError(f"This head has no parameter {name!r}.")
        by[names.index(name)] = amount
    own = by[: PER_CAMERA * len(head.cameras)].reshape(-1, PER_CAMERA)
    rest = by[PER_CAMERA * len(head.cameras) :]
    cameras = {
        name: MountedCamera(
            eye=mounted.eye,
            intrinsics=changed_lens(mounted.intrinsics, row[:9]),
            T_eye_cam=moved(mounted.T_eye_cam, row[9:]),
        )
        for (name, mounted), row in zip(head.cameras.items(), own, strict=True)
    }
    rows = rest[6:18].reshape(2, len(AXES))
    axes = {
        eye: EyeAxes(*map(float, np.add(axes_row(head.axes[eye]), row)))
        for eye, row in zip(EYES, rows, strict=True)
    }
    return replace(
        head,
        cameras=cameras,
        T_rbase_lbase=moved(head.T_rbase_lbase, rest[:6]),
        axes=axes,
        time_offset_s=head.time_offset_s + float(rest[18]),
    )
