"""Joint commands and limits, and the interface between a controller and a head's driver.

A command describes the motion until the next command arrives, so that a driver can renew its set
points at any time, and the controller knows those at the time of any frame.

A posture has j joints: those of the neck, from the body outwards, then the readings of the eyes in
the order of the head's kinematics.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array
from vergence.data.dataset import Dataset, Frame
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration
from vergence.geometry.neck import Neck

USUAL_RANGE_RAD = float(np.radians(30))
"""Usual reach of a joint to either side [rad]; iCub's eyes and neck reach at least as far."""
USUAL_SPEED_RAD_S = {"neck": 3.0, "eyes": 10.0}
"""Usual speeds [rad/s]: of a neck, and of eyes; a human eye makes a saccade of 15 degrees as
fast."""
HOLD_S = 0.1
"""Time after which a moving goal stops if no further command arrives [s]; three frames."""
_AGES = (np.arange(100) + 0.5) * 0.08
"""Ages of the set points that are averaged to simulate a lag [time constants]. The error after a
turn by 25 degrees is below 0.04 degrees."""
_WEIGHTS = np.exp(-_AGES) / np.exp(-_AGES).sum()


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Ranges and speeds of the joints of a posture."""

    range_rad: Array
    """(j, 2) lower and upper end of each joint's range."""
    speed_rad_s: Array
    """(j,) maximum speed of the set points."""
    joints: tuple[str, ...]
    """Names of the joints."""
    margin_rad: float = float(np.radians(0.25))
    """Distance of the set points from the ends of the ranges: servos overshoot a little."""

    def __post_init__(self) -> None:
        shapes, j = (np.shape(self.range_rad), np.shape(self.speed_rad_s)), len(self.joints)
        if shapes != ((j, 2), (j,)):
            raise VergenceError(
                f"The joints {', '.join(self.joints)} need ranges ({j}, 2) and speeds ({j},), "
                f"found {shapes[0]} and {shapes[1]}; see `joint_limits`."
            )
        for name, (lower, upper), speed in zip(
            self.joints, self.range_rad, self.speed_rad_s, strict=True
        ):
            if not (-np.inf < lower <= upper < np.inf and 0 < speed < np.inf):
                raise VergenceError(
                    f"The range of {name} goes from a lower to an upper end and its speed is above "
                    f"0; found {lower:g} to {upper:g} rad and {speed:g} rad/s."
                )

    @property
    def setpoint_range_rad(self) -> Array:
        """(j, 2) lowest and highest set point of each joint."""
        margin = np.minimum(self.margin_rad, np.ptp(self.range_rad, axis=1) / 2)
        return self.range_rad + margin[:, None] * np.array([1.0, -1.0])


def joint_limits(
    range_rad: Mapping[str, tuple[float, float]],
    speed_rad_s: Mapping[str, float],
    *,
    joints: Sequence[str],
) -> JointLimits:
    """Make limits from the ranges and maximum speeds of some joints; the others stay at zero.

    `joints` are all joints of a posture. Raises VergenceError for a joint that is unknown, or
    without a valid range and speed.
    """
    for name in {**range_rad, **speed_rad_s}:
        if name not in joints:
            raise VergenceError(f"No joint is called {name!r}; there are {', '.join(joints)}.")
        if name not in range_rad or name not in speed_rad_s:
            raise VergenceError(f"The joint {name} needs both a range and a speed.")
    return JointLimits(
        np.array([range_rad.get(name, (0.0, 0.0)) for name in joints], float),
        np.array([speed_rad_s.get(name, 1.0) for name in joints], float),
        tuple(joints),
    )


def posture_joints(head: HeadCalibration) -> tuple[str, ...]:
    """Name the joints of a posture (j,): the neck's, then the readings of the eyes."""
    return (*head.neck.names, *head.kinematics.readings)


def usual_limits(head: HeadCalibration) -> JointLimits:
    """Make usual limits of a head whose own are not stated."""
    farther = np.append(np.ones(len(head.neck.axes)), head.kinematics.gear_ratios)
    speeds = [USUAL_SPEED_RAD_S["neck"]] * len(head.neck.axes)
    speeds += [USUAL_SPEED_RAD_S["eyes"]] * len(head.kinematics.readings)
    reach = USUAL_RANGE_RAD / farther
    return JointLimits(
        np.stack([-reach, reach], axis=-1), np.array(speeds) / farther, posture_joints(head)
    )


@dataclass(frozen=True, eq=False)
class HeadCommand:
    """A motion from `start` towards a moving goal, as fast as the limits allow."""

    time_s: float
    """Time at which the motion begins."""
    start: Array
    """(j,) set points at that time [rad]."""
    goal: Array
    """(j,) target angles at that time [rad]."""
    rate: Array
    """(j,) velocity of the goal from then on [rad/s]."""
    limits: JointLimits


def setpoint(command: HeadCommand, time_s: float | Array) -> Array:
    """Compute the set points (..., j) [rad] of a command at times (...), within ranges and speeds.

    A joint that starts outside its range returns to it at its maximum speed.
    """
    elapsed = np.maximum(np.asarray(time_s) - command.time_s, 0.0)[..., None]
    speed = command.limits.speed_rad_s
    goal = command.goal + np.clip(command.rate, -speed, speed) * np.minimum(elapsed, HOLD_S)
    goal = np.clip(goal, *command.limits.setpoint_range_rad.T)
    reach = speed * elapsed
    return command.start + np.clip(goal - command.start, -reach, reach)


def setpoints_at(commands: Sequence[HeadCommand], time_s: float, lag_s: float = 0.0) -> Array:
    """Compute the set points (j,) [rad] at a time, with a lag as servos of first order follow them.

    Commands are in the order of their times; the first one also holds for earlier times.
    """
    since_s = [command.time_s for command in commands]
    times_s = np.atleast_1d(time_s - lag_s * _AGES if lag_s else time_s)
    weights = _WEIGHTS if lag_s else np.ones(1)
    current = np.maximum(np.searchsorted(since_s, times_s, side="right") - 1, 0)
    parts = [
        weights[current == k] @ setpoint(commands[k], times_s[current == k])
        for k in np.unique(current)
    ]
    return np.sum(parts, axis=0)


def hold(posture: ArrayLike, limits: JointLimits, time_s: float) -> HeadCommand:
    """Make the command that holds a posture, (j,) finite angles [rad], or VergenceError."""
    posture = np.array(posture, float)  # a copy, since a driver may write into its array
    if posture.shape != (len(limits.joints),) or not np.isfinite(posture).all():
        raise VergenceError(
            f"A posture has the {len(limits.joints)} angles {', '.join(limits.joints)} [rad], all "
            f"finite; found an array of shape {posture.shape}: {posture.tolist()}."
        )
    return HeadCommand(time_s, posture, posture, np.zeros(len(posture)), limits)


class HeadDriver(Protocol):
    """The driver of a head. The simulated head and recordings implement it too."""

    def now_s(self) -> float:
        """Read the clock that stamps the frames [s]."""
        ...

    def read(self, cameras: Sequence[str]) -> Frame | None:
        """Wait for the next frame, with the images of at least these cameras; None on a timeout."""
        ...

    def command(self, command: HeadCommand) -> None:
        """Let the joints follow `setpoint(command, time)` from now on."""
        ...


class RecordedHead:
    """A driver that replays a dataset in open loop: commands have no effect."""

    def __init__(self, dataset: Dataset, neck: Neck | None = None):
        """Start before the first row of a dataset of a head with this neck; None: it has none.

        A joint of the neck without a column is at zero.
        """
        self._dataset, self._reads = dataset, 0
        angles = dict(zip(dataset.description.neck_joints, dataset.neck_angles.T, strict=True))
        zero = np.zeros(len(dataset))
        self._neck = [angles.get(name, zero) for name in (neck.names if neck else ())]

    def now_s(self) -> float:
        """Return the time of the latest row [s]; it increases after the last row."""
        rows = len(self._dataset)
        last = float(self._dataset.time_s[max(min(self._reads, rows) - 1, 0)])
        return last + HOLD_S * max(self._reads - rows, 0)

    def read(self, cameras: Sequence[str]) -> Frame | None:
        """Read the next row with all its images; None after the last row."""
        self._reads += 1
        if self._reads > len(self._dataset):
            return None
        row = self._reads - 1
        angles = np.array([column[row] for column in self._neck])
        return replace(self._dataset.frame(row), neck_angles=angles)

    def command(self, command: HeadCommand) -> None:
        """Ignore the command."""
