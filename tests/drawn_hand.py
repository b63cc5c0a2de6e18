"""A hand that moves freely, with a marker that the drawn head sees: no MuJoCo."""

from collections.abc import Callable

import numpy as np

from drawn_head import DrawnHead
from vergence.arrays import Array
from vergence.gaze.hand import HandCommand, HandReading, hand_goal
from vergence.geometry.se3 import pose, transform

MARKER_HAND = np.array([-0.026, 0.0, -0.052])
_RADIUS_M, _SPEED_M_S, _CLOSING_S, _TICK_S = 0.010, 0.5, 0.1, 0.005


class DrawnHand:
    """Behind the interface HandDriver; the arm is mounted elsewhere than assumed."""

    def __init__(self, home: Array, T_body_arm: Array, now_s: Callable[[], float]):
        self.position, self.T_body_arm, self._now_s = home.copy(), T_body_arm, now_s
        self.time_s, self.closing_s = 0.0, 0.0
        self.sent = HandCommand(0.0, home, np.zeros(3))

    def read(self) -> HandReading:
        self.advance(self._now_s())
        return HandReading(self.time_s, pose(t=self.position), self.closing_s >= _CLOSING_S)

    def command(self, command: HandCommand) -> None:
        self.sent = command

    def advance(self, until_s: float) -> None:
        while (dt := min(until_s - self.time_s, _TICK_S)) > 1e-9:
            away = hand_goal(self.sent, self.time_s)[0] - self.position
            distance = float(np.linalg.norm(away))
            step = min(_SPEED_M_S * dt, 0.2 * distance)
            self.position = self.position + away * (step / max(distance, 1e-9))
            self.closing_s = self.closing_s + dt if self.sent.close else 0.0
            self.time_s += dt

    def true(self, point: Array) -> Array:
        """Map a point (3,) [m] by the encoders to where it truly is, in frame body."""
        return transform(self.T_body_arm, point)


class DrawnHeadWithHand(DrawnHead):
    """The drawn head; a function of the time says when the hand's marker is visible."""

    def __init__(
        self,
        path: Callable[[float], Array | None],
        *,
        home: Array,
        T_body_arm: Array | None = None,
        shown: Callable[[float], bool] = lambda time_s: True,
        **faults,
    ):
        super().__init__(path, **faults)
        self.hand = DrawnHand(home, np.eye(4) if T_body_arm is None else T_body_arm, self.now_s)
        self.shown = shown

    def _draw(self, name: str, time_s: float) -> np.ndarray:
        image = super()._draw(name, time_s)
        if not self.shown(time_s):
            return image
        self.hand.advance(time_s)
        marker = self.hand.true(self.hand.position + MARKER_HAND)
        return self.dot(image, name, time_s, marker, _RADIUS_M, (20, 20, 220))
