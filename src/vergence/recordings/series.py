"""Recordings in files whose messages are listed at once and read one by one, in any order."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from heapq import merge
from itertools import compress
from pathlib import Path

import numpy as np

from vergence.arrays import Array
from vergence.data.images import MAX_IMAGE_BYTES, UNREADABLE, decode_image
from vergence.errors import VergenceError
from vergence.files import file_inside, read_bytes
from vergence.recordings.recording import Channel, Content, JointSample, Kind, Message, Recording

MAX_FOLDERS = 1000
"""Most folders of a recording; each camera or port has one."""
UNITS_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
"""Units of time [ns]."""
SINCE_1970_S = 9.4e8, 4.2e9
"""Times [s] that count as seconds since 1970: of the years 2000 to 2100."""
_UNIT = re.compile(r"(?:^|[^a-z])(nano|micro|milli|[num])?(s|secs?|seconds?)[^a-z]*$")


@dataclass(frozen=True, eq=False)
class Series:
    """The N messages of a channel."""

    name: str
    kind: Kind
    type: str
    stamp_ns: np.ndarray
    """(N,) of int64, in the order of the recording."""
    content: Callable[[int], Content]
    """Reads a message by its index; VergenceError if it is damaged."""
    received_ns: np.ndarray | None = None
    """(N,) of int64; None: equal to the stamps."""


def unused(name: str, reason: str) -> Series:
    """List a channel that cannot be used."""
    return Series(name, "other", reason, np.zeros(0, np.int64), lambda index: ())


def recording_of(path: Path, every: Iterable[Series]) -> Recording:
    """Make a recording of its series; VergenceError if none has images or joint readings."""
    every = list(every)
    if all(each.kind == "other" for each in every):
        reasons = "; ".join(f"{each.name}: {each.type}" for each in every)
        raise VergenceError(f"{path} has no images and no joint readings: {reasons:.800}.")
    channels = {s.name: Channel(s.name, s.kind, s.type, len(s.stamp_ns)) for s in every}
    return Recording(path, channels, partial(_read, every))


def _read(
    every: list[Series], names: Collection[str], start: int | None, stop: int | None
) -> Iterator[Message]:
    first = -(2**63) if start is None else start
    end = 2**63 - 1 if stop is None else stop

    def messages(each: Series) -> Iterator[Message]:
        received = each.stamp_ns if each.received_ns is None else each.received_ns
        for k in np.flatnonzero((received >= first) & (received < end)).tolist():
            content = partial(each.content, k)
            yield Message(each.name, int(each.stamp_ns[k]), int(received[k]), content)

    # Messages of a channel keep their order, so that a clock that was set back can be seen.
    chosen = [messages(each) for each in every if each.name in names]
    yield from merge(*chosen, key=lambda message: message.received_ns)


def files_in(root: Path) -> Iterator[Path]:
    """List files by their path in a folder, 9.png before 10.png.

    Links to folders are followed, each folder once.
    """
    known = {root.resolve()}
    for count, (folder, folders, names) in enumerate(os.walk(root, followlinks=True)):
        if count == MAX_FOLDERS:
            return
        for name in sorted(folders):
            if (real := Path(folder, name).resolve()) in known:
                folders.remove(name)
            known.add(real)
        folders.sort()
        within = Path(folder).relative_to(root)
        yield from (within / name for name in sorted(names, key=lambda n: (len(n), n)))


def inside(root: Path, name: Path | str) -> Path:
    """Find a file of a recording; VergenceError if it is missing or lies elsewhere."""
    return file_inside(root, str(name), str(root / name)[:300], of="recording")


def read_image(root: Path, names: Sequence[Path | str], k: int) -> np.ndarray:
    """Read one of the image files of a recording; VergenceError if it is missing or damaged."""
    file = inside(root, names[k])
    image = decode_image(read_bytes(file, MAX_IMAGE_BYTES))
    if image is None:
        raise VergenceError(f"{file} {UNREADABLE}.")
    return image


def readings(names: tuple[str, ...], values: Array, k: int) -> JointSample:
    """Take row k of values (N, C) as joint readings, without those that are not finite."""
    known = np.isfinite(values[k])
    return JointSample(tuple(compress(names, known)), values[k][known])


def nanoseconds(values: np.ndarray, unit: str, where: str) -> np.ndarray:
    """Convert stamps (N,) of int or float to int64 [ns]; VergenceError for impossible ones."""
    factor = UNITS_NS[unit]
    possible = np.abs(values.astype(float)) * factor < 2.0**63
    if not possible.all():
        k = int(np.argmin(possible))
        raise VergenceError(f"{where}: stamp {k + 1} is {values[k]}, not a time in {unit}.")
    if values.dtype.kind in "iu":
        return values.astype(np.int64) * factor
    whole = np.floor(values)  # a float of all nanoseconds since 1970 is exact to 256 only
    return whole.astype(np.int64) * factor + np.rint((values - whole) * factor).astype(np.int64)


def read_stamps(values: np.ndarray, name: str, where: str) -> tuple[str, np.ndarray]:
    """Convert stamps (N,) to nanoseconds, and tell the unit that they have.

    It is the last word of their name, or follows from their size since 1970; fractions are of
    seconds. VergenceError if they are impossible, or of no known unit.
    """
    unit = _unit(values, name)
    if unit is None:
        raise VergenceError(
            f"{where}: {name} has whole numbers, as numbers of frames are; name the column with "
            "the unit of times at its end, such as time_s or time_ns."
        )
    return unit, nanoseconds(values, unit, f"{where}: {name}")


def _unit(values: np.ndarray, name: str) -> str | None:
    if match := _UNIT.search(name.lower()):
        prefix = match[1] or ""
        return {"micro": "us"}.get(prefix, prefix[:1] + "s")
    stamps = values[np.isfinite(values)]
    middle = np.median(stamps) if len(stamps) else 0.0
    for unit, factor in UNITS_NS.items():
        if SINCE_1970_S[0] <= middle * factor * 1e-9 <= SINCE_1970_S[1]:
            return unit
    return "s" if (stamps != np.rint(stamps)).any() else None
