"""The geometry of a head frame after frame, by what both its eyes see, with what was learned.

A head that runs takes this way from a frame to a corrected geometry: the gaze, dense depth and
recordings do. A frame is estimated with what the frames before it have taught, and then taught
from. Experiments that compare estimates of the same matches take the steps one by one
(`frame`, `learning`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration
from vergence.geometry.neck import checked_neck_angles
from vergence.self_calibration.frame import self_calibrate_frame
from vergence.self_calibration.learning import learn, without_reports
from vergence.self_calibration.prior import Changed
from vergence.self_calibration.state import (
    FrameEstimate,
    SelfCalibration,
    initial_self_calibration,
)
from vergence.self_calibration.update import drifted

Geometry = Literal["joints", "seen"]
"""What tells how the eyes stand to each other: the calibration and the joint readings, or these
corrected by what both eyes see."""
LEARNING_S = 0.1
"""Least time between frames from which is learned. Frames that follow each other more closely show
the same features with the same errors: they are no independent measurements."""
MOVED_RAD = float(np.radians(1.0))
"""Least change of a reading between them, for the same reason: about half the width of the windows
that are matched. Eyes at rest see the same again. With two degrees five seconds teach less: the
spread of depth in Fig. 6, which comes next, was then up to 1.4 times as large."""
_NECK_STDS = 3.0
"""Change of a reading of the neck, in standard deviations of the eyes' readings, from which the
head has moved: then not only eyes have turned, and features are not tracked."""
_SLACK_S = 1e-6  # so that rounding of time stamps drops no frame


@dataclass(frozen=True, eq=False)
class SeenGeometry:
    """What is known of a head after some frames."""

    known: SelfCalibration
    """What persists at the latest frame: learned from all frames so far, with the drift since."""
    latest: FrameEstimate | None = None
    """Head and joint angles at the latest frame, with what was known before it; None: no frame."""
    time_s: float | None = None
    """Time of the latest frame [s]."""
    learned_s: float | None = None
    """Time of the latest frame from which was learned [s]; at the beginning that of the first."""
    learned_at: Array | None = None
    """(r,) its readings [rad]."""
    keyframe_neck: Array | None = None
    """(3,) readings of the neck at the keyframe from which features are tracked [rad]."""


def initial_seen_geometry(
    head: HeadCalibration,
    *,
    cameras: tuple[str, str] | None = None,
    changed: Changed = "little",
) -> SeenGeometry:
    """Return what is known of a head before its first frame.

    Arguments and errors are those of `state.initial_self_calibration`.
    """
    return SeenGeometry(initial_self_calibration(head, cameras=cameras, changed=changed))


def update_geometry(
    before: SeenGeometry, frame: Frame, joints: Array | None = None
) -> SeenGeometry:
    """Return the geometry after a frame: `latest` is the frame's own, `known` has learned from it.

    From frames less than LEARNING_S apart, or at the same posture to MOVED_RAD, `known` does not
    learn, and so not before the eyes have moved. Time that goes back, as where another run begins,
    counts as none.

    Args:
        before: after the frame before.
        frame: with an image of each camera of the pair.
        joints: (r,) readings at the moment of the images [rad]; None: the frame's.

    Raises:
        VergenceError: an image is missing, or the time or the angles of the neck are not finite;
            others are those of `frame.self_calibrate_frame`.
    """
    cameras = before.known.cameras
    for name in cameras:
        if name not in frame.images:
            raise VergenceError(
                f"The geometry is seen by {' and '.join(cameras)}; the frame has images of "
                f"{', '.join(frame.images) or 'no camera'}."
            )
    left, right = (frame.images[name] for name in cameras)
    neck = checked_neck_angles(frame.neck_angles)
    before = _keyframe_while_neck_rests(before, neck)
    joints = frame.eye_angles if joints is None else joints
    before = just_before(before, frame.time_s)
    latest = self_calibrate_frame(before.known, left, right, joints)
    return after_frame(before, latest, neck)


def _keyframe_while_neck_rests(before: SeenGeometry, neck: Array) -> SeenGeometry:
    """Return the geometry without a keyframe from before a motion of the neck (3,) [rad]."""
    rests = before.keyframe_neck is not None and bool(
        np.abs(neck - before.keyframe_neck).max() <= _NECK_STDS * before.known.joint_std_rad
    )
    return before if rests else replace(before, known=replace(before.known, keyframe=None))


def just_before(before: SeenGeometry, time_s: float) -> SeenGeometry:
    """Return the geometry just before a frame at a time [s]: the head may have drifted meanwhile.

    VergenceError if the time is not finite.
    """
    if not np.isfinite(time_s):
        raise VergenceError(f"The time of a frame is a finite number of seconds; found {time_s:g}.")
    elapsed_s = 0.0 if before.time_s is None else max(time_s - before.time_s, 0.0)
    return replace(before, known=drifted(before.known, elapsed_s), time_s=time_s)


def after_frame(before: SeenGeometry, latest: FrameEstimate, neck: Array) -> SeenGeometry:
    """Return the geometry after a frame that was estimated with what was known before it.

    A frame in which too little was seen teaches nothing.

    Args:
        before: `just_before` the frame.
        latest: the frame, of `frame.self_calibrate_frame`.
        neck: (3,) readings of the neck [rad].
    """
    known, time_s, joints = without_reports(before.known), before.time_s, latest.readings
    if time_s is None or before.learned_s is None or before.learned_at is None:
        return SeenGeometry(known, latest, time_s, time_s, joints, neck)
    elapsed_s = time_s - before.learned_s
    turned = known.head.kinematics.factors * (joints - before.learned_at)
    at_rest = np.abs(turned).max() < MOVED_RAD
    nothing_seen = latest.evidence is None
    if at_rest or nothing_seen or 0 < elapsed_s < LEARNING_S - _SLACK_S:
        return replace(before, known=known, latest=latest)
    learned = learn(known, latest)
    key, last = learned.keyframe, known.keyframe
    same = key is not None and last is not None and key.images is last.images
    at_keyframe = before.keyframe_neck if same else neck
    return SeenGeometry(learned, latest, time_s, time_s, joints, at_keyframe)
