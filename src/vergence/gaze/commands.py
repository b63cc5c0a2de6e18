"""Commands to the joints: where they shall be, when, and how fast they may go there.

A command states the whole motion until the next one, so that a driver that renews its set points
every millisecond needs no further word from a controller that sees thirty frames a second; and the
controller can tell where it had sent the joints at the moment of any frame, however late it comes.

Joints are in the order of HEAD_JOINTS: the neck's three, then the eyes' four.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Dataset, Frame
from vergence.geometry.kinematics import EYE_JOINTS, NECK_JOINTS

HEAD_JOINTS = (*NECK_JOINTS, *EYE_JOINTS)
NECK, EYES_4 = slice(0, len(NECK_JOINTS)), slice(len(NECK_JOINTS), len(HEAD_JOINTS))


def _degrees(*ranges: tuple[float, float]) -> Array:
    return np.radians(np.array(ranges))


@dataclass(frozen=True, eq=False)
class Limits:
    """What the joints can do; the default is the head of this project's model."""

    range_rad: Array = field(
        default_factory=lambda: _degrees(
            (-30, 40), (-30, 30), (-50, 50), (-35, 35), (-30, 30), (-35, 35), (-30, 30)
        )
    )
    """(7, 2) lower and upper end."""
    speed_rad_s: Array = field(default_factory=lambda: np.array([3.0] * 3 + [10.0] * 4))
    """(7,) of the set points."""
    margin_rad: float = float(np.radians(0.25))
    """Set points keep this far from the ends of the ranges, since a servo overshoots a little."""

    @property
    def set_rad(self) -> Array:
        """(7, 2) lower and upper end of what may be set."""
        return self.range_rad + self.margin_rad * np.array([1.0, -1.0])


@dataclass(frozen=True, eq=False)
class Command:
    """A motion: from `start` as fast as allowed towards a goal that itself moves."""

    time_s: float
    """When it begins."""
    start: Array
    """(7,) set points at that time [rad]."""
    goal: Array
    """(7,) where the joints should be at that time [rad]."""
    rate: Array
    """(7,) how the goal moves from then on [rad/s]."""
    limits: Limits
    hold_s: float = 0.1
    """When the goal stops if no further command comes: guesses grow wrong with time."""


def setpoint(command: Command, time_s: float) -> Array:
    """Return the set points (7,) of a command at a time; never beyond ranges and speeds."""
    elapsed = max(time_s - command.time_s, 0.0)
    goal = command.goal + command.rate * min(elapsed, command.hold_s)
    reach = command.limits.speed_rad_s * elapsed
    wanted = command.start + np.clip(goal - command.start, -reach, reach)
    return np.clip(wanted, *command.limits.set_rad.T)


def commanded(commands: Sequence[Command], time_s: float) -> Array:
    """Return the set points (7,) that were in force at a time, from commands in their order.

    Before the first command, its start.
    """
    valid = [command for command in commands if command.time_s <= time_s]
    return setpoint(valid[-1] if valid else commands[0], time_s)


def stay(posture: Array, limits: Limits, time_s: float) -> Command:
    """Return the command to hold a posture (7,) [rad]."""
    return Command(time_s, posture, posture, np.zeros(len(HEAD_JOINTS)), limits)


class Head(Protocol):
    """What the driver of a head implements; the twin has one, and so has a recording."""

    def now_s(self) -> float:
        """Return the time by the clock that stamps the frames."""
        ...

    def read(self, cameras: Sequence[str]) -> Frame | None:
        """Wait for the next frame, with the images of these cameras at least; None: none came."""
        ...

    def command(self, command: Command) -> None:
        """Move the joints by this command from now on, at `setpoint` of the time."""
        ...


class RecordedHead:
    """A dataset, replayed open-loop: it shows what it has and goes where it went."""

    def __init__(self, dataset: Dataset):
        """Begin before the first row."""
        self._dataset, self._row = dataset, -1

    def now_s(self) -> float:
        """Return the time of the row that was read last."""
        return float(self._dataset.time_s[max(self._row, 0)])

    def read(self, cameras: Sequence[str]) -> Frame | None:
        """Return the next row with all its images; None at the end."""
        if self._row + 1 >= len(self._dataset):
            return None
        self._row += 1
        return self._dataset.frame(self._row)

    def command(self, command: Command) -> None:
        """Ignore it: what is recorded cannot be moved."""
