"""Self-calibration frame after frame: each frame is estimated, and then updates the filter."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array, floats, single_blas_thread
from vergence.data.dataset import Frame
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration
from vergence.self_calibration.filter import learned_head, update
from vergence.self_calibration.frame import estimate_frame, locate_in_frame
from vergence.self_calibration.kalman import predict
from vergence.self_calibration.prior import Changed, initial_state
from vergence.self_calibration.state import FilterState, FrameEstimate
from vergence.stereo.uncertainty import LocatedPoints

Geometry = Literal["joints", "seen"]
"""Source of the relative pose of the cameras: calibration and joint readings, or these corrected by
self-calibration."""
UPDATE_S = 0.1
"""Least time between updates: closer frames show the same windows with the same errors."""
MOVED_RAD = float(np.radians(1.0))
"""Least change of a joint angle between updates, about half a window's width; with 2 degrees
learned depth in Fig. 6 spreads by up to 1.4 times as much."""


@dataclass(frozen=True, eq=False)
class VisualGeometry:
    """Filter and latest frame of a head whose geometry is corrected by its images."""

    state: FilterState
    """At the latest frame: updated with the frames so far, or predicted from them."""
    latest: FrameEstimate | None = None
    time_s: float | None = None
    """Time of the latest frame."""
    updated_s: float | None = None
    """Time of the latest frame that updated the filter; at the beginning of the first frame."""
    updated_at: Array | None = None
    """(r,) its readings [rad]."""
    keyframe_neck: Array | None = None
    """(3,) readings of the neck at the keyframe [rad]."""


def initial_visual_geometry(
    head: HeadCalibration, *, cameras: tuple[str, str] | None = None, changed: Changed = "little"
) -> VisualGeometry:
    """Start from a calibration; arguments and errors are those of `prior.initial_state`."""
    return VisualGeometry(initial_state(head, cameras=cameras, changed=changed))


@single_blas_thread()
def update_geometry(
    geometry: VisualGeometry, frame: Frame, joints: ArrayLike | None = None
) -> VisualGeometry:
    """Estimate a frame, and update the filter with it.

    Frames less than UPDATE_S apart, or at the same posture to MOVED_RAD, are estimated only. Time
    that goes back, as where another run begins, counts as no time. Readings (r,) [rad] at the
    moment of the images replace the frame's. VergenceError if an image is missing, or the time or
    the angles of the neck are not finite; others are those of `frame.estimate_frame`.
    """
    cameras = geometry.state.cameras
    for name in cameras:
        if name not in frame.images:
            raise VergenceError(
                f"The geometry is seen by {' and '.join(cameras)}; the frame has images of "
                f"{', '.join(frame.images) or 'no camera'}."
            )
    left, right = (frame.images[name] for name in cameras)
    neck, key = floats("neck_angles", frame.neck_angles), geometry.keyframe_neck
    if not np.isfinite(neck).all():
        raise VergenceError(f"The angles of the neck are finite; found {neck.tolist()}.")
    limit = 3 * geometry.state.reading_std  # then not only the eyes have moved
    if key is None or key.shape != neck.shape or np.abs(neck - key).max(initial=0.0) > limit:
        geometry = replace(geometry, state=replace(geometry.state, keyframe=None))
    geometry = predict_geometry(geometry, frame.time_s)
    joints = frame.eye_angles if joints is None else joints
    return update_with_estimate(geometry, estimate_frame(geometry.state, left, right, joints), neck)


def predict_geometry(geometry: VisualGeometry, time_s: float) -> VisualGeometry:
    """Predict the filter to the time of a frame. VergenceError if it is not finite."""
    if not np.isfinite(time_s):
        raise VergenceError(f"The time of a frame is a finite number of seconds; found {time_s:g}.")
    elapsed_s = 0.0 if geometry.time_s is None else max(time_s - geometry.time_s, 0.0)
    return replace(geometry, state=predict(geometry.state, elapsed_s), time_s=time_s)


def update_with_estimate(
    geometry: VisualGeometry, estimate: FrameEstimate, neck: Array
) -> VisualGeometry:
    """Update the filter, as predicted to a frame's time, with its estimate and neck angles (n,)."""
    state, time_s = replace(geometry.state, change=None), geometry.time_s
    if time_s is None or geometry.updated_s is None or geometry.updated_at is None:
        return VisualGeometry(state, estimate, time_s, time_s, estimate.readings, neck)
    close = 0 < round(time_s - geometry.updated_s, 6) < UPDATE_S
    turned = state.largest_turn_rad(estimate.readings, geometry.updated_at)
    if turned < MOVED_RAD or close or estimate.evidence is None:
        return replace(geometry, state=state, latest=estimate)
    updated = update(state, estimate)
    before, after = state.keyframe, updated.keyframe
    kept = before is not None and after is not None and after.images is before.images
    at_keyframe = geometry.keyframe_neck if kept else neck
    return VisualGeometry(updated, estimate, time_s, time_s, estimate.readings, at_keyframe)


class SelfCalibrator:
    """Correct a head and its joint readings by what both eyes see, frame after frame.

    Example:
        calibrator = vg.SelfCalibrator(vg.load_head("head.json"))
        for frame in frames:  # vg.Frame with the images of both main cameras
            estimate = calibrator.update(frame)
            # estimate.head and estimate.joints are for vg.rectify and vg.locate
            points = calibrator.locate(left=left_pixels, right=right_pixels, pixel_std_px=0.1)
            if calibrator.change:
                print(calibrator.change)  # a camera was turned, or the head is not as calibrated
        vg.save_head(calibrator.head, "learned.json")
    """

    def __init__(
        self,
        head: HeadCalibration,
        *,
        cameras: tuple[str, str] | None = None,
        changed: Changed = "little",
    ) -> None:
        """Start from a calibration; arguments and errors are those of `prior.initial_state`."""
        self.geometry = initial_visual_geometry(head, cameras=cameras, changed=changed)

    def update(self, frame: Frame, joints: ArrayLike | None = None) -> FrameEstimate:
        """Estimate head and joint angles at a frame, and learn from it.

        The `status` of the estimate is "seen", "little seen" (the prior stands, in part or wholly)
        or "contradiction" (head and readings stand as they were). Readings (r,) [rad] replace the
        frame's. Raises VergenceError if an image is missing or of another size, or readings or
        time are not finite.
        """
        self.geometry = update_geometry(self.geometry, frame, joints)
        assert self.geometry.latest is not None
        return self.geometry.latest

    def locate(
        self,
        *,
        left: Array,
        right: Array,
        pixel_std_px: ArrayLike,
        cameras: tuple[str, str] | None = None,
    ) -> LocatedPoints:
        """Locate points in the latest frame, as `vg.locate`; VergenceError without a frame."""
        if self.geometry.latest is None:
            raise VergenceError("Points are located in the latest frame; update with one first.")
        return locate_in_frame(
            self.geometry.latest, left=left, right=right, pixel_std_px=pixel_std_px, cameras=cameras
        )

    @property
    def head(self) -> HeadCalibration:
        """The learned calibration with its covariance."""
        return learned_head(self.geometry.state)

    @property
    def change(self) -> str | None:
        """Change of the head that the latest frame detected; None: no change."""
        return self.geometry.state.change
