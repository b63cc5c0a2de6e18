"""The names of the parameters of a head, in their order: see `geometry.parameters`."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

from vergence.geometry.camera import Camera
from vergence.geometry.kinematics import EYES, Kinematics, Side
from vergence.geometry.lens import COEFFICIENTS

PINHOLE = ("fx", "fy", "cx", "cy")
POSE = ("rx", "ry", "rz", "tx", "ty", "tz")


def intrinsics_names(camera: Camera) -> tuple[str, ...]:
    """List the names of a camera's intrinsics: fx, fy, cx, cy, k1, ..., in their order."""
    return (*PINHOLE, *COEFFICIENTS[camera.model])


def joint_names(kinematics: Kinematics, eye: Side) -> tuple[str, ...]:
    """List the names of the parameters of an eye's joints, such as left.pan_gain."""
    joints = kinematics.eyes[eye]
    return tuple(f"{eye}.{joints[k].name}_{name}" for k, name in kinematics.parameters[eye])


def names_of(cameras: Mapping[str, Camera], kinematics: Kinematics) -> tuple[str, ...]:
    """List the names of the parameters of a head with these cameras and joints."""
    lenses = tuple((name, intrinsics_names(camera)) for name, camera in cameras.items())
    return _names(lenses, tuple(name for eye in EYES for name in joint_names(kinematics, eye)))


@lru_cache(maxsize=64)
def _names(
    lenses: tuple[tuple[str, tuple[str, ...]], ...], joints: tuple[str, ...]
) -> tuple[str, ...]:
    """List the names of all parameters, by those of each camera's lens and of the joints.

    Remembered, since heads that an estimate changes many times a second keep theirs.
    """
    poses = tuple(f"T_eye_cam.{name}" for name in POSE)
    return (
        *(f"{camera}.{name}" for camera, lens in lenses for name in (*lens, *poses)),
        *(f"T_rbase_lbase.{name}" for name in POSE),
        *joints,
        "time_offset_s",
    )
