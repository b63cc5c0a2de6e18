"""The interface of a hand on an arm, and the settings and state of the reach controller.

Positions are in frame body, in metres. The object and the marker are measured by the eyes, the
hand by its own encoders. The two measurements differ by the errors of the head's calibration and
of the arm's mounting; names and docstrings say which one is meant.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Protocol

import numpy as np

from vergence.arrays import Array
from vergence.data.table import MAX_DELAY_S
from vergence.errors import VergenceError
from vergence.gaze.commands import HOLD_S
from vergence.gaze.kalman import MotionModel, Track
from vergence.gaze.state import GazeSettings, GazeState, initial_gaze_state
from vergence.self_calibration.sequence import SeenGeometry
from vergence.vision.detector import Detection, Detector
from vergence.vision.sphere import sphere_detector


@dataclass(frozen=True, eq=False)
class HandReading:
    """Pose of the hand by its own encoders."""

    time_s: float
    """Time of the reading."""
    T_body_hand: Array
    """(4, 4) pose; the origin of frame hand is the centre of the grasp, between the fingers."""
    closed: bool = False
    """Whether the fingers have reached the end of their motion."""


@dataclass(frozen=True, eq=False)
class HandCommand:
    """A motion of the hand towards a moving goal, as fast as the arm's limits allow."""

    time_s: float
    """Time at which the motion begins."""
    goal: Array
    """(3,) target position of the hand at that time [m], by its own encoders."""
    velocity: Array
    """(3,) velocity of the goal from then on [m/s]."""
    close: bool = False
    """Whether the fingers close or stay closed; otherwise they open."""


def hand_goal(command: HandCommand, time_s: float) -> tuple[Array, Array]:
    """Return the goal (3,) [m] of a command at a time, and its velocity (3,) [m/s]."""
    elapsed = max(time_s - command.time_s, 0.0)
    velocity = command.velocity if elapsed < HOLD_S else np.zeros(3)
    return command.goal + min(elapsed, HOLD_S) * command.velocity, velocity


class HandDriver(Protocol):
    """The interface of a hand to the controller; the driver enforces the arm's own limits."""

    def read(self) -> HandReading:
        """Return the present pose of the hand."""
        ...

    def command(self, command: HandCommand) -> None:
        """Move towards `hand_goal(command, time)` from now on."""
        ...


class ReachPhase(StrEnum):
    """What the hand is doing."""

    SEEK = "seek"
    """The eyes do not see the object; the hand waits at home, outside the images."""
    TRACK = "track"
    """The eyes follow the object, which is out of reach; the hand waits at home."""
    REACH = "reach"
    """The hand moves to a standoff below the object; its marker is not seen yet."""
    UNSEEN = "unseen"
    """The hand is at the standoff, but its marker is not seen: it waits and does not close."""
    SERVO = "servo"
    """The eyes see object and marker, and the hand moves by the difference between them."""
    CLOSE = "close"
    """The object is between the fingers with sufficient confidence; the fingers close."""
    HELD = "held"
    """The fingers are closed, and the eyes do not see the object elsewhere."""


@dataclass(frozen=True, eq=False)
class ReachSettings:
    """The head, the hand, and the parameters of the reach controller.

    VergenceError if the gaze uses one eye only.
    """

    gaze: GazeSettings
    detect_marker: Detector = field(default_factory=lambda: sphere_detector("blue"))
    """What finds the marker on the hand; the default is this project's model."""
    marker_hand: Array = field(default_factory=lambda: np.array([-0.026, 0.0, -0.052]))
    """(3,) centre of the marker in frame hand [m]; the default is this project's model."""
    home: Array = field(default_factory=lambda: np.array([0.25, -0.25, -0.10]))
    """(3,) where the hand waits, by its encoders [m]: below the field of view."""
    shoulder: Array = field(default_factory=lambda: np.array([-0.02, -0.16, -0.08]))
    """(3,) centre of the arm's workspace [m]."""
    reach_m: float = 0.85
    """Radius of the arm's workspace."""
    reach_margin_m: float = 0.03
    """Hysteresis of that radius: how much farther a hand follows that is already on its way."""
    approach: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    """(3,) unit vector along which the hand approaches: from below, clear of the lines of sight."""
    standoff_m: float = 0.12
    """Distance from the object at which the hand waits until its marker is seen: more than the
    errors of arm and calibration together."""
    clear_m: float = 0.012
    """Clearance across the approach: slightly less than open fingers leave around an object."""
    tolerance_m: float = 0.010
    """Distance of the object from the grasp's centre within which the fingers close on it well."""
    sigmas: float = 2.5
    """Standard deviations that must lie within the tolerance for the hand to close: 99 %."""
    relative_error: float = 0.03
    """Systematic error of the measured difference between object and marker, as a share of the
    distance between them: from the calibration and the attitude of the hand. It is the same in
    every frame, so that no filter averages it out."""
    motion: MotionModel = field(default_factory=lambda: MotionModel(jerk_density=0.04))
    """Motion of an object that a person holds out: 0.2 m/s^2 more or less in a second."""
    unseen_s: float = 0.3
    """Time without a detection of the marker after which the hand counts as not seen."""
    waits_s: float = 0.7
    """Time at the standoff without a detection until the phase becomes UNSEEN."""
    arrived_m: float = 0.02
    """Distance from its goal within which the hand has arrived."""
    escaped_m: float = 0.03
    """Distance of an object from the closed hand from which it is certainly not held."""

    def __post_init__(self) -> None:
        if len(self.gaze.eyes) < 2:
            raise VergenceError(
                f"Reaching needs depth, and so a camera in each eye; the gaze uses the "
                f"{', '.join(self.gaze.eyes)} eye only."
            )


@dataclass(frozen=True, eq=False)
class ReachState:
    """All that the reach controller remembers and reports."""

    phase: ReachPhase
    since_s: float
    """Time at which the phase began."""
    gaze: GazeState
    """State of the gaze controller."""
    command: HandCommand
    """The command in force."""
    readings: tuple[HandReading, ...]
    """The latest readings of the hand, the newest last."""
    cameras: tuple[str, ...]
    """Cameras whose images are requested next."""
    detections: Mapping[str, Detection | None] = field(default_factory=dict)
    """The marker by camera searched in the latest frame; None: not found."""
    target: Track | None = None
    """Object in the coordinates of the hand's encoders: the measured difference between object and
    marker, added to the marker by the encoders. None: they have not been seen together."""
    apart_m: float = np.inf
    """Distance from object to marker when they were last seen together."""
    together_s: float = -np.inf
    """Time at which they were last seen together."""
    inside: bool = False
    """Whether the object is between the open fingers, or may be brought there."""

    @property
    def object(self) -> Array | None:
        """(3,) [m] object in frame body by the eyes, estimated over time."""
        return None if self.gaze.track is None else self.gaze.track.position

    @property
    def approached(self) -> Track | None:
        """The track by which the hand approaches while its marker is not seen.

        By readings, whose noise would shake the hand, only where both eyes see the geometry; by
        commands otherwise.
        """
        seen = self.gaze.geometry is not None and self.gaze.track is not None
        return self.gaze.track if seen else self.gaze.aim

    @property
    def hand(self) -> Array:
        """(3,) [m] hand in frame body by its encoders."""
        return self.readings[-1].T_body_hand[:3, 3]


def target_covariance(settings: ReachSettings, state: ReachState) -> Array:
    """Return the covariance (3, 3) [m^2] of a state's target, with its systematic error."""
    assert state.target is not None
    systematic = (settings.relative_error * state.apart_m) ** 2
    return state.target.covariance[:3, :3] + systematic * np.eye(3)


def with_reading(before: tuple[HandReading, ...], reading: HandReading) -> tuple[HandReading, ...]:
    """Return the readings of the hand with a new one.

    Where its pose is not finite, as when a bus does not answer, the last one stands. VergenceError
    if it is no reading, or there is no last one.
    """
    try:  # a copy, since a driver may write the next pose into the same array
        time_s, T = float(reading.time_s), np.array(reading.T_body_hand, float)
    except (AttributeError, TypeError, ValueError):
        raise VergenceError(
            f"A reading of the hand has a time and a pose (4, 4); found {reading!r:.80}."
        ) from None
    if T.shape != (4, 4):
        raise VergenceError(f"A reading of the hand has a pose (4, 4); found shape {T.shape}.")
    if not (np.isfinite(T).all() and np.isfinite(time_s)):
        if not before:
            raise VergenceError("The first reading of the hand has a finite time and pose.")
        return (*before[:-1], replace(before[-1], closed=reading.closed))
    kept = [each for each in before if time_s - MAX_DELAY_S < each.time_s < time_s]
    return (*kept, replace(reading, T_body_hand=T))


def initial_reach_state(
    settings: ReachSettings,
    posture: Array,
    reading: HandReading,
    time_s: float,
    *,
    geometry: SeenGeometry | None = None,
) -> ReachState:
    """Return the state of head (set points (j,) [rad]) and hand at rest, with nothing seen.

    A geometry is what an earlier run has learned, as of `initial_gaze_state`. VergenceError if the
    posture is not one of this head, or the hand's reading is none.
    """
    gaze = initial_gaze_state(settings.gaze, posture, time_s, geometry=geometry)
    readings = with_reading((), reading)
    rest = HandCommand(time_s, readings[-1].T_body_hand[:3, 3], np.zeros(3))
    return ReachState(ReachPhase.SEEK, time_s, gaze, rest, readings, gaze.cameras)
