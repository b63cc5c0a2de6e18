"""A robot of servos on a simulated line and cameras that render the twin at the servos' angles.

`head` is the name of its driver, for `--driver robot_on_a_bus:head`: the driver for USB cameras and
bus servos with other constants at its top.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np

from simulated_bus import DynamixelLine, SimulatedBus, SimulatedServo
from vergence.arrays import Array
from vergence.data.description import DatasetCamera
from vergence.live import uvc_servos
from vergence.live.uvc_servos import TICKS, Servo, UvcServoHead
from vergence.twin.calibration_sequence import BOARD
from vergence.twin.head import Twin
from vergence.twin.profile import load_profile

TICK_RAD = 2 * np.pi / TICKS
SERVOS = {
    "left_pan": Servo(11, 2000, 1, (-0.6, 0.6), 4.0),
    "left_tilt": Servo(12, 2100, -1, (-0.5, 0.5), 4.0),
    "right_pan": Servo(13, 1900, -1, (-0.6, 0.6), 4.0),
    "right_tilt": Servo(14, 2048, 1, (-0.5, 0.5), 4.0),
}
"""The twin's neck has no servo: it rests."""
SETTLE_S = 0.1
"""Simulated time in which the twin's joints reach an angle, to 0.1 mrad [s]."""

STILL_S = 0.05
"""Period of the pictures while nothing moves [s]."""
LATE_S = 0.02
"""Time from the exposure of an image to the stamp that the camera gives it [s]."""


class RobotOnABus:
    """The twin behind a line and cameras, in the time of the wall clock."""

    T_lbase_board: Callable[[float], Array | None] = staticmethod(lambda time_s: None)
    """(4, 4) where the board is at a time of the wall clock, in the left eye's base; None: out of
    sight."""
    object_lbase: Array | None = None
    """(3,) [m] where the object is; None: out of sight."""

    def __init__(self, cameras: Sequence[str], profile: str, seed: int):
        self.servos = {each.id: SimulatedServo(each.zero, each.zero) for each in SERVOS.values()}
        self.bus: SimulatedBus = DynamixelLine(self.servos)
        self.cameras = tuple(cameras)
        self.error: BaseException | None = None
        self._pictures: dict[str, Any] = {}
        self._number, self._taken = 0, threading.Condition()
        self._open = True
        self._thread = threading.Thread(target=self._run, args=(profile, seed), daemon=True)
        self._thread.start()
        with self._taken:
            self._taken.wait_for(lambda: self._number > 0 or self.error, 60)
        if self.error is not None:
            raise self.error

    def angles(self, time_s: float) -> Array:
        """Return the true angles (4,) [rad] of the eyes, in the order of SERVOS."""
        return np.array(
            [s.sign * (self.servos[s.id].at(time_s) - s.zero) * TICK_RAD for s in SERVOS.values()]
        )

    def _run(self, profile: str, seed: int) -> None:
        try:
            with Twin(load_profile(profile), seed=seed, oversampling=1) as twin:
                self.truth, images, before = twin.truth, {}, ()
                while self._open:
                    time_s = time.monotonic()
                    board, angles = self.T_lbase_board(time_s), self.angles(time_s)
                    now = (
                        angles.tolist(),
                        np.array(board).tolist(),
                        np.array(self.object_lbase).tolist(),
                    )
                    if now == before:
                        time.sleep(STILL_S)  # pictures of what rests are sent again
                    else:
                        twin.advance(twin.time_s + SETTLE_S, twin.posture(angles))
                        twin.place_board(board)
                        twin.place_object(self.object_lbase)
                        images, before = dict(twin.capture(self.cameras).images), now
                    with self._taken:
                        self.stamp_s, self._pictures = time_s + LATE_S, images
                        self._number += 1
                        self._taken.notify_all()
        except BaseException as error:
            with self._taken:
                self.error = error
                self._taken.notify_all()

    def next_picture(self, camera: str, number: int) -> tuple[int, float, np.ndarray] | None:
        """Wait for the number, stamp and (H, W, 3) RGB of a picture later than a number."""
        with self._taken:
            if self._taken.wait_for(lambda: self._number > number, 1.0):
                return self._number, self.stamp_s, self._pictures[camera]
        return None

    def close(self) -> None:
        self._open = False
        self._thread.join()
        self.bus.close()


class RenderedCamera:
    """Stands for cv2.VideoCapture; the name of the device is that of the camera."""

    robot: RobotOnABus

    def __init__(self, device: str):
        self._camera, self._number, self._stamp_s = device, 0, 0.0
        self._picture = np.empty(0)

    def set(self, what: int, value: float) -> bool:
        return True

    def get(self, what: int) -> float:
        return 1e3 * self._stamp_s

    def grab(self) -> bool:
        found = self.robot.next_picture(self._camera, self._number)
        if found is not None:
            self._number, self._stamp_s, self._picture = found
        return found is not None

    def retrieve(self) -> tuple[bool, np.ndarray]:
        return True, cv2.cvtColor(self._picture, cv2.COLOR_RGB2BGR)

    def read(self) -> tuple[bool, np.ndarray]:
        return (True, self.retrieve()[1]) if self.grab() else (False, np.empty(0))

    def release(self) -> None: ...


@contextmanager
def robot_on_a_bus(
    cameras: Sequence[str] = ("left_wide", "right_wide"),
    *,
    profile: str = "noise-only",
    seed: int = 0,
) -> Iterator[RobotOnABus]:
    """Switch a robot on; meanwhile `head` opens its driver."""
    robot = RobotOnABus(cameras, profile, seed)
    sizes = {name: robot.truth.camera(name) for name in cameras}
    described = {
        name: (name, DatasetCamera(c.eye, width=c.intrinsics.width, height=c.intrinsics.height))
        for name, c in sizes.items()
    }
    constants = {"PORT": robot.bus.port, "SERVOS": SERVOS, "CAMERAS": described, "BOARD": BOARD}
    RenderedCamera.robot = robot
    with patch.multiple(uvc_servos, **constants), patch.object(cv2, "VideoCapture", RenderedCamera):
        try:
            yield robot
        finally:
            robot.close()


def head() -> UvcServoHead:
    """Open the driver of the robot that is switched on."""
    return UvcServoHead()
