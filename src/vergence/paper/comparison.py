"""Self-calibration beside the paper's method, on the same images and readings of a replay."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration
from vergence.self_calibration.frame import from_matches, locate_seen, self_calibrate_frame
from vergence.self_calibration.learning import learn
from vergence.self_calibration.state import (
    SelfCalibrated,
    SelfCalibration,
    initial_self_calibration,
)
from vergence.twin.head import Twin
from vergence.twin.looking_around import look_around
from vergence.twin.sensors import with_sensors
from vergence.vision.sphere import STD_PX

PAPER, SINGLE, LEARNED, FLOOR = "paper", "single-frame", "learned", "floor"
_KNOWN = 1e-8
"""Share of the prior's covariance that is left where the true head is given."""


@dataclass(eq=False)
class Comparison:
    """Self-calibration of one lens, fed frame by frame."""

    states: dict[str, SelfCalibration]
    """What is known of the head, by method; that of `learned` changes with every frame."""
    points: dict[str, list[Array]] = field(default_factory=dict)
    """Position (3,) [m] in frame lbase of each sample, by method; NaN: not located."""
    stds: dict[str, list[float]] = field(default_factory=dict)
    """Stated standard deviation of depth [m] of each sample, by method."""
    last: dict[str, SelfCalibrated] = field(default_factory=dict)
    """Head and joints of the last frame, by method."""
    _time_s: float | None = None

    def begin(self) -> None:
        """Begin a figure: what was learned stays."""
        self.points = {method: [] for method in self.states}
        self.stds = {method: [] for method in self.states}
        self._time_s = None

    def add(
        self, images: Mapping[str, np.ndarray], joints: Array, pixels: Mapping[str, Array], t: float
    ) -> None:
        """Locate the object in a sample, by its pixels (2,) in both images, at a time [s]."""
        left, right = self.states[SINGLE].cameras
        first = self_calibrate_frame(self.states[SINGLE], images[left], images[right], joints)
        for method, state in self.states.items():
            seen = first
            if method != SINGLE:
                seen = from_matches(state, first.matches, joints, images=first.images)
            found = locate_seen(
                seen, left=pixels[left][None], right=pixels[right][None], pixel_std_px=STD_PX
            )
            self.points[method].append(found.xyz[0])
            self.stds[method].append(float(np.sqrt(found.covariance[0, 0, 0])))
            self.last[method] = seen
        if LEARNED in self.states:
            elapsed_s = 0.0 if self._time_s is None else t - self._time_s
            self.states[LEARNED] = learn(self.states[LEARNED], self.last[LEARNED], elapsed_s)
        self._time_s = t


def comparison(head: HeadCalibration, twin: Twin, *, floor: bool) -> Comparison:
    """Return a comparison for a calibration; floor: also with the true head, for evaluation."""
    before = initial_self_calibration(head, fresh=True)  # the twin was calibrated for this
    states = {SINGLE: before, LEARNED: before}
    if floor:
        known = initial_self_calibration(with_sensors(twin.truth, twin.profile.joints))
        states[FLOOR] = replace(known, covariance=known.covariance * _KNOWN)
    return Comparison(states)


def learn_around(twin: Twin, compared: Comparison, run: int) -> None:
    """Let the learned head see the room alone; see `looking_around.look_around`."""
    before: float | None = None
    for frame in look_around(twin, compared.states[LEARNED].cameras, run=run):
        state = compared.states[LEARNED]
        left, right = (frame.images[name] for name in state.cameras)
        seen = self_calibrate_frame(state, left, right, frame.eye_angles)
        elapsed_s = 0.0 if before is None else frame.time_s - before
        compared.states[LEARNED], before = learn(state, seen, elapsed_s), frame.time_s
