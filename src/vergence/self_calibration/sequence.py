"""The geometry of a head frame after frame, by what both its eyes see, with what was learned.

This is the one way from a frame to a corrected geometry: the gaze, dense depth and recordings all
take it. A frame is estimated with what the frames before it have taught, and then taught from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration
from vergence.self_calibration.frame import (
    SelfCalibrated,
    SelfCalibration,
    self_calibrate_frame,
    start,
)
from vergence.self_calibration.learning import learn

Geometry = Literal["joints", "seen"]
"""What tells how the eyes stand to each other: the calibration and the joint readings, or these
corrected by what both eyes see."""


@dataclass(frozen=True, eq=False)
class SeenGeometry:
    """What is known of a head after some frames."""

    known: SelfCalibration
    """What persists, learned from all frames so far."""
    latest: SelfCalibrated | None = None
    """Head and joint angles at the latest frame, with what was known before it; None: no frame."""
    time_s: float | None = None
    """Of the latest frame."""


def seen_geometry(
    head: HeadCalibration, *, cameras: tuple[str, str] | None = None
) -> SeenGeometry:
    """Return what is known of a head before its first frame.

    Args:
        head: with a camera in each eye.
        cameras: names of the left and the right camera that see the scene; None: the main ones.

    Raises:
        VergenceError: the head has one eye.
    """
    return SeenGeometry(start(head, cameras=cameras))


def see(before: SeenGeometry, frame: Frame, joints: Array | None = None) -> SeenGeometry:
    """Return the geometry after a frame: `latest` is the frame's own, `known` has learned from it.

    Time that goes back, as where another run begins, counts as none.

    Args:
        before: after the frame before.
        frame: with an image of each camera of the pair.
        joints: (r,) readings at the moment of the images [rad]; None: the frame's.

    Raises:
        VergenceError: an image is missing, or of another size than the calibration's, or the
            readings are not as many as the head has.
    """
    known = before.known
    joints = frame.eye_angles if joints is None else joints
    readings = known.head.kinematics.readings
    if joints.shape != (len(readings),):
        raise VergenceError(
            f"This head has the joint readings {', '.join(readings)}; found an array of shape "
            f"{joints.shape} in their place."
        )
    for name in known.cameras:
        if name not in frame.images:
            raise VergenceError(
                f"The geometry is seen by {' and '.join(known.cameras)}; the frame has images of "
                f"{', '.join(frame.images) or 'no camera'}."
            )
        lens, found = known.head.camera(name).intrinsics, frame.images[name].shape[:2]
        if found != (lens.height, lens.width):
            raise VergenceError(
                f"The calibration of {name} is for images of {lens.width} x {lens.height} px, but "
                f"the frame's have {found[1]} x {found[0]} px."
            )
    left, right = (frame.images[name] for name in known.cameras)
    latest = self_calibrate_frame(known, left, right, joints)
    elapsed_s = 0.0 if before.time_s is None else max(frame.time_s - before.time_s, 0.0)
    return SeenGeometry(learn(known, latest, elapsed_s), latest, frame.time_s)
