"""Compare self-calibration with the paper's method on the images and readings of a replay."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration
from vergence.self_calibration.calibrator import (
    VisualGeometry,
    initial_visual_geometry,
    predict_geometry,
    update_with_estimate,
)
from vergence.self_calibration.frame import estimate_frame, estimate_from_matches, locate_in_frame
from vergence.self_calibration.prior import initial_state
from vergence.self_calibration.state import FilterState
from vergence.twin.head import Twin
from vergence.twin.sensors import with_sensors
from vergence.vision.sphere import STD_PX

PAPER, SINGLE, LEARNED, FLOOR = "paper", "single-frame", "learned", "floor"


@dataclass(eq=False)
class Comparison:
    """Self-calibration in one figure, fed frame by frame."""

    states: dict[str, FilterState]
    """Prior of the head, by method that does not learn."""
    learning: VisualGeometry
    """What is learned of the head; it changes with every frame."""
    points: dict[str, list[Array]]
    """Position (3,) [m] in frame lbase of each sample, by method; NaN: not located."""

    def add(
        self, images: Mapping[str, np.ndarray], joints: Array, pixels: Mapping[str, Array], t: float
    ) -> None:
        """Locate the object in a sample, by its pixels (2,) in both images, at a time [s]."""
        left, right = self.states[SINGLE].cameras
        first = estimate_frame(self.states[SINGLE], images[left], images[right], joints)
        self.learning = predict_geometry(self.learning, t)
        known = {LEARNED: self.learning.state, **self.states}
        for method, state in known.items():
            seen = first
            if method != SINGLE:
                seen = estimate_from_matches(state, first.matches, joints, images=first.images)
            found = locate_in_frame(
                seen, left=pixels[left][None], right=pixels[right][None], pixel_std_px=STD_PX
            )
            self.points[method].append(found.xyz[0])
            if method == LEARNED:
                self.learning = update_with_estimate(self.learning, seen, np.zeros(3))


def comparison(
    head: HeadCalibration, twin: Twin, learning: VisualGeometry, *, floor: bool
) -> Comparison:
    """Start a comparison for a calibration; `floor` adds self-calibration of the true head."""
    states = {SINGLE: before_looking(head).state}
    if floor:
        known = initial_state(with_sensors(twin.truth, twin.profile.joints))
        states[FLOOR] = replace(known, covariance=known.covariance * 1e-8)
    return Comparison(states, learning, {method: [] for method in (SINGLE, LEARNED, *states)})


def before_looking(head: HeadCalibration) -> VisualGeometry:
    """Start self-calibration of a head before its first frame."""
    return initial_visual_geometry(head, changed="nothing")  # the twin was calibrated for this
