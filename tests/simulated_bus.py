"""Servos on a pseudo terminal that speak Dynamixel's protocol 2.0 or Feetech's, byte by byte.

The makers' packages talk to them as to a serial line.
"""

from __future__ import annotations

import os
import select
import threading
import time
import tty
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

SYNC_READ, SYNC_WRITE = 0x82, 0x83


@dataclass
class SimulatedServo:
    """A servo that turns to its goal at a limited speed while its motor is on."""

    position: float = 2048.0
    """[ticks] at `since_s`."""
    goal: float = 2048.0
    speed: float = 4200.0
    """[ticks/s], as an XL330 at 5 V."""
    on: bool = False
    since_s: float = field(default_factory=time.monotonic)

    def at(self, time_s: float) -> float:
        """Return the position [ticks] at a time since the last change."""
        reach = self.speed * max(time_s - self.since_s, 0.0) * self.on
        return self.position + min(max(self.goal - self.position, -reach), reach)

    def change(self, *, goal: float | None = None, on: bool | None = None) -> None:
        """Begin another motion."""
        now_s = time.monotonic()
        self.position, self.since_s = self.at(now_s), now_s
        self.goal = self.goal if goal is None else goal
        self.on = self.on if on is None else on


@dataclass(frozen=True)
class Registers:
    """Addresses of a family of servos."""

    torque: int
    goal: int
    position: int


class SimulatedBus:
    """A line with servos, which answer from a thread until `close`."""

    registers: Registers

    def __init__(self, servos: Mapping[int, SimulatedServo]):
        self.servos = dict(servos)
        self.silent: set[int] = set()
        """Servos that do not answer."""
        self.damage: Callable[[int, bytes], bytes] = lambda servo, answer: answer
        """What the line does to the answer of a servo."""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self._open, self._received = True, b""
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._open = False
        self._thread.join()
        os.close(self._master)
        os.close(self._slave)

    def _listen(self) -> None:
        while self._open:
            if select.select([self._master], [], [], 0.05)[0]:
                self._received += os.read(self._master, 4096)
                for instruction, parameters in self.packets():
                    os.write(self._master, b"".join(self._answers(instruction, parameters)))

    def _answers(self, instruction: int, parameters: bytes) -> Iterator[bytes]:
        w = self.width
        address = int.from_bytes(parameters[:w], "little")
        length = int.from_bytes(parameters[w : 2 * w], "little")
        if instruction == SYNC_WRITE:
            rest = parameters[2 * w :]
            for k in range(0, len(rest), length + 1):
                self._write(rest[k], address, rest[k + 1 : k + 1 + length])
        elif instruction == SYNC_READ:
            for each in parameters[2 * w :]:
                if each in self.servos and each not in self.silent:
                    data = self._read(each, address, length)
                    yield self.damage(each, self.status(each, data))

    def _read(self, servo: int, address: int, length: int) -> bytes:
        if address != self.registers.position:
            return bytes(length)
        ticks = round(self.servos[servo].at(time.monotonic()))
        return (ticks % (1 << (8 * length))).to_bytes(length, "little")

    def _write(self, servo: int, address: int, data: bytes) -> None:
        if servo not in self.servos or servo in self.silent:
            return
        value = int.from_bytes(data, "little")
        if address == self.registers.goal:
            self.servos[servo].change(goal=value)
        elif address == self.registers.torque:
            self.servos[servo].change(on=bool(value))

    width: int
    """Bytes of an address and of a length."""

    def packets(self) -> Iterator[tuple[int, bytes]]:
        """Take whole packets out of what was received: instruction, parameters."""
        raise NotImplementedError

    def status(self, servo: int, data: bytes) -> bytes:
        """Pack an answer."""
        raise NotImplementedError


def crc16(data: bytes) -> int:
    """Compute the CRC of protocol 2.0: polynomial x^16 + x^15 + x^2 + 1, highest bit first."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x8005) & 0xFFFF if crc & 0x8000 else crc << 1
    return crc


class DynamixelLine(SimulatedBus):
    """X series: FF FF FD 00, id, length, instruction, parameters, CRC."""

    registers, width = Registers(64, 116, 132), 2
    HEADER = b"\xff\xff\xfd\x00"

    def packets(self) -> Iterator[tuple[int, bytes]]:
        while (at := self._received.find(self.HEADER)) >= 0 and len(self._received) >= at + 7:
            end = at + 7 + int.from_bytes(self._received[at + 5 : at + 7], "little")
            if len(self._received) < end:
                return
            packet, self._received = self._received[at:end], self._received[end:]
            if crc16(packet[:-2]) == int.from_bytes(packet[-2:], "little"):
                body = packet[7:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
                yield body[0], body[1:]

    def status(self, servo: int, data: bytes) -> bytes:
        body = b"\x55\x00" + data
        body = body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        packet = self.HEADER + bytes([servo]) + (len(body) + 2).to_bytes(2, "little") + body
        return packet + crc16(packet).to_bytes(2, "little")


class FeetechLine(SimulatedBus):
    """STS series: FF FF, id, length, instruction, parameters, inverted sum."""

    registers, width = Registers(40, 42, 56), 1
    HEADER = b"\xff\xff"

    def packets(self) -> Iterator[tuple[int, bytes]]:
        while (at := self._received.find(self.HEADER)) >= 0 and len(self._received) >= at + 4:
            end = at + 4 + self._received[at + 3]
            if len(self._received) < end:
                return
            packet, self._received = self._received[at:end], self._received[end:]
            if ~sum(packet[2:-1]) & 0xFF == packet[-1]:
                yield packet[4], packet[5:-1]

    def status(self, servo: int, data: bytes) -> bytes:
        packet = bytes([servo, len(data) + 2, 0]) + data
        return self.HEADER + packet + bytes([~sum(packet) & 0xFF])
