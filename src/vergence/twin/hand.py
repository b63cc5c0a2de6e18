"""A simulated hand behind the interface `HandDriver`, on an arm that is not simulated.

The hand moves freely to where it is sent, within limits of speed and acceleration. Its encoders are
exact, but the mounting of the arm on the body is known only roughly: the hand's pose by its
encoders differs from the true one by a constant transform, which the cameras do not show.
"""

from __future__ import annotations

import numpy as np

from vergence.arrays import Array
from vergence.gaze.hand import HandCommand, HandReading, hand_goal
from vergence.geometry.head import base_pose_in_body
from vergence.geometry.se3 import inverse, pose, rotation, transform
from vergence.twin.head import Twin

OPEN_M, CLOSED_M = 0.068, 0.040
"""Distance between the faces of the fingers: closed, they touch an object of 20 mm radius."""
SPEED_M_S, ACCELERATION_M_S2 = 0.5, 4.0
"""Limits of the hand's motion: about those of a humanoid's arm."""
_CLOSING_S = 0.1
"""Time in which the fingers close."""
_TICK_S = 0.005
"""Longest step of the integration of the hand's motion [s]: as between the joints' commands."""


def arm_mounting_error(seed: int, run: int) -> Array:
    """Draw the pose (4, 4) of the arm relative to where the head's software assumes it.

    Standard deviations are 15 mm along and 1.5 degrees about each axis, which adds up to more than
    22 mm along each axis at half a metre. The seed is that of the head.
    """
    rng = np.random.default_rng([seed, 8, run])
    return pose(rotation(rng.normal(0, np.radians(1.5), 3)), rng.normal(0, 0.015, 3))


class SimulatedHand:
    """The driver of the simulated hand; `true_point` is for evaluation only."""

    def __init__(self, twin: Twin, home: Array, T_body_arm: Array):
        """Put the hand at its home position (3,) [m] in frame body, by its encoders.

        T_body_arm is the true pose (4, 4) of the arm relative to its assumed one.
        """
        self._twin, self._T_body_arm = twin, T_body_arm
        self._position, self._velocity = np.array(home, float), np.zeros(3)
        self._opening_m, self._time_s = OPEN_M, twin.time_s
        self._command = HandCommand(twin.time_s, self._position, np.zeros(3))

    def read(self) -> HandReading:
        """Read the pose of the hand by its encoders."""
        self.advance(self._twin.time_s)
        closed = self._opening_m <= CLOSED_M
        return HandReading(self._time_s, pose(t=self._position), closed)

    def command(self, command: HandCommand) -> None:
        """Follow a command from now on."""
        self._command = command

    def advance(self, until_s: float) -> None:
        """Move until a time, within the limits, and slowly enough near the goal to stop there."""
        while (left := until_s - self._time_s) > 1e-9:
            dt = min(left, _TICK_S)
            goal, goal_velocity = hand_goal(self._command, self._time_s)
            away = goal - self._position
            distance = float(np.linalg.norm(away))
            braking = np.sqrt(ACCELERATION_M_S2 * distance)  # of half the acceleration
            speed = min(12.0 * distance, braking)
            wanted = goal_velocity + away * (speed / distance if distance else 0.0)
            wanted *= min(1.0, SPEED_M_S / max(float(np.linalg.norm(wanted)), 1e-9))
            change = wanted - self._velocity
            most = ACCELERATION_M_S2 * dt
            change *= min(1.0, most / max(float(np.linalg.norm(change)), 1e-9))
            self._velocity = self._velocity + change
            self._position = self._position + dt * self._velocity
            rate = (OPEN_M - CLOSED_M) / _CLOSING_S * (-1 if self._command.close else 1)
            self._opening_m = float(np.clip(self._opening_m + rate * dt, CLOSED_M, OPEN_M))
            self._time_s += dt

    def _T_lbase_arm(self) -> Array:
        truth = self._twin.truth
        neck = self._twin.true_angles()[: len(truth.neck.axes)]
        return inverse(base_pose_in_body(truth, "left", neck)) @ self._T_body_arm

    def true_point(self, by_encoders: Array) -> Array:
        """Map a point (3,) [m] by the encoders to where it truly is, in the left eye's base."""
        return transform(self._T_lbase_arm(), by_encoders)

    def place(self) -> None:
        """Move the hand to the present time, and draw it where it truly is."""
        self.advance(self._twin.time_s)
        T_lbase_hand = self._T_lbase_arm() @ pose(t=self._position)
        self._twin.place_hand(T_lbase_hand, opening_m=self._opening_m)
