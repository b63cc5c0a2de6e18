"""Write bags of ROS 1 and ROS 2 with rosbags, without ROS."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from scipy.spatial.transform import Rotation

from vergence.errors import VergenceError
from vergence.files import check_writable, whole_file, whole_folder
from vergence.geometry.camera import Camera
from vergence.interchange.ros import DISTORTION_MODELS
from vergence.recordings.recording import Content, FramePose, JointSample, Message
from vergence.recordings.ros import typestore

Storage = Literal["ros1", "ros2", "mcap"]
"""A ROS 1 bag, and ROS 2 bags in SQLite and in MCAP."""
COMPRESSED = "/compressed"
"""Ending of channels whose images are written as PNG; image_transport names them so."""
_ENCODINGS = {
    (np.dtype(np.uint8), 2): "mono8",
    (np.dtype(np.uint8), 3): "rgb8",
    (np.dtype(np.uint16), 2): "mono16",
    (np.dtype(np.uint16), 3): "rgb16",
}
"""Encodings by type and number of dimensions of an image."""


def message(
    channel: str, stamp_ns: int, content: Content, *, received_ns: int | None = None
) -> Message:
    """Make a message of its content; None: it was received when it was measured."""
    received = stamp_ns if received_ns is None else received_ns
    return Message(channel, stamp_ns, received, lambda: content)


def write_bag(path: Path | str, messages: Iterable[Message], *, storage: Storage = "mcap") -> None:
    """Write messages into a new bag, in their order.

    A ROS 1 bag is a file; the others are folders with a metadata.yaml. The type of a channel is
    that of its first message; an image of float is not possible. VergenceError if the bag exists
    or cannot be written.
    """
    path = Path(path)
    store = typestore(ros1=storage == "ros1")
    serialize = store.serialize_ros1 if storage == "ros1" else store.serialize_cdr
    connections: dict[str, Any] = {}
    with _writer(path, storage) as writer:
        for each in messages:
            ros = _ros_message(each, store.types, ros1=storage == "ros1")
            kind = ros.__msgtype__
            if each.channel not in connections:
                added = writer.add_connection(each.channel, kind, typestore=store)
                connections[each.channel] = added
            writer.write(connections[each.channel], each.received_ns, serialize(ros, kind))


@contextmanager
def _writer(path: Path, storage: Storage) -> Iterator[Any]:
    if check_writable(path, folder=storage != "ros1").exists() and storage == "ros1":
        raise VergenceError(f"{path} already exists; name another bag, or remove it.")
    if storage == "ros1":
        with whole_file(path) as part, Ros1Writer(part) as writer:
            yield writer
        return
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with whole_folder(path) as part:
        part.rmdir()  # the library makes it
        with Ros2Writer(part, version=9, storage_plugin=plugin) as writer:
            yield writer


def _ros_message(each: Message, types: dict[str, Any], *, ros1: bool) -> Any:
    """Make the ROS message of a content."""

    def make(kind: str, *fields: Any) -> Any:
        return types[kind.replace("/", "/msg/")](*fields)

    def header(frame: str) -> Any:
        stamp = make("builtin_interfaces/Time", *divmod(each.stamp_ns, 1_000_000_000))
        return make("std_msgs/Header", *([0] if ros1 else []), stamp, frame)

    content, frame = each.decode(), each.channel.strip("/").removesuffix(COMPRESSED)
    if isinstance(content, np.ndarray):
        if each.channel.endswith(COMPRESSED):
            shown = content if content.ndim == 2 else cv2.cvtColor(content, cv2.COLOR_RGB2BGR)
            data = cv2.imencode(".png", shown)[1].ravel()
            return make("sensor_msgs/CompressedImage", header(frame), "png", data)
        encoding = _ENCODINGS[content.dtype, content.ndim]
        rows = np.ascontiguousarray(content).view(np.uint8).reshape(len(content), -1)
        size = *content.shape[:2], encoding, 0, rows.shape[1]
        return make("sensor_msgs/Image", header(frame), *size, rows.ravel())
    if isinstance(content, JointSample):
        nothing = np.zeros(0)
        values = np.asarray(content.values, float)
        return make(
            "sensor_msgs/JointState", header(""), list(content.names), values, nothing, nothing
        )
    if isinstance(content, Camera):
        K, P = content.matrix.ravel(), np.pad(content.matrix, ((0, 0), (0, 1))).ravel()
        model, region = DISTORTION_MODELS[content.model], (0, 0, 0, 0, False)
        return make(
            "sensor_msgs/CameraInfo",
            header(frame),
            content.height,
            content.width,
            model,
            np.array(content.distortion),
            K,
            np.eye(3).ravel(),
            P,
            0,
            0,
            make("sensor_msgs/RegionOfInterest", *region),
        )

    def transform(each: FramePose) -> Any:
        q = Rotation.from_matrix(each.T_parent_child[:3, :3]).as_quat().tolist()
        t = each.T_parent_child[:3, 3].tolist()
        turn, shift = make("geometry_msgs/Quaternion", *q), make("geometry_msgs/Vector3", *t)
        at = make("geometry_msgs/Transform", shift, turn)
        return make("geometry_msgs/TransformStamped", header(each.parent), each.child, at)

    return types["tf2_msgs/msg/TFMessage"]([transform(each) for each in content])
