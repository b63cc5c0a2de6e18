"""Roles of cameras: the one with which an eye looks around, and the one in which it centres."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration, cameras_of, main_camera
from vergence.geometry.kinematics import EYES, Side


@dataclass(frozen=True)
class EyeCameras:
    """The cameras of one eye by their roles; an eye with one camera has it in both."""

    wide: str
    """Name of the camera that looks around: in it an object is searched for."""
    narrow: str
    """Name of the camera that is turned until the object is at its principal point."""


def default_roles(calibration: HeadCalibration) -> dict[Side, EyeCameras]:
    """Return the roles of a head's cameras by eye, for the eyes that have cameras.

    An eye looks around with its main camera, which is the wide one where there is one of this name,
    and centres objects in its narrow one, or in its main one where none is called so.
    """
    roles: dict[Side, EyeCameras] = {}
    for eye in EYES:
        own = cameras_of(calibration, eye)
        if own:
            wide, narrow = main_camera(own, eye), f"{eye}_narrow"
            roles[eye] = EyeCameras(wide=wide, narrow=narrow if narrow in own else wide)
    return roles


def check_roles(calibration: HeadCalibration, roles: Mapping[Side, EyeCameras]) -> None:
    """Raise a VergenceError unless the eyes have the cameras that are to play the roles."""
    if not roles or not set(roles) <= set(EYES):
        asked = ", ".join(map(repr, roles)) or "none"
        raise VergenceError(
            f"Roles of cameras are given by eye, for one or both of {', '.join(EYES)}; found "
            f"{asked}."
        )
    for eye, cameras in roles.items():
        own = cameras_of(calibration, eye)
        for role, name in vars(cameras).items():
            if name not in own:
                there = f"has {', '.join(own)}" if own else "has no camera"
                raise VergenceError(
                    f"The {role} camera of the {eye} eye should be {name!r}, but this eye {there}; "
                    f"this head's cameras are {', '.join(calibration.cameras)}."
                )
