"""The driver for USB cameras and bus servos, with the makers' packages on a simulated line."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest

from simulated_bus import (
    DynamixelLine,
    FeetechLine,
    SimulatedBus,
    SimulatedServo,
)
from vergence.data.description import DatasetCamera
from vergence.errors import VergenceError
from vergence.gaze.commands import HeadCommand
from vergence.live import uvc_servos
from vergence.live.uvc_servos import Servo, UvcServoHead

LINES = {
    "dynamixel": (uvc_servos.DYNAMIXEL, DynamixelLine),
    "feetech": (uvc_servos.FEETECH, FeetechLine),
}
SERVOS = {
    "neck_yaw": Servo(9, 2048, 1, (-0.8, 0.8)),
    "left_pan": Servo(1, 2000, 1, (-0.6, 0.6)),
    "left_tilt": Servo(4, 2100, -1, (-0.5, 0.5)),
    "right_pan": Servo(7, 1500, -1, (-0.6, 0.6)),
}
"""A head with a common tilt, whose pans count in opposite directions."""
ORDER = 9, 1, 4, 7


class Pictures:
    """Stands for cv2.VideoCapture: a picture every 10 ms, until unplugged."""

    plugged = True
    stamp_ms: Callable[[], float] = staticmethod(lambda: 0.0)

    def __init__(self, device: int):
        self.device = device

    def set(self, what: int, value: float) -> bool:
        return True

    def get(self, what: int) -> float:
        return Pictures.stamp_ms()

    def grab(self) -> bool:
        time.sleep(0.01)
        return Pictures.plugged

    def retrieve(self) -> tuple[bool, np.ndarray]:
        return True, np.full((48, 64, 3), (10, 20, 30 + self.device), np.uint8)

    def read(self) -> tuple[bool, np.ndarray]:
        return self.retrieve()

    def release(self) -> None: ...


@pytest.fixture(params=LINES)
def bus(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[SimulatedBus]:
    """Edit the constants of the driver for servos on a simulated line."""
    protocol, line = LINES[request.param]
    pytest.importorskip(protocol[0])
    positions = dict(zip(ORDER, (2048, 2100, 2100, 1500), strict=True))
    found = line({servo: SimulatedServo(p, p) for servo, p in positions.items()})
    camera = DatasetCamera("left", width=64, height=48)
    for name, value in {
        "PROTOCOL": protocol,
        "PORT": found.port,
        "SERVOS": SERVOS,
        "SHARED": {"right_tilt": "left_tilt"},
        "CAMERAS": {"left_webcam": (0, camera), "right_webcam": (2, replace(camera, eye="right"))},
        "FAILED_S": 0.5,
    }.items():
        monkeypatch.setattr(uvc_servos, name, value)
    monkeypatch.setattr(cv2, "VideoCapture", Pictures)
    monkeypatch.setattr(Pictures, "plugged", True)
    yield found
    found.close()


@pytest.fixture
def head(bus: SimulatedBus) -> Iterator[UvcServoHead]:
    driver = UvcServoHead()
    yield driver
    driver.close()


def frame(head: UvcServoHead, cameras=("left_webcam",)):
    for _ in range(20):
        if (found := head.read(cameras)) is not None:
            return found
    pytest.fail("no frame")


def read_for_long(head: UvcServoHead) -> None:
    for _ in range(200):
        head.read(("left_webcam",))


def test_positions_and_commands_are_radians_with_signs_and_zeros(bus, head):
    tick = 2 * np.pi / 4096
    first = frame(head, ("left_webcam", "right_webcam"))
    np.testing.assert_allclose(first.neck_angles, 0, atol=1e-12)
    np.testing.assert_allclose(first.eye_angles, [100 * tick, 0, 0], atol=1e-12)
    assert first.images["right_webcam"][0, 0].tolist() == [32, 20, 10]  # RGB
    start = np.concatenate([first.neck_angles, first.eye_angles])
    goal = np.array([0.1, -0.2, 0.15, 0.2])
    head.command(HeadCommand(head.now_s(), start, goal, np.zeros(4), head.limits))
    began_s = time.monotonic()
    while np.abs((now := frame(head)).eye_angles - goal[1:]).max() > tick:
        assert time.monotonic() < began_s + 2
    np.testing.assert_allclose(now.neck_angles, goal[:1], atol=tick)
    wanted = np.array([2048, 2000, 2100, 1500]) + np.array([1, 1, -1, -1]) * goal / tick
    np.testing.assert_allclose([bus.servos[k].at(time.monotonic()) for k in ORDER], wanted, atol=1)
    assert time.monotonic() - began_s > 0.3 / 5  # the speed of the set points
    assert abs(now.time_s - head.now_s()) < 0.1


def test_an_image_has_the_time_of_its_stamp_on_this_clock(head, monkeypatch):
    image_s = frame(head).time_s
    assert 0 <= head.now_s() - image_s < 0.08  # by its arrival
    monkeypatch.setattr(Pictures, "stamp_ms", lambda: 1e3 * (time.monotonic() - 0.1))
    frame(head)
    image_s = frame(head).time_s
    assert 0.1 <= head.now_s() - image_s < 0.18


def test_joints_that_share_a_servo_share_its_reading(head):
    assert head.limits.joints == ("neck_yaw", "left_pan", "left_tilt", "right_pan")
    assert head.description.head_kinematics.readings == head.limits.joints[1:]


def test_close_stops_the_joints_where_they_are(bus):
    head = UvcServoHead()
    start = np.array([0, 100 * 2 * np.pi / 4096, 0, 0])
    far = HeadCommand(head.now_s(), start, np.full(4, 0.5), np.zeros(4), head.limits)
    head.command(far)
    time.sleep(0.03)
    head.close()
    time.sleep(0.05)  # until the last packet is carried out
    stopped = [bus.servos[k].at(time.monotonic() + 5) for k in ORDER]
    time.sleep(0.05)
    assert stopped == [bus.servos[k].at(time.monotonic()) for k in ORDER]
    assert abs(stopped[0] - 2048) < 0.4 * 4096 / (2 * np.pi)


def test_a_damaged_answer_is_asked_for_again(bus, head):
    """One bit of every eleventh answer is flipped: no reading is wrong, and frames still come."""
    answers = iter(range(10_000))

    def flip(servo: int, answer: bytes) -> bytes:
        damaged = bytearray(answer)
        damaged[-3] ^= 0x08 * (next(answers) % 11 == 0)
        return bytes(damaged)

    bus.damage = flip
    for _ in range(10):
        np.testing.assert_allclose(frame(head).neck_angles, 0, atol=1e-12)


def test_a_servo_that_falls_silent_is_named(bus, head):
    bus.silent.add(4)
    with pytest.raises(VergenceError, match=r"Servo 4 on .* does not answer"):
        read_for_long(head)


def test_a_servo_that_is_missing_is_named(bus):
    bus.silent.add(7)
    with pytest.raises(VergenceError, match=r"Servo 7 on .*its id, its baud rate \(here 1000000\)"):
        UvcServoHead()


def test_answers_that_come_late_are_not_taken_for_the_next(bus, monkeypatch):
    """An answer after the time-out waits in the buffer when the next request is sent."""
    line = uvc_servos.ServoBus(ORDER)
    monkeypatch.setattr(uvc_servos, "ATTEMPTS", 1)
    bus.silent.add(1)  # the answers of the two behind it stay in the buffer
    with pytest.raises(VergenceError, match="Servo 1"):
        line.read()
    bus.silent.clear()
    bus.servos[4].change(on=True, goal=2200)
    time.sleep(0.1)
    assert line.read().tolist() == [2048, 2100, 2200, 1500]
    line.close()


def test_a_camera_that_is_unplugged_or_of_another_size_is_named(bus, head, monkeypatch):
    monkeypatch.setattr(Pictures, "plugged", False)
    with pytest.raises(VergenceError, match="The camera left_webcam gives no images any more"):
        read_for_long(head)
    head.close()
    cameras = {"left_webcam": (0, DatasetCamera("left", width=640, height=480))}
    monkeypatch.setattr(uvc_servos, "CAMERAS", cameras)
    with pytest.raises(VergenceError, match="gives images of 64 x 48, not 640 x 480"):
        UvcServoHead()


def test_a_missing_line_or_package_is_one_sentence(bus, monkeypatch):
    monkeypatch.setattr(uvc_servos, "PORT", "/dev/no-such-port")
    with pytest.raises(VergenceError, match=r"line does not open .*dialout"):
        UvcServoHead()
    monkeypatch.setitem(sys.modules, uvc_servos.PROTOCOL[0], None)
    with pytest.raises(VergenceError, match=r"pip install 'vergence\[(dynamixel|feetech)\]'"):
        UvcServoHead()
