"""The twin's hand behind the `reach_state.Hand` protocol, on an arm that is not simulated.

The hand flies where it is sent, within limits of speed and acceleration. Its encoders are exact,
but the head knows only roughly where the arm is mounted: everything that the hand believes of its
pose is turned and shifted by a constant that nothing on the vision side can see.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.gaze.commands import NECK
from vergence.geometry.head import T_body_base
from vergence.geometry.se3 import inverse, pose, rotation, transform
from vergence.reach.state import HandCommand, HandReading, hand_goal
from vergence.twin.head import Twin
from vergence.twin.simulated_robot import TwinHead

OPEN_M, CLOSED_M = 0.068, 0.040
"""Between the faces of the fingers: closed, they touch an object of 20 mm radius."""
_TICK_S = 0.005


@dataclass(frozen=True)
class Limits:
    """What the arm can do; about as much as one of a humanoid's."""

    speed_m_s: float = 0.5
    acceleration_m_s2: float = 4.0
    closing_s: float = 0.1
    gain_hz: float = 12.0
    """Wanted speed per distance to the goal, near the goal."""


def roughly_mounted(seed: int, run: int) -> Array:
    """Return the pose (4, 4) of the arm against where the head believes it to be.

    15 mm along and 1.5 degrees about each axis: half a metre away, 22 mm and more along each.
    """
    rng = np.random.default_rng([seed, 8, run])
    return pose(rotation(rng.normal(0, np.radians(1.5), 3)), rng.normal(0, 0.015, 3))


class TwinHand:
    """The hand; `true_point` is for evaluation alone."""

    def __init__(self, twin: Twin, home: Array, T_body_arm: Array, *, limits: Limits | None = None):
        """Put the hand at home.

        Args:
            twin: in whose room it is.
            home: (3,) [m] in frame body, by its encoders.
            T_body_arm: (4, 4) from where it believes to be to where it is.
            limits: of the arm.
        """
        self._twin, self._T_body_arm = twin, T_body_arm
        self._limits = Limits() if limits is None else limits
        self._position, self._velocity = np.array(home, float), np.zeros(3)
        self._opening_m, self._time_s = OPEN_M, twin.time_s
        self._command = HandCommand(twin.time_s, self._position, np.zeros(3))

    def read(self) -> HandReading:
        """Return where its encoders have it."""
        self.advance(self._twin.time_s)
        closed = self._opening_m <= CLOSED_M
        return HandReading(self._time_s, pose(t=self._position), closed)

    def command(self, command: HandCommand) -> None:
        """Obey a command from now on."""
        self._command = command

    def advance(self, until_s: float) -> None:
        """Move, as fast as allowed; slowly enough near the goal to stop there."""
        limits = self._limits
        while (left := until_s - self._time_s) > 1e-9:
            dt = min(left, _TICK_S)
            goal, goal_velocity = hand_goal(self._command, self._time_s)
            away = goal - self._position
            distance = float(np.linalg.norm(away))
            braking = np.sqrt(limits.acceleration_m_s2 * distance)  # of half the acceleration
            speed = min(limits.gain_hz * distance, braking)
            wanted = goal_velocity + away * (speed / distance if distance else 0.0)
            wanted *= min(1.0, limits.speed_m_s / max(float(np.linalg.norm(wanted)), 1e-9))
            change = wanted - self._velocity
            most = limits.acceleration_m_s2 * dt
            change *= min(1.0, most / max(float(np.linalg.norm(change)), 1e-9))
            self._velocity = self._velocity + change
            self._position = self._position + dt * self._velocity
            rate = (OPEN_M - CLOSED_M) / limits.closing_s * (-1 if self._command.close else 1)
            self._opening_m = float(np.clip(self._opening_m + rate * dt, CLOSED_M, OPEN_M))
            self._time_s += dt

    def true_point(self, believed: Array) -> Array:
        """Return where a point (3,) by the encoders truly is, in the left eye's base frame."""
        neck = self._twin.true_angles()[NECK]
        T_body_lbase = T_body_base(self._twin.truth, "left", neck)
        return transform(inverse(T_body_lbase) @ self._T_body_arm, believed)

    def place(self) -> None:
        """Show the hand where it truly is now."""
        self.advance(self._twin.time_s)
        neck = self._twin.true_angles()[NECK]
        T_lbase_body = inverse(T_body_base(self._twin.truth, "left", neck))
        T = T_lbase_body @ self._T_body_arm @ pose(t=self._position)
        self._twin.place_hand(T, opening_m=self._opening_m)


class HeadWithHand(TwinHead):
    """The twin's head; the hand is in the picture as the object is."""

    hand: TwinHand | None = None
    """None: out of sight."""

    def place(self) -> None:
        """Put object and hand where they are now."""
        super().place()
        if self.hand is not None:
            self.hand.place()
