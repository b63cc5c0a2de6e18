"""Recordings whose messages are listed at once and read one by one, in any order."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from vergence.data.images import MAX_IMAGE_BYTES, UNREADABLE, decode_image
from vergence.errors import VergenceError
from vergence.files import file_inside, read_bytes
from vergence.recordings.recording import Channel, Content, Message, Recording

T = TypeVar("T")
NO_STAMPS = np.zeros(0, np.int64)


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


def unused(name: str, type_name: str, count: int = 0) -> Series:
    """List a channel whose content cannot be used; `type_name` says why."""
    channel = Channel(name, "other", type_name, count)
    return Series(channel, NO_STAMPS, NO_STAMPS, lambda index: ())


def recording_of(path: Path, series: Iterable[Series], what: str) -> Recording:
    """Make a recording of the series of its channels; VergenceError if none can be used.

    `what` names the format with its article.
    """
    series = list(series)
    if all(each.channel.kind == "other" for each in series):
        reasons = "; ".join(f"{each.channel.name}: {each.channel.type}" for each in series[:5])
        raise VergenceError(f"{path} is {what} without images and joint readings: {reasons:.800}.")
    return Recording(
        path, {each.channel.name: each.channel for each in series}, partial(_read, series)
    )


def _read(
    series: Sequence[Series], names: Collection[str], start: int | None, stop: int | None
) -> Iterator[Message]:
    chosen = [each for each in series if each.channel.name in names]
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
        yield Message(
            each.channel.name,
            int(each.stamp_ns[k]),
            int(each.received_ns[k]),
            partial(each.content, k),
        )


def read_image(folder: Path, name: str, where: str) -> np.ndarray:
    """Read an image file of a recording's folder; VergenceError if it is missing or damaged."""
    image = decode_image(
        read_bytes(file_inside(folder, name, where, of="recording"), MAX_IMAGE_BYTES)
    )
    if image is None:
        raise VergenceError(f"{where} {UNREADABLE}.")
    return image


class Replay(Generic[T]):
    """Random access to items that are read in order from the first one of their segment.

    Successive items are read once; an earlier one, or one of a later segment, begins anew.
    """

    def __init__(self, begins: np.ndarray, read_from: Callable[[int], Iterator[tuple[int, T]]]):
        """Take the indices of the first items of all segments, and what reads from such an item.

        `read_from` yields increasing indices with their items, up to the last one.
        """
        self._begins, self._read_from = begins, read_from
        self._items: Iterator[tuple[int, T]] = iter(())
        self._next = -1

    def __call__(self, index: int) -> T | None:
        """Read an item; None if it is not there."""
        begin = int(self._begins[np.searchsorted(self._begins, index, side="right") - 1])
        if not begin <= self._next <= index:
            self._items, self._next = self._read_from(begin), begin
        for found, item in self._items:
            self._next = found + 1
            if found >= index:
                return item if found == index else None
        self._next = -1
        return None
