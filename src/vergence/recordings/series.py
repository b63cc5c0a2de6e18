"""Recordings whose messages are listed at once and read one by one, in any order."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import compress
from pathlib import Path

import numpy as np

from vergence.arrays import Array
from vergence.data.images import MAX_IMAGE_BYTES, UNREADABLE, decode_image
from vergence.errors import VergenceError
from vergence.files import file_inside, read_bytes
from vergence.recordings.recording import Channel, Content, JointSample, Kind, Message, Recording


@dataclass(frozen=True, eq=False)
class Series:
    """The N messages of a channel."""

    channel: Channel
    stamp_ns: np.ndarray
    """(N,) of int64, in the order of the recording."""
    received_ns: np.ndarray
    """(N,) of int64."""
    content: Callable[[int], Content]
    """Reads the content of a message by its index; VergenceError if it is damaged."""


def series(
    name: str, kind: Kind, type_name: str, stamp_ns: np.ndarray, content: Callable[[int], Content]
) -> Series:
    """Make a series of a format with one time."""
    return Series(Channel(name, kind, type_name, len(stamp_ns)), stamp_ns, stamp_ns, content)


def unused(name: str, type_name: str, count: int = 0) -> Series:
    """List a channel whose content cannot be used; `type_name` says why."""
    none = np.zeros(0, np.int64)
    return Series(Channel(name, "other", type_name, count), none, none, lambda index: ())


def recording_of(path: Path, every: Iterable[Series], what: str) -> Recording:
    """Make a recording of the series of its channels; VergenceError if none can be used.

    `what` names the format with its article.
    """
    every = list(every)
    channels = {each.channel.name: each.channel for each in every}
    if all(channel.kind == "other" for channel in channels.values()):
        reasons = "; ".join(f"{name}: {each.type}" for name, each in channels.items())
        raise VergenceError(f"{path} is {what} without images and joint readings: {reasons:.800}.")
    return Recording(path, channels, partial(_read, every))


def _read(
    every: Sequence[Series], names: Collection[str], start: int | None, stop: int | None
) -> Iterator[Message]:
    chosen = [each for each in every if each.channel.name in names]
    if not chosen:
        return
    received = np.concatenate([each.received_ns for each in chosen])
    # Messages of a channel keep their order, so that a clock that was set back can be seen.
    latest = np.concatenate([np.maximum.accumulate(each.received_ns) for each in chosen])
    lengths = [len(each.received_ns) for each in chosen]
    of_series = np.repeat(np.arange(len(chosen)), lengths)
    index = np.concatenate([np.arange(n) for n in lengths])
    wanted = np.ones(len(received), bool)
    wanted &= True if start is None else received >= start
    wanted &= True if stop is None else received < stop
    rows = np.flatnonzero(wanted)
    for row in rows[np.argsort(latest[rows], kind="stable")]:
        each, k = chosen[of_series[row]], int(index[row])
        stamp_ns, received_ns = int(each.stamp_ns[k]), int(each.received_ns[k])
        yield Message(each.channel.name, stamp_ns, received_ns, partial(each.content, k))


def read_image(folder: Path, name: str, where: str) -> np.ndarray:
    """Read an image file of a recording's folder; VergenceError if it is missing or damaged."""
    file = file_inside(folder, name, where, of="recording")
    image = decode_image(read_bytes(file, MAX_IMAGE_BYTES))
    if image is None:
        raise VergenceError(f"{where} {UNREADABLE}.")
    return image


def readings(names: tuple[str, ...], values: Array) -> JointSample:
    """Take values (C,) as joint readings, but for those that are not finite."""
    known = np.isfinite(values)
    return JointSample(tuple(compress(names, known)), values[known])
