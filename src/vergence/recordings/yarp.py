"""Read folders of yarpdatadumper: one folder a port, with data.log, info.log and images.

A line of data.log is `number stamp content`, or `number sent received content`, with times in
seconds. The content is a Bottle in text, the name of an image file, or, with a video beside it, the
number of a frame. The k-th number of the Bottles of a port is the joint `port/k`, from 0.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from vergence.errors import VergenceError, counted
from vergence.files import file_inside, read_bytes
from vergence.recordings.recording import Channel, Content, JointSample, Kind, Recording
from vergence.recordings.series import Series, read_image, recording_of, unused
from vergence.recordings.stamps import nanoseconds
from vergence.recordings.video import open_video

DATA, INFO, TIMECODES = "data.log", "info.log", "timecodes.log"
MAX_LOG_BYTES = 256 * 2**20
"""Largest data.log [bytes]; six joints at 100 Hz for ten hours have 200 MB."""
MAX_FOLDERS = 10_000
"""Most folders among which ports are looked for; a robot has less than a hundred."""
MAX_LATENCY_S = 60.0
"""Longest time [s] between sending and receiving; two numbers that are closer are two stamps, if
they count from 1970 as no reading of a joint does."""
_BEGINNING = {n: re.compile(rb"\s*-?\d{1,20}" + rb"\s+(\d{1,20}\.?\d{0,20})" * n) for n in (1, 2)}
"""Number and stamps of a line, by the number of its stamps."""
_IMAGE = re.compile(rb"[\w.-]+\.(?:ppm|pgm|png|jpe?g|bmp|tiff?)\b", re.IGNORECASE)
_FRAME = re.compile(rb"frame_\d+")
_NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*(?:e[+-]?\d+)?|nan|inf)", re.IGNORECASE)
_NOT_NUMBERS = re.compile(rb'"[^"]*"|\[[^\]]*\]|[()]')
"""Texts, words such as [ok], and the brackets of lists."""


@dataclass(frozen=True, eq=False)
class _Log:
    """A data.log of N whole lines."""

    file: Path
    text: bytes
    begins: np.ndarray
    """(N,) where the contents of the lines begin."""
    ends: np.ndarray
    """(N,) where they end."""
    stamp_ns: np.ndarray
    """(N,) when the message was sent, or received if only this was written."""
    received_ns: np.ndarray
    """(N,)"""

    def __getitem__(self, k: int) -> bytes:
        return self.text[self.begins[k] : self.ends[k]].strip()

    def where(self, k: int) -> str:
        return f"{self.file}, line {k + 1}"


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
    name = folder.relative_to(root).as_posix() if folder != root else folder.resolve().name

    def inside(file: str) -> Path:
        return file_inside(
            root, str(folder.relative_to(root) / file), str(folder / file), of="recording"
        )

    about = read_bytes(inside(INFO), 2**20).decode("utf-8", "replace")
    type_name = "".join(re.findall(r"^Type:\s*(.*?);?\s*$", about, re.MULTILINE)[:1]) or "unknown"
    log = _read_log(inside(DATA), "tx+rx" in about)
    if log.text and not log.text.endswith(b"\n"):
        type_name += ", without its last line, which is cut off"
    count = len(log.ends)
    if not count:
        return unused(name, f"{type_name}, empty")

    def series(kind: Kind, content: Callable[[int], Content], rows: slice = slice(None)) -> Series:
        stamps, received = log.stamp_ns[rows], log.received_ns[rows]
        return Series(Channel(name, kind, type_name, len(stamps)), stamps, received, content)

    if _IMAGE.match(log[0]):
        return series("images", partial(_image, root, folder.relative_to(root), log))
    if _FRAME.match(log[0]):
        file = inside("video.avi" if "avi" in about else "video.mkv")
        video = stack.enter_context(open_video(file))
        frames = len(video.time_s)
        codes = len(read_bytes(inside(TIMECODES), MAX_LOG_BYTES).split(b"\n")) - 2
        if not frames == codes <= count:
            raise VergenceError(
                f"{file} has {counted(frames, 'frame')}, {DATA} has {count}, {TIMECODES} {codes}."
            )
        # The dumper writes images into the video from its second block of messages on.
        return series("images", video.frame, slice(count - frames, None))
    numbers = _numbers(log[0])
    if not len(numbers):
        return unused(name, f"{type_name} without numbers", count)
    names = tuple(f"{name}/{k}" for k in range(len(numbers)))
    return series("joints", partial(_joints, log, names))


def _read_log(file: Path, two_stamps: bool) -> _Log:
    text = read_bytes(file, MAX_LOG_BYTES)
    ends = np.flatnonzero(np.frombuffer(text, np.uint8) == ord("\n"))
    begins = np.concatenate([[0], ends[:-1] + 1])[: len(ends)]
    times = np.empty((len(ends), 2))
    if len(ends) and (match := _BEGINNING[2].match(text, 0, int(ends[0]))):
        sent, received = float(match[1]), float(match[2])
        two_stamps |= sent > 1e8 and abs(received - sent) < MAX_LATENCY_S
    beginning = _BEGINNING[1 + two_stamps]
    for k, (begin, end) in enumerate(zip(begins.tolist(), ends.tolist(), strict=True)):
        match = beginning.match(text, begin, end)
        if match is None:
            raise VergenceError(
                f"{file}, line {k + 1}: a number, {'two stamps' if two_stamps else 'a stamp'} in "
                f"seconds and the content are needed, found {text[begin:end][:60]!r}."
            )
        times[k] = float(match[1]), float(match[1 + two_stamps])
        begins[k] = match.end()
    stamps = (nanoseconds(column, "s", str(file)) for column in times.T)
    return _Log(file, text, begins, ends, *stamps)


def _image(root: Path, folder: Path, log: _Log, k: int) -> np.ndarray:
    match = _IMAGE.match(log[k])
    if match is None:
        raise VergenceError(f"{log.where(k)}: an image is needed, found {log[k][:60]!r}.")
    return read_image(root, str(folder / match[0].decode()), log.where(k))


def _numbers(content: bytes) -> list[float]:
    words = _NOT_NUMBERS.sub(b" ", content).split()
    return [float(word) for word in words if _NUMBER.fullmatch(word)]


def _joints(log: _Log, names: tuple[str, ...], k: int) -> JointSample:
    values = np.array(_numbers(log[k]))
    if len(values) != len(names):
        raise VergenceError(
            f"{log.where(k)}: {len(values)} numbers, but the first line has {len(names)}."
        )
    known = np.isfinite(values)
    return JointSample(tuple(np.array(names)[known]) if not known.all() else names, values[known])
