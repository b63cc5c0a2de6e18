"""Read bags of ROS 1 and ROS 2 with rosbags, without ROS."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from vergence.errors import VergenceError, explain
from vergence.geometry.se3 import pose
from vergence.recordings.recording import (
    Channel,
    Content,
    FramePose,
    JointSample,
    Kind,
    Message,
    Recording,
)
from vergence.recordings.ros_images import camera_lens, compressed_image, raw_image

SUFFIXES = (".bag", ".db3", ".mcap")
KINDS: dict[str, Kind] = {
    "Image": "images",
    "CompressedImage": "images",
    "CameraInfo": "lens",
    "JointState": "joints",
    "TFMessage": "poses",
    "tfMessage": "poses",
}
"""Kinds of channel by the last part of their type."""


def recognise(path: Path) -> bool:
    """Test whether a path is a bag by its name or its metadata."""
    return path.suffix in SUFFIXES or (path / "metadata.yaml").is_file()


@contextmanager
def open_recording(path: Path) -> Iterator[Recording]:
    """Open a bag; VergenceError if it is damaged."""
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            channels = {
                name: Channel(name, _kind(info.msgtype), info.msgtype or "", info.msgcount)
                for name, info in reader.topics.items()
            }
            yield Recording(path, channels, partial(_read, reader, path))
    except VergenceError:
        raise
    except Exception as error:  # the library raises errors of many kinds for damaged files
        raise VergenceError(f"{path} cannot be read as a bag: {explain(error)}.") from error


def _kind(type_name: str | None) -> Kind:
    return KINDS.get((type_name or "").rpartition("/")[2], "other")


def _read(
    reader: AnyReader, path: Path, names: Collection[str], start: int | None, stop: int | None
) -> Iterator[Message]:
    connections = [each for each in reader.connections if each.topic in names]
    if not connections:
        return
    for connection, received_ns, raw in reader.messages(connections, start=start, stop=stop):
        message: Any = reader.deserialize(raw, connection.msgtype)
        where = f"{path}: {connection.topic}"
        yield Message(
            connection.topic,
            _stamp_ns(message, received_ns),
            received_ns,
            partial(_content, message, where, _kind(connection.msgtype)),
        )


def _stamp_ns(message: Any, received_ns: int) -> int:
    """Take the stamp of a header; the time of receipt where there is no header."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None and getattr(message, "transforms", None):
        stamp = message.transforms[0].header.stamp
    return received_ns if stamp is None else stamp.sec * 1_000_000_000 + stamp.nanosec


def _content(message: Any, where: str, kind: Kind) -> Content:
    if kind == "joints":
        n = min(len(message.name), len(message.position))
        return JointSample(tuple(message.name[:n]), np.array(message.position[:n], float))
    if kind == "images":
        return (
            raw_image(message, where)
            if hasattr(message, "step")
            else compressed_image(message, where)
        )
    if kind == "lens":
        return camera_lens(message, where)
    found = []
    for each in getattr(message, "transforms", ()):
        t, q = each.transform.translation, each.transform.rotation
        T = pose(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), [t.x, t.y, t.z])
        found.append(FramePose(each.header.frame_id, each.child_frame_id, T))
    return tuple(found)
