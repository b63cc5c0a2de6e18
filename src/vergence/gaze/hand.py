"""The driver of a hand on an arm: readings and commands, in metres in frame body.

The hand's encoders measure it through the mounting of the arm, the eyes measure the object and the
marker on the hand through the calibration of the head. The two differ by the errors of both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from vergence.arrays import Array
from vergence.data.table import MAX_DELAY_S
from vergence.errors import VergenceError
from vergence.gaze.commands import HOLD_S


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
    """Compute the goal (3,) [m] of a command at a time, and its velocity (3,) [m/s]."""
    elapsed = max(time_s - command.time_s, 0.0)
    velocity = command.velocity if elapsed < HOLD_S else np.zeros(3)
    return command.goal + min(elapsed, HOLD_S) * command.velocity, velocity


class HandDriver(Protocol):
    """The driver of a hand; it enforces the arm's own limits."""

    def read(self) -> HandReading:
        """Read the present pose of the hand."""
        ...

    def command(self, command: HandCommand) -> None:
        """Move towards `hand_goal(command, time)` from now on."""
        ...


def append_reading(
    earlier: tuple[HandReading, ...], reading: HandReading
) -> tuple[HandReading, ...]:
    """Append a reading to those that are as late as an image may be.

    A pose that is not finite is replaced by the last one. VergenceError if the first one is not.
    """
    # A copy, since a driver may write the next pose into the same array.
    time_s, T = reading.time_s, np.array(reading.T_body_hand, float)
    finite = bool(np.isfinite(T).all() and np.isfinite(time_s))
    if T.shape != (4, 4) or not (finite or earlier):
        raise VergenceError(
            f"A reading of the hand has a pose (4, 4), the first one a finite one; found {T}."
        )
    if not finite:
        return (*earlier[:-1], replace(earlier[-1], closed=reading.closed))
    kept = [each for each in earlier if time_s - MAX_DELAY_S < each.time_s < time_s]
    return (*kept, replace(reading, T_body_hand=T))


def hand_at(readings: tuple[HandReading, ...], time_s: float) -> Array:
    """Interpolate the hand's position at a time; its attitude in the pose (4, 4) is the latest."""
    T = readings[-1].T_body_hand.copy()
    times = [reading.time_s for reading in readings]
    positions = np.array([reading.T_body_hand[:3, 3] for reading in readings])
    T[:3, 3] = [np.interp(time_s, times, column) for column in positions.T]
    return T
