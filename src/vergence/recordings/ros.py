"""Read bags of ROS 1 and ROS 2 with rosbags, without ROS.

Messages are decoded by ROS's own definitions of the types in KINDS, which are the same in all its
versions. Definitions in a bag are not used: the library makes code of them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from heapq import merge
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag1 import ReaderError as Ros1Error
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.rosbag2 import ReaderError as Ros2Error
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from scipy.spatial.transform import Rotation

from vergence.errors import VergenceError, explain
from vergence.geometry.se3 import pose
from vergence.recordings.bag_limits import METADATA, check_folder, limit_opened
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
    "sensor_msgs/msg/Image": "images",
    "sensor_msgs/msg/CompressedImage": "images",
    "sensor_msgs/msg/CameraInfo": "lens",
    "sensor_msgs/msg/JointState": "joints",
    "tf2_msgs/msg/TFMessage": "poses",
    "tf/msg/tfMessage": "poses",
}
"""Kinds of channel by the type of their messages."""


@dataclass(frozen=True, eq=False)
class _Bag:
    path: Path
    readers: list[Ros1Reader] | list[Ros2Reader]
    types: Typestore
    ros1: bool
    decompress: Callable[[bytes], bytes] = bytes
    """Decompresses a message."""


def typestore(*, ros1: bool) -> Typestore:
    """Make the library's store of message types, with all types in KINDS."""
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    for name in KINDS.keys() - store.types.keys() if ros1 else ():
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
    return store


def recognise(path: Path) -> bool:
    """Test whether a path is a bag by its name or its metadata, or a folder of split ROS 1 bags."""
    return (
        path.suffix in SUFFIXES
        or os.path.exists(path / METADATA)
        or any(path.glob("*.bag") if os.path.isdir(path) else ())
    )


@contextmanager
def open_recording(path: Path) -> Iterator[Recording]:
    """Open a bag; VergenceError if it is damaged."""
    with ExitStack() as stack:
        with _explained(path):
            bag = _open(path, stack)
            channels: dict[str, Channel] = {}
            for each in (each for reader in bag.readers for each in reader.connections):
                before = channels.get(each.topic)
                kind = before.kind if before else _kind(bag, each)
                count = each.msgcount + (before.count if before else 0)
                channels[each.topic] = Channel(each.topic, kind, each.msgtype, count)
        yield Recording(path, dict(sorted(channels.items())), partial(_read, bag))


def _open(path: Path, stack: ExitStack) -> _Bag:
    files = [path]
    if os.path.isdir(path):
        check_folder(path)
        if not os.path.exists(path / METADATA):
            files = sorted(path.glob("*.bag"))
    elif not os.path.isfile(path):  # to open a pipe would block
        raise VergenceError(f"{path} is not a regular file.")
    if files and files[0].suffix == ".bag" and os.path.isfile(files[0]):
        readers = [stack.enter_context(Ros1Reader(file)) for file in files]
        return _Bag(path, readers, typestore(ros1=True), ros1=True)
    reader = stack.enter_context(Ros2Reader(path))
    return _Bag(path, [reader], typestore(ros1=False), False, limit_opened(reader))


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Raise errors of the library, which are of many kinds for damaged files, as VergenceError."""
    try:
        yield
    except VergenceError:
        raise
    except (Ros1Error, Ros2Error, OSError) as error:
        raise VergenceError(f"{path} cannot be read as a bag: {explain(error)}.") from error
    except Exception as error:
        kind = type(error).__name__
        raise VergenceError(f"{path} is a damaged bag, or not a bag ({kind}).") from error


def _kind(bag: _Bag, connection: Connection) -> Kind:
    """Select the kind of a connection; other if ROS does not define its messages so."""
    name, digest = connection.msgtype, connection.digest
    if name not in KINDS:
        return "other"
    known = bag.types.generate_msgdef(name)[1] if bag.ros1 else bag.types.hash_rihs01(name)
    return KINDS[name] if digest in ("", "*", known) else "other"


def _read(
    bag: _Bag, names: Collection[str], start: int | None, stop: int | None
) -> Iterator[Message]:
    with _explained(bag.path):
        chosen = []
        for reader in bag.readers:
            connections = [each for each in reader.connections if each.topic in names]
            for each in connections:
                if _kind(bag, each) == "other":
                    raise VergenceError(
                        f"{bag.path}: {each.topic} has messages of type {each.msgtype:.100} with "
                        f"definition {each.digest or 'unknown':.80}; types that are read are "
                        f"those that ROS defines as {', '.join(KINDS)}."
                    )
            if connections:
                chosen.append(reader.messages(connections, start, stop))
        deserialize = bag.types.deserialize_ros1 if bag.ros1 else bag.types.deserialize_cdr
        for connection, received_ns, raw in merge(*chosen, key=lambda each: each[1]):
            message: Any = deserialize(bag.decompress(raw), connection.msgtype)
            where, kind = f"{bag.path}: {connection.topic}", KINDS[connection.msgtype]
            if kind != "poses":
                decode = partial(_content, message, where, kind)
                yield Message(connection.topic, _stamp_ns(message), received_ns, decode)
                continue
            for stamp_ns, transforms in groupby(message.transforms, _stamp_ns):
                decode = partial(_poses, tuple(transforms), where)
                yield Message(connection.topic, stamp_ns, received_ns, decode)


def _stamp_ns(message: Any) -> int:
    """Take the stamp of a header."""
    stamp = message.header.stamp
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def _content(message: Any, where: str, kind: Kind) -> Content:
    if kind == "joints":
        n = min(len(message.name), len(message.position))  # a message may have velocities only
        values = np.array(message.position[:n], float)
        stated = np.flatnonzero(np.isfinite(values))
        return JointSample(tuple(message.name[k] for k in stated), values[stated])
    if kind == "images":
        decode = raw_image if hasattr(message, "step") else compressed_image
        return decode(message, where)
    return camera_lens(message, where)


def _poses(transforms: tuple[Any, ...], where: str) -> tuple[FramePose, ...]:
    found = []
    for each in transforms:
        t, q = each.transform.translation, each.transform.rotation
        turn, shift = np.array([q.x, q.y, q.z, q.w]), np.array([t.x, t.y, t.z])
        frames = each.header.frame_id.strip("/"), each.child_frame_id.strip("/")
        is_unit = (np.abs(turn) < 2).all() and abs(np.linalg.norm(turn) - 1) < 0.1
        if not (is_unit and np.isfinite(shift).all()):
            raise VergenceError(
                f"{where}: the pose of {frames[1]!r:.60} in {frames[0]!r:.60} is invalid: its "
                f"quaternion is {turn.tolist()}, its translation {shift.tolist()}."
            )
        found.append(FramePose(*frames, pose(Rotation.from_quat(turn).as_matrix(), shift)))
    return tuple(found)
