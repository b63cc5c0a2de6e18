"""Recordings of robots: channels of images, joint readings, lenses and poses, in any format.

Each format is a module that recognises and opens its recordings; `formats` lists them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from vergence.arrays import Array
from vergence.geometry.camera import Camera

Kind = Literal["images", "joints", "lens", "poses", "other"]


@dataclass(frozen=True)
class Channel:
    """A series of messages of one type: a topic, a column of images, a table of joints."""

    name: str
    kind: Kind
    type: str
    """As the format calls it, such as sensor_msgs/msg/Image."""
    count: int
    """Number of messages."""


@dataclass(frozen=True, eq=False)
class JointSample:
    """Readings of some joints at one moment."""

    names: tuple[str, ...]
    values: Array
    """(n,) in the unit of the recording."""


@dataclass(frozen=True, eq=False)
class FramePose:
    """Pose of a frame in its parent."""

    parent: str
    child: str
    T_parent_child: Array
    """(4, 4) [m]."""


Content = np.ndarray | JointSample | Camera | tuple[FramePose, ...]
"""By kind of channel: an image (H, W), or (H, W, 3) in RGB, of uint8 or uint16; joint readings; a
lens; poses."""


@dataclass(frozen=True, eq=False)
class Message:
    """One message of a recording, not decoded yet."""

    channel: str
    stamp_ns: int
    """When it was measured: the stamp of its header [ns]."""
    received_ns: int
    """When it was recorded [ns]; equals the stamp in formats with one time."""
    decode: Callable[[], Content]
    """Makes its content. VergenceError if it is damaged, or its encoding is not supported."""


@dataclass(frozen=True, eq=False)
class Recording:
    """An open recording."""

    path: Path
    channels: Mapping[str, Channel]
    read: Callable[[Collection[str], int | None, int | None], Iterator[Message]]
    """Reads channels by name, in order of time, from a time of receipt to before another [ns];
    None: from the first, to the last. VergenceError if the recording is damaged."""
