"""List what is in a recording: channels with rates and gaps, joints with ranges, some images."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from vergence.errors import VergenceError
from vergence.geometry.camera import Camera
from vergence.progress import Progress, silent
from vergence.recordings.recording import Channel, Content, FramePose, JointSample, Recording

SAMPLES = 6
"""Images of a channel that are decoded, spread over the recording."""
MAX_JOINTS = 10_000
"""Most joints that are listed; a robot has a hundred."""


@dataclass(frozen=True, eq=False)
class ChannelListing:
    """What is in one channel."""

    channel: Channel
    stamp_ns: np.ndarray
    """(N,) of int, in the order of the recording."""
    received_ns: np.ndarray
    """(N,) of int."""
    images: tuple[np.ndarray, ...]
    """Some of its images, as Content has them."""
    lens: Camera | None
    error: str
    """Why its messages cannot be used; empty: they can."""

    @property
    def period_s(self) -> float:
        """The usual time between messages [s]; 0 for fewer than two."""
        steps = np.diff(np.sort(self.stamp_ns))
        return float(np.median(steps)) * 1e-9 if len(steps) else 0.0

    @property
    def largest_gap_s(self) -> float:
        """The longest time between successive messages [s]; 0 for fewer than two."""
        return float(np.diff(np.sort(self.stamp_ns)).max(initial=0)) * 1e-9


@dataclass(frozen=True, eq=False)
class Listing:
    """What is in a recording."""

    path: Path
    channels: Mapping[str, ChannelListing]
    """By name."""
    joints: Mapping[tuple[str, str], tuple[float, float]]
    """By channel and name of the joint: its lowest and highest reading."""
    frames: Mapping[str, str]
    """Parents of frames of poses by their children."""


@dataclass(eq=False)
class _Part:
    stamps: array[int] = field(default_factory=lambda: array("q"))
    received: array[int] = field(default_factory=lambda: array("q"))
    images: list[np.ndarray] = field(default_factory=list)
    lens: Camera | None = None
    error: str = ""


def list_recording(recording: Recording, *, progress: Progress = silent) -> Listing:
    """Read all channels that can be used, but only a few of their images.

    VergenceError if the recording is damaged.
    """
    parts = {name: _Part() for name in recording.channels}
    used = {name: each for name, each in recording.channels.items() if each.kind != "other"}
    total = sum(channel.count for channel in used.values())
    joints: dict[tuple[str, str], tuple[float, float]] = {}
    frames: dict[str, str] = {}
    progress("reading the recording", 0, total)
    for done, message in enumerate(recording.read(list(used), None, None), 1):
        part, channel = parts[message.channel], used[message.channel]
        if _is_needed(channel, len(part.stamps), part) and not part.error:
            try:
                _keep(message.channel, message.decode(), part, joints, frames)
            except VergenceError as error:
                part.error = str(error)
        part.stamps.append(message.stamp_ns)
        part.received.append(message.received_ns)
        if done % 50 == 0 or done == total:
            progress("reading the recording", done, total)
    listed = {
        name: ChannelListing(
            channel=recording.channels[name],
            stamp_ns=np.array(part.stamps),
            received_ns=np.array(part.received),
            images=tuple(part.images),
            lens=part.lens,
            error=part.error,
        )
        for name, part in parts.items()
    }
    return Listing(recording.path, listed, joints, frames)


def _is_needed(channel: Channel, number: int, part: _Part) -> bool:
    """Test whether the content of a channel's message, counted from 0, is looked at."""
    if channel.kind == "images":
        return number % max(1, channel.count // SAMPLES) == 0 and len(part.images) < SAMPLES
    return part.lens is None  # all of joints and poses


def _keep(
    channel: str,
    content: Content,
    part: _Part,
    joints: dict[tuple[str, str], tuple[float, float]],
    frames: dict[str, str],
) -> None:
    """Note the content of a message."""
    if isinstance(content, np.ndarray):
        part.images.append(content)
    elif isinstance(content, Camera):
        part.lens = content
    elif isinstance(content, JointSample):
        for name, value in zip(content.names, content.values.tolist(), strict=True):
            key = channel, name
            if key in joints:
                low, high = joints[key]
                if not low <= value <= high:
                    joints[key] = min(low, value), max(high, value)
            elif len(joints) < MAX_JOINTS:
                joints[key] = value, value
    else:
        poses: tuple[FramePose, ...] = content
        frames.update((each.child, each.parent) for each in poses)
