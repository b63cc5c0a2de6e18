"""What drives a hand, what the reach law is told, and what it remembers and says of itself.

Positions are in frame body, in metres: of the object and the marker as the eyes see them, and of
the hand as its own encoders have it. The two do not agree, as neither the head nor the place of
the arm is known exactly; names say which is meant.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

import numpy as np

from vergence.arrays import Array
from vergence.gaze import state
from vergence.gaze.kalman import Track


@dataclass(frozen=True, eq=False)
class HandReading:
    """Where the hand is by its own encoders, which know nothing of what the eyes see."""

    time_s: float
    T_body_hand: Array
    """(4, 4); the origin of frame hand is where the centre of what it grasps should be."""
    closed: bool = False
    """Whether the fingers have come to an end."""


@dataclass(frozen=True, eq=False)
class HandCommand:
    """A motion of the hand: as fast as it can to a goal that itself moves."""

    time_s: float
    """When it begins."""
    goal: Array
    """(3,) where the hand should be at that time [m], by its own encoders."""
    velocity: Array
    """(3,) of the goal from then on [m/s]."""
    close: bool = False
    """Whether the fingers shall close, or stay closed; else they open."""
    hold_s: float = 0.1
    """When the goal stops if no further command comes."""


def hand_goal(command: HandCommand, time_s: float) -> tuple[Array, Array]:
    """Return the goal (3,) [m] of a command at a time, and its velocity (3,) [m/s]."""
    elapsed = max(time_s - command.time_s, 0.0)
    if elapsed < command.hold_s:
        return command.goal + elapsed * command.velocity, command.velocity
    return command.goal + command.hold_s * command.velocity, np.zeros(3)


class Hand(Protocol):
    """What the driver of a hand on an arm implements; it keeps its own limits of speed."""

    def read(self) -> HandReading:
        """Return where the hand is now."""
        ...

    def command(self, command: HandCommand) -> None:
        """Move by this command from now on, towards `hand_goal` of the time."""
        ...


class Phase(StrEnum):
    """What the hand is doing."""

    SEEK = "seek"
    """The eyes do not see the object; the hand waits at home, out of their way."""
    TRACK = "track"
    """The eyes follow the object, which is out of reach; the hand waits at home."""
    REACH = "reach"
    """Under way to a place below where the eyes see the object; the hand is not yet seen."""
    UNSEEN = "unseen"
    """There, but the eyes do not see the hand: it waits, for unseen it cannot be trusted."""
    SERVO = "servo"
    """The eyes see both, and the hand goes by the difference."""
    CLOSE = "close"
    """The object is between the fingers for all that is known; they close."""
    HELD = "held"
    """The fingers are closed and the eyes do not see the object elsewhere."""


@dataclass(frozen=True, eq=False)
class Settings:
    """The head, the hand, and how to use them."""

    gaze: state.Settings
    marker_hand: Array = field(default_factory=lambda: np.array([-0.026, 0.0, -0.052]))
    """(3,) centre of the blue marker in frame hand [m]; the default is this project's model."""
    home: Array = field(default_factory=lambda: np.array([0.25, -0.25, -0.10]))
    """(3,) where the hand waits, by its encoders [m]: below what the eyes see."""
    shoulder: Array = field(default_factory=lambda: np.array([-0.02, -0.16, -0.08]))
    """(3,) about which the arm can reach [m]."""
    reach_m: float = 0.85
    """How far it can."""
    approach: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    """(3,) unit vector along which the hand comes to the object: from below, out of the sight."""
    standoff_m: float = 0.12
    """From the object, where the hand waits until it is seen: more than arm and calibration err."""
    clear_m: float = 0.012
    """Play across the approach: a little less than open fingers leave an object."""
    tolerance_m: float = 0.010
    """Within which the object must be for the fingers to close on it well."""
    sigmas: float = 2.5
    """How sure of it the hand must be to close: 99 %."""
    share: float = 0.03
    """Of a seen distance between object and marker that may be wrong, since calibration and the
    attitude of the hand are not exact. The same in every frame, so that no filter averages it."""
    jerk_density: float = 0.04
    """Of an object that somebody holds out [m^2/s^5]: 0.2 m/s^2 more or less in a second."""
    unseen_s: float = 0.3
    """Without a sight of the marker until the hand counts as not seen."""
    waits_s: float = 0.7
    """At the place where the hand should be seen, until it is said that it is not."""
    arrived_m: float = 0.02
    """From its goal, within which the hand has arrived."""
    escaped_m: float = 0.03
    """From the closed hand, where an object is surely not within it."""
    surprise_limit: float = 60.0
    """Squared distance at which a measurement begins a new track: 3 in the mean."""


@dataclass(frozen=True, eq=False)
class State:
    """All that the reach law remembers, and what it says of itself."""

    phase: Phase
    since_s: float
    """When the phase began."""
    gaze: state.State
    command: HandCommand
    readings: tuple[HandReading, ...]
    """The latest of the hand, and some before it."""
    cameras: tuple[str, ...]
    """Whose images it wants next."""
    pixels: Mapping[str, Array] = field(default_factory=dict)
    """By camera searched in the latest frame: (2,) px of the marker, NaN where not found."""
    marker: Array | None = None
    """(3,) [m] in frame body: where the eyes saw the marker in the latest frame."""
    target: Track | None = None
    """Where the object is by the hand's encoders: where the eyes see it from the marker, and
    where the encoders have the marker. None: object and marker were not seen together."""
    apart_m: float = np.inf
    """From the object to the marker, when last seen together."""
    together_s: float = -np.inf
    """When that was."""
    inside: bool = False
    """Whether the object is between the open fingers, or may be brought there."""

    @property
    def object(self) -> Array | None:
        """(3,) [m] in frame body: where the eyes see the object, fused over time."""
        return None if self.gaze.track is None else self.gaze.track.position

    @property
    def hand(self) -> Array:
        """(3,) [m] in frame body: where the encoders have the hand."""
        return self.readings[-1].T_body_hand[:3, 3]


def uncertainty(settings: Settings, state: State) -> Array:
    """Return the covariance (3, 3) [m^2] of the object in the hand's coordinates.

    Infinite where it is not known there.
    """
    if state.target is None:
        return np.diag(np.full(3, np.inf))
    systematic = (settings.share * state.apart_m) ** 2
    return state.target.covariance[:3, :3] + systematic * np.eye(3)


def start(settings: Settings, posture: Array, reading: HandReading, time_s: float) -> State:
    """Return the state of a head at rest at set points (7,) [rad] that has seen nothing."""
    gaze = state.start(settings.gaze, posture, time_s)
    rest = HandCommand(time_s, reading.T_body_hand[:3, 3], np.zeros(3))
    return State(Phase.SEEK, time_s, gaze, rest, (reading,), gaze.cameras)
