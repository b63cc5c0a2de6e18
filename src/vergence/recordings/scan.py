"""Read a recording once: all joint readings, and of each image its time and how much it changed."""

from __future__ import annotations

from array import array
from collections import defaultdict, deque
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import cast

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera
from vergence.progress import Progress, silent
from vergence.recordings.recording import FramePose, JointSample, Message, Recording

THUMBNAIL_PX = 160
"""Width [px] of the small images that are compared; averaging suppresses the pixels' noise."""

LAG_NS = 200_000_000
"""Time [ns] between compared images: slow motions show, and no rest is shorter than twice that."""
MOST_EARLIER = 60
"""Most small images that wait to be compared, of one channel: of 300 Hz, in 5 MB."""
TILES = 8, 6
"""Columns and rows of tiles in which small images are compared: a board fills one or more."""


@dataclass(frozen=True, eq=False)
class Track:
    """S values of one channel of images, of one joint, or of one frame, in their order."""

    stamp_ns: np.ndarray
    """(S,) of int: when they were measured."""
    received_ns: np.ndarray
    """(S,) of int: when they were recorded, by which `Recording.read` finds them again."""
    values: Array
    """Readings (S,) in the unit of the recording, or T_parent_child (S, 4, 4) [m]; of images the
    apparent motion (S,) [px], of the part that moves most, since an image LAG_NS before or, at a
    lower rate, the one before; NaN for the first. It is the difference of small grey images of the
    same mean and contrast, relative to their slopes: it saturates at about a pixel of the small
    images, and noise adds to it."""

    @property
    def late_s(self) -> float:
        """Median time from the stamps to the receipt [s]."""
        return float(np.median(self.received_ns - self.stamp_ns)) * 1e-9


@dataclass(frozen=True, eq=False)
class Scan:
    """All of a recording but the pixels of its images."""

    images: Mapping[str, Track]
    """By channel."""
    sizes: Mapping[str, tuple[int, int]]
    """Width and height [px] of images, by channel."""
    joints: Mapping[tuple[str, str], Track]
    """By channel and name of the joint."""
    lenses: Mapping[str, Camera]
    """By channel: the last one."""
    poses: Mapping[tuple[str, str], Track]
    """By parent and child."""
    errors: Mapping[str, str] = field(default_factory=dict)
    """By channel why its messages cannot be used."""


def scan(
    recording: Recording,
    channels: Collection[str] | None = None,
    *,
    progress: Progress = silent,
) -> Scan:
    """Read channels of a recording in one pass; VergenceError if it is damaged.

    None: all channels except those of poses, which are many. Channels in `errors` are without
    content.
    """
    wanted = {
        name: channel
        for name, channel in recording.channels.items()
        if (channel.kind not in ("other", "poses") if channels is None else name in channels)
    }
    total = sum(channel.count for channel in wanted.values())
    images = defaultdict[str, _Values](_Values)
    sizes: dict[str, tuple[int, int]] = {}
    before = defaultdict[str, deque[tuple[int, np.ndarray]]](partial(deque, maxlen=MOST_EARLIER))
    joints = defaultdict[tuple[str, str], _Values](_Values)
    poses = defaultdict[tuple[str, str], _Values](_Values)
    lenses: dict[str, Camera] = {}
    errors: dict[str, str] = {}
    progress("reading the recording", 0, total)
    for done, message in enumerate(recording.read(list(wanted), None, None), 1):
        try:
            content = message.decode()
        except VergenceError as error:
            if channels is not None:
                raise
            errors.setdefault(message.channel, str(error))
            continue
        if isinstance(content, JointSample):
            for name, value in zip(content.names, content.values.tolist(), strict=True):
                joints[message.channel, name].append(message, [value])
        elif isinstance(content, Camera):
            lenses[message.channel] = content
        elif isinstance(content, np.ndarray):
            small, earlier = _thumbnail(content), before[message.channel]
            while len(earlier) > 1 and earlier[1][0] <= message.received_ns - LAG_NS:
                earlier.popleft()
            change = np.nan
            if earlier and earlier[0][1].shape == small.shape:
                scale = content.shape[1] / small.shape[1]
                change = scale * _apparent_motion(earlier[0][1], small)
            earlier.append((message.received_ns, small))
            sizes[message.channel] = content.shape[1], content.shape[0]
            images[message.channel].append(message, [change])
        else:
            for each in cast(tuple[FramePose, ...], content):
                poses[each.parent, each.child].append(message, each.T_parent_child.ravel())
        if done % 20 == 0 or done == total:
            progress("reading the recording", done, total)
    return Scan(
        images={name: each.track(-1) for name, each in images.items()},
        sizes=sizes,
        joints={name: each.track(-1) for name, each in joints.items()},
        lenses=lenses,
        poses={name: each.track(-1, 4, 4) for name, each in poses.items()},
        errors=errors,
    )


class _Values:
    """Values of a track as they are read, without a Python object for each."""

    def __init__(self) -> None:
        self.stamp_ns, self.received_ns, self.values = array("q"), array("q"), array("d")

    def append(self, message: Message, values: Iterable[float]) -> None:
        self.stamp_ns.append(message.stamp_ns)
        self.received_ns.append(message.received_ns)
        self.values.extend(values)

    def track(self, *shape: int) -> Track:
        times = np.array(self.stamp_ns), np.array(self.received_ns)
        return Track(*times, np.array(self.values).reshape(shape))


def _thumbnail(image: np.ndarray) -> np.ndarray:
    """Shrink an image to THUMBNAIL_PX, grey, of float32 with mean 0 and deviation 1.

    First by halves, for which OpenCV has code that is many times as fast.
    """
    while image.shape[1] >= 2 * THUMBNAIL_PX and image.shape[0] > 1:
        half = image.shape[1] // 2, image.shape[0] // 2
        image = cv2.resize(image, half, interpolation=cv2.INTER_AREA)
    width = min(THUMBNAIL_PX, image.shape[1])
    height = max(1, round(image.shape[0] * width / image.shape[1]))
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    grey = small if small.ndim == 2 else cv2.cvtColor(small, cv2.COLOR_RGB2GRAY)
    mean, deviation = cv2.meanStdDev(grey)
    return (grey.astype(np.float32) - np.float32(mean.item())) / max(deviation.item(), 1.0)


def _apparent_motion(last: np.ndarray, now: np.ndarray) -> float:
    """Estimate by how many of its pixels the part of a small image moves that moves most.

    In each tile it is the difference over the slope, for which a plain tile counts as an average
    one: there is only noise in it.
    """
    squares = cv2.multiply(change := cv2.subtract(now, last), change)
    slopes = np.zeros_like(now)
    for later, earlier in ((np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1])):
        slopes[later] += cv2.multiply(step := cv2.subtract(now[later], now[earlier]), step)
    squares, slopes = (
        cv2.resize(each, TILES, interpolation=cv2.INTER_AREA) for each in (squares, slopes)
    )
    return float(np.sqrt(2 * (squares / (slopes + max(float(slopes.mean()), 1e-6))).max()))
