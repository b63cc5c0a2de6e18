"""Read folders of yarpdatadumper: one folder a port, with data.log, info.log and images.

A line of data.log is `number stamp content`, or `number sent received content`, with times in
seconds. The content is a Bottle in text, the name of an image file, or, with a video beside it, the
number of a frame. The k-th number of the Bottles of a port is the joint `port/k`, from 0.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

import numpy as np

from vergence.errors import VergenceError, counted
from vergence.files import file_inside, read_bytes
from vergence.recordings.recording import Channel, JointSample, Kind, Recording
from vergence.recordings.series import Series, read_image, readings, recording_of, unused
from vergence.recordings.stamps import nanoseconds
from vergence.recordings.video import open_video

DATA, INFO = "data.log", "info.log"
MAX_LOG_BYTES = 256 * 2**20
"""Largest data.log [bytes]; six joints at 100 Hz for ten hours have 200 MB."""
MAX_FOLDERS = 10_000
"""Most folders among which ports are looked for; a robot has less than a hundred."""
MAX_LATENCY_S = 60.0
"""Longest time [s] between sending and receiving. Two numbers that are closer, and count from 1970
as no reading of a joint does, are two stamps."""
_START = {n: re.compile(rb"\s*-?\d{1,20}" + rb"\s+(\d{1,20}\.?\d{0,20})" * n) for n in (1, 2)}
"""Number and stamps of a line, by the number of its stamps."""
_IMAGE = re.compile(rb"\s*([\w.-]+\.(?:ppm|pgm|png|jpe?g|bmp|tiff?))\b", re.IGNORECASE)
_FRAME = re.compile(rb"\s*frame_\d+")
_NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*(?:e[+-]?\d+)?|nan|inf)", re.IGNORECASE)
_NOT_NUMBERS = re.compile(rb'"[^"]*"|\[[^\]]*\]|[()]')
"""Texts, words such as [ok], and the brackets of lists."""


def recognise(path: Path) -> bool:
    """Test whether a folder or one inside it is a port's."""
    return next(_ports(path), None) is not None


def _ports(path: Path) -> Iterator[Path]:
    """Find the folders of ports; links to folders are not followed."""
    for count, (folder, folders, files) in enumerate(os.walk(path)):
        folders.sort()
        if count == MAX_FOLDERS:
            return
        if DATA in files and INFO in files:
            yield Path(folder)


@contextmanager
def open_recording(path: Path) -> Iterator[Recording]:
    """Open a folder of ports, or that of one; VergenceError if it is damaged."""
    with ExitStack() as stack:
        series = [_port(path, folder, stack) for folder in _ports(path)]
        yield recording_of(path, series, "a YARP recording")


def _port(root: Path, folder: Path, stack: ExitStack) -> Series:
    within = folder.relative_to(root)
    name = within.as_posix() if within.parts else folder.resolve().name

    def inside(file: str) -> Path:
        return file_inside(root, str(within / file), str(folder / file), of="recording")

    about = read_bytes(inside(INFO), 2**20).decode("utf-8", "replace")
    type_name = "".join(re.findall(r"^Type:\s*(.*?);?\s*$", about, re.MULTILINE)[:1])
    log, file = read_bytes(inside(DATA), MAX_LOG_BYTES), folder / DATA
    if log and not log.endswith(b"\n"):
        type_name += ", without its last line, which is cut off"
    times, ends = _stamps(log, "tx+rx" in about, file)
    count = len(ends)
    if not count:
        return unused(name, f"{type_name}, empty")

    def content(k: int) -> bytes:
        return log[slice(*ends[k])]

    def numbers(k: int) -> list[float]:
        words = _NOT_NUMBERS.sub(b" ", content(k)).split()
        return [float(word) for word in words if _NUMBER.fullmatch(word)]

    def joints(names: tuple[str, ...], k: int) -> JointSample:
        found = numbers(k)
        if len(found) != len(names):
            raise VergenceError(
                f"{file}, line {k + 1}: {len(found)} numbers, but the first line has {len(names)}."
            )
        return readings(names, np.array(found))

    def image(k: int) -> np.ndarray:
        found, where = _IMAGE.match(content(k)), f"{file}, line {k + 1}"
        if found is None:
            raise VergenceError(f"{where}: an image is needed, found {content(k)[:60]!r}.")
        return read_image(root, str(within / found[1].decode()), where)

    kind: Kind = "images"
    if _IMAGE.match(content(0)):
        read = image
    elif _FRAME.match(content(0)):
        video = stack.enter_context(
            open_video(inside("video.avi" if "avi" in about else "video.mkv"))
        )
        frames = len(video.time_s)
        codes = read_bytes(inside("timecodes.log"), MAX_LOG_BYTES).count(b"\n") - 1
        if not frames == codes <= count:
            raise VergenceError(
                f"{folder}: the video has {counted(frames, 'frame')}, {DATA} {count}, and "
                f"timecodes.log {codes}."
            )
        # The dumper writes images into the video from its second block of messages on.
        times, read = times[count - frames :], video.frame
    elif n := len(numbers(0)):
        kind, read = "joints", partial(joints, tuple(f"{name}/{k}" for k in range(n)))
    else:
        return unused(name, f"{type_name} without numbers", count)
    sent, received = (nanoseconds(column, "s", str(file)) for column in times.T)
    return Series(Channel(name, kind, type_name, len(sent)), sent, received, read)


def _stamps(log: bytes, two: bool, file: Path) -> tuple[np.ndarray, np.ndarray]:
    """Find the times (N, 2) [s] of sending and receiving, and where the N contents are (N, 2)."""
    ends = np.flatnonzero(np.frombuffer(log, np.uint8) == ord("\n"))
    within = np.stack([np.concatenate([[0], ends[:-1] + 1])[: len(ends)], ends], axis=-1)
    times = np.empty((len(ends), 2))
    if len(ends) and (match := _START[2].match(log, 0, int(ends[0]))):
        sent, received = float(match[1]), float(match[2])
        two |= sent > 1e8 and abs(received - sent) < MAX_LATENCY_S
    for k, (begin, end) in enumerate(within.tolist()):
        match = _START[1 + two].match(log, begin, end)
        if match is None:
            raise VergenceError(
                f"{file}, line {k + 1}: a number, {'two stamps' if two else 'a stamp'} in "
                f"seconds and the content are needed, found {log[begin:end][:60]!r}."
            )
        times[k] = float(match[1]), float(match[1 + two])
        within[k, 0] = match.end()
    return times, within
