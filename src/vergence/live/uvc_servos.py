"""A head of USB cameras and servos on a serial line, Dynamixel or Feetech: a driver to copy.

Copy this file, edit the constants at its top, and name the copy to a command:

    vergence capture --driver my_head.py:UvcServoHead --out my_recording

Servos need position control and one baud rate, an adapter by FTDI a latency_timer of 1 ms.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from importlib import import_module

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.data.description import DatasetCamera, DatasetJoint, Description
from vergence.errors import VergenceError
from vergence.gaze.commands import HeadCommand, JointLimits, hold, setpoint
from vergence.geometry.board import Board, Chessboard


@dataclass(frozen=True)
class Servo:
    """The servo of a joint."""

    id: int
    zero: int
    """Position [ticks] with the joint at zero; the camera then looks straight ahead."""
    sign: int
    """1 if positions grow while a pan joint turns to the left, a tilt joint down; else -1."""
    range_rad: tuple[float, float]
    """Ends of the joint's motion [rad], where nothing touches yet."""
    speed_rad_s: float = 5.0
    """Maximum speed of the set points [rad/s], below the servo's own."""


DYNAMIXEL = ("dynamixel_sdk", 2.0, 64, 116, 132, 4)
"""Module and protocol; registers of torque, goal and position; bytes of the latter two: X series by
its manual."""
FEETECH = ("scservo_sdk", 0, 40, 42, 56, 2)
"""The same of the STS and SMS series, by their memory table. SCS servos have no sync read."""
PROTOCOL, PORT, BAUD = DYNAMIXEL, "/dev/ttyUSB0", 1_000_000
"""Kind of the servos, their serial port, and the baud rate that is set in all of them."""
SERVOS: Mapping[str, Servo] = {
    "left_pan": Servo(1, 2048, 1, (-0.6, 0.6)),
    "left_tilt": Servo(2, 2048, -1, (-0.5, 0.5)),
    "right_pan": Servo(3, 2048, 1, (-0.6, 0.6)),
    "right_tilt": Servo(4, 2048, -1, (-0.5, 0.5)),
}
"""Servos by joint: those of the neck from the body outwards, then those of the eyes."""
SHARED: Mapping[str, str] = {}
"""Joints that the servo of another joint moves too, such as {"right_tilt": "left_tilt"}."""
CAMERAS: Mapping[str, tuple[int | str, DatasetCamera]] = {
    "left_webcam": (0, DatasetCamera("left", width=640, height=480)),
    "right_webcam": (2, DatasetCamera("right", width=640, height=480)),
}
"""Cameras by name: N of /dev/videoN, or a lasting name as in /dev/v4l/by-path; and the camera."""
BOARD: Board = Chessboard(columns=9, rows=6, square_m=0.03)
"""The board to show, by its inner corners and the side of a square as measured on it [m]."""
LATENCY_S = 0.0
"""Time from exposure to the stamp of an image [s]; `calibrate` estimates it from moving eyes."""
TICKS = 4096
"""Positions in a turn."""
PERIOD_S = 0.005
"""Time between set points [s]; four servos answer in 2 ms at 1 Mbaud."""
ATTEMPTS = 3
"""Number of requests until a servo counts as silent; one answer in thousands is damaged."""
GAP_S = 0.03
"""Longest time of a request, and between an image and the nearest positions [s]; a frame."""
FAILED_S = 3.0
"""Time without images or positions after which a camera or servo has failed [s]."""


class ServoBus:
    """The servos of a serial line, for one thread at a time."""

    def __init__(self, ids: Sequence[int]):
        """Open the line, and let the motors hold their positions. VergenceError if they do not."""
        module, protocol, torque, self._goal, position, self._size = PROTOCOL
        try:
            self._sdk = import_module(module)
        except ImportError as error:
            extra = "dynamixel" if PROTOCOL is DYNAMIXEL else "feetech"
            raise VergenceError(f"{error}: pip install 'vergence[{extra}]'") from None
        self._ids, self._packets = ids, self._sdk.PacketHandler(protocol)
        self._line = self._sdk.PortHandler(PORT)
        try:
            if not self._line.setBaudRate(BAUD):
                raise VergenceError(f"{module} has no baud rate of {BAUD}.")
        except OSError as error:
            sentence = f"The servos' line does not open (is this user in group dialout?): {error}"
            raise VergenceError(sentence) from None
        self.close = self._line.closePort
        self._line.ser.timeout = 0.002  # [s]; the packages would poll without a pause
        self._reader = self._sdk.GroupSyncRead(self._line, self._packets, position, self._size)
        for each in ids:
            self._reader.addParam(each)
        self.move(self.read())
        self._write(torque, 1, [1] * len(ids))

    def read(self) -> Array:
        """Read the positions (n,) [ticks]; VergenceError if answers stay missing or damaged."""
        wrong: list[int] = []
        for _ in range(ATTEMPTS):
            self._line.ser.reset_input_buffer()  # Feetech's package would take late answers for new
            result, answers = self._reader.txRxPacket(), self._reader.data_dict
            values = {n: int.from_bytes(bytes(answers[n]), "little") for n in self._ids}
            wrong = [n for n in self._ids if len(answers[n]) != self._size or values[n] >= TICKS]
            if result == 0 and not wrong:
                return np.array(list(values.values()), float)
        raise VergenceError(
            f"Servo {(wrong or self._ids)[0]} on {PORT} does not answer with a position within a "
            f"turn; check its id, its baud rate (here {BAUD}), cable and supply."
        )

    def move(self, positions: Array) -> None:
        """Send the servos to positions (n,) [ticks]."""
        goals = np.clip(np.rint(positions), 0, TICKS - 1).astype(int).tolist()
        self._write(self._goal, self._size, goals)

    def _write(self, register: int, size: int, values: Sequence[int]) -> None:
        writer = self._sdk.GroupSyncWrite(self._line, self._packets, register, size)
        for each, value in zip(self._ids, values, strict=True):
            writer.addParam(each, list(value.to_bytes(size, "little")))
        writer.txPacket()


def open_camera(name: str, device: int | str, camera: DatasetCamera) -> cv2.VideoCapture:
    """Open a camera. VergenceError if it gives no images of its size."""
    capture, size = cv2.VideoCapture(device), (camera.width, camera.height)
    capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))  # several share a bus
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])
    capture.set(cv2.CAP_PROP_AUTOFOCUS, 0)  # a lens that moves cannot be calibrated
    sent, image = capture.read()
    if sent and image.shape[1::-1] == size:
        return capture
    capture.release()
    given = "images of {} x {}".format(*image.shape[1::-1]) if sent else "no images"
    raise VergenceError(f"The camera {name} ({device}) gives {given}, not {size[0]} x {size[1]}.")


class UvcServoHead:
    """The driver: a thread sends set points and reads positions, others keep the latest images."""

    def __init__(self) -> None:
        """Open the devices, and hold the posture. VergenceError names what is missing."""
        column = {name: name for name in SERVOS} | dict(SHARED)
        self.description = Description(
            cameras={name: camera for name, (_, camera) in CAMERAS.items()},
            board=BOARD,
            joints={joint: DatasetJoint(name, unit="rad") for joint, name in column.items()},
        )
        self._neck = len(self.description.neck_joints)
        joints = self.description.neck_joints + self.description.head_kinematics.readings
        order = [SERVOS[name] for name in joints]
        ranges, speeds = zip(*((s.range_rad, s.speed_rad_s) for s in order), strict=True)
        self.limits = JointLimits(np.array(ranges), np.array(speeds), joints)
        self._zero = np.array([servo.zero for servo in order])
        self._rad = np.array([servo.sign for servo in order]) * 2 * np.pi / TICKS
        none: tuple[float, np.ndarray] = 0.0, np.empty(0)
        self._images = dict.fromkeys(CAMERAS, none)
        self._given_s = dict.fromkeys(CAMERAS, self.now_s())
        self._stopped, self._error = threading.Event(), ""
        with ExitStack() as opened:
            self._bus = ServoBus([servo.id for servo in order])
            opened.callback(self._bus.close)
            angles = self._rad * (self._bus.read() - self._zero)
            self._measured = deque([(self.now_s(), angles)], maxlen=round(FAILED_S / PERIOD_S))
            self._command = hold(angles, self.limits, self.now_s())
            threads = [threading.Thread(target=self._move, daemon=True)]
            for name, (device, camera) in CAMERAS.items():
                capture = open_camera(name, device, camera)
                opened.callback(capture.release)
                threads += [threading.Thread(target=self._keep, args=(name, capture), daemon=True)]
            for thread in threads:
                thread.start()
                opened.callback(thread.join)
            self._opened = opened.pop_all()

    def _move(self) -> None:
        """Read positions and send set points; damaged answers are left out, unless for long."""
        try:
            while not self._stopped.wait(PERIOD_S):
                asked_s = self.now_s()
                try:
                    angles = self._rad * (self._bus.read() - self._zero)
                    took_s = self.now_s() - asked_s
                    if took_s < GAP_S:  # else its time is not known well
                        self._measured.append((asked_s + took_s / 2, angles))
                except VergenceError:
                    if asked_s - self._measured[-1][0] > FAILED_S:
                        raise
                wanted = setpoint(self._command, self.now_s())
                self._bus.move(self._zero + wanted / self._rad)
            self._bus.move(self._bus.read())
        except Exception as error:  # of the line, or of its package
            self._error = f"The servos have failed: {error}"

    def _keep(self, name: str, capture: cv2.VideoCapture) -> None:
        while not self._stopped.is_set():
            if not capture.grab():
                time.sleep(PERIOD_S)  # unplugged
                continue
            arrived_s, stamp_s = self.now_s(), capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
            stamped = 0 < arrived_s - stamp_s < FAILED_S  # Linux does, on this clock
            decoded, image = capture.retrieve()
            if decoded:
                rgb = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
                self._images[name] = stamp_s if stamped else arrived_s, rgb

    def now_s(self) -> float:
        """Read the clock of images and positions [s]."""
        return time.monotonic()

    def read(self, cameras: Sequence[str]) -> Frame | None:
        """Wait for new images of these cameras, and take the readings at their mean time.

        None if positions about that time were damaged. VergenceError if a device has failed.
        """
        while waiting := [n for n in cameras if self._images[n][0] <= self._given_s[n]]:
            if self.now_s() > self._given_s[waiting[0]] + FAILED_S:
                raise VergenceError(f"The camera {waiting[0]} gives no images any more.")
            time.sleep(PERIOD_S / 2)
        taken = {name: self._images[name] for name in cameras}
        self._given_s |= {name: stamp_s for name, (stamp_s, _) in taken.items()}
        stamps_s = [stamp_s for stamp_s, _ in taken.values()] or [self.now_s()]
        time_s = float(np.mean(stamps_s)) - LATENCY_S
        while self._measured[-1][0] < time_s:
            if self._error:
                raise VergenceError(self._error)
            time.sleep(PERIOD_S / 2)
        times, postures = map(np.array, zip(*tuple(self._measured), strict=True))
        if np.abs(times - time_s).min() > GAP_S:
            return None
        angles = np.array([np.interp(time_s, times, column) for column in postures.T])
        images = {name: image for name, (_, image) in taken.items()}
        return Frame(time_s, time_s, angles[self._neck :], angles[: self._neck], images)

    def command(self, command: HeadCommand) -> None:
        """Follow a command from now on."""
        self._command = command

    def close(self) -> None:
        """Stop the joints where they are, and release cameras and line."""
        self._stopped.set()
        self._opened.close()
