"""Read folders of yarpdatadumper: one folder a port, with data.log, info.log and images.

A line of data.log is `number stamp content` or, if info.log says so, `number sent received
content`, with times in seconds. The content is a Bottle in text, the name of an image file, or the
number of a frame in the folder's video. The k-th number of the Bottles of a port is the joint
`port/k`, from 0.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from vergence.errors import VergenceError
from vergence.files import read_bytes
from vergence.recordings import series
from vergence.recordings.recording import Content, Recording
from vergence.recordings.series import Series, nanoseconds
from vergence.recordings.video import open_video

DATA, INFO = "data.log", "info.log"
MAX_LOG_BYTES, MAX_LINES = 10**8, 2_000_000
"""Largest data.log [bytes, lines]; five hours of six joints at 100 Hz have 1.8 million lines."""
_START = {n: re.compile(rb"\s*-?\d{1,20}" + rb"\s+(\d{1,20}\.?\d{0,20})" * n) for n in (1, 2)}
"""Number and stamps of a line, by the number of its stamps."""
_IMAGE = re.compile(rb"\s*([\w.-]+\.(?:ppm|pgm|png|jpe?g|bmp|tiff?))\b", re.IGNORECASE)
_NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*(?:e[+-]?\d+)?|nan|inf)", re.IGNORECASE)
_NOT_NUMBERS = re.compile(rb'"[^"]*"|\[[^\]]*\]|[()]')
"""Texts, words such as [ok], and the brackets of lists."""


def recognise(path: Path) -> bool:
    """Test whether a folder or one inside it is a port's."""
    return bool(_ports(path))


def _ports(root: Path) -> list[Path]:
    files = set(series.files_in(root))
    return sorted(p.parent for p in files if p.name == DATA and p.parent / INFO in files)


@contextmanager
def open_recording(path: Path) -> Iterator[Recording]:
    """Open a folder of ports, or that of one; VergenceError if it is damaged."""
    with ExitStack() as stack:
        yield series.recording_of(path, [_port(path, port, stack) for port in _ports(path)])


def _port(root: Path, port: Path, stack: ExitStack) -> Series:
    name = port.as_posix() if port.parts else root.resolve().name
    about = read_bytes(series.inside(root, port / INFO), 2**20).decode("utf-8", "replace")
    file = series.inside(root, port / DATA)
    log = read_bytes(file, MAX_LOG_BYTES)
    if log.count(b"\n") > MAX_LINES:
        raise VergenceError(f"{file} is too large: at most {MAX_LINES:,} lines are read.")
    *lines, rest = log.split(b"\n")
    sent, received, texts = _lines(file, lines, "tx+rx" in about)
    type_name = about.partition("\n")[0].removeprefix("Type:").strip(" ;\r")
    type_name += ", without its last line, which is cut off" if rest else ""

    def numbers(k: int) -> list[float]:
        words = _NOT_NUMBERS.sub(b" ", texts[k]).split()
        return [float(word) for word in words if _NUMBER.fullmatch(word)]

    def joints(k: int) -> Content:
        if len(values := numbers(k)) != len(names):
            raise VergenceError(f"{file}, line {k + 1} has other numbers than the first line.")
        return series.readings(names, np.array([values]), 0)

    def image(k: int) -> Content:
        if (match := _IMAGE.match(texts[k])) is None:
            raise VergenceError(f"{file}, line {k + 1} has no image, as the first line has.")
        return series.read_image(root, [port / match[1].decode()], 0)

    if lines and _IMAGE.match(texts[0]):
        return Series(name, "images", type_name, sent, image, received)
    if names := tuple(f"{name}/{k}" for k in range(len(numbers(0) if lines else ()))):
        return Series(name, "joints", type_name, sent, joints, received)
    if "Video" not in about:
        return series.unused(name, f"{type_name}, without numbers or images")
    name_of_video = "video.avi" if "avi" in about else "video.mkv"
    times_s, frame = stack.enter_context(open_video(series.inside(root, port / name_of_video)))
    # The dumper writes images into the video from its second block of messages on.
    codes = read_bytes(series.inside(root, port / "timecodes.log"), MAX_LOG_BYTES).count(b"\n") - 1
    if not len(times_s) <= codes <= len(lines):
        raise VergenceError(f"{file.parent} has more frames in its video than time codes.")
    rows = slice(len(lines) - codes, len(lines) - codes + len(times_s))
    return Series(name, "images", type_name, sent[rows], frame, received[rows])


def _lines(file: Path, lines: list[bytes], two: bool) -> tuple[np.ndarray, np.ndarray, list[bytes]]:
    """Split lines into the times of sending and of receipt [ns] and their contents."""
    times, texts = np.empty((2, len(lines))), []
    for k, line in enumerate(lines):
        if (match := _START[1 + two].match(line)) is None:
            needed = f"a number, {'two stamps' if two else 'a stamp'} in seconds and the content"
            raise VergenceError(f"{file}, line {k + 1}: {needed} are needed, found {line[:60]!r}.")
        times[:, k] = float(match[1]), float(match[1 + two])
        texts.append(line[match.end() :])
    sent, received = (nanoseconds(each, "s", str(file)) for each in times)
    return sent, received, texts
