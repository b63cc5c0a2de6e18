"""Write bags of ROS 1 and ROS 2 with rosbags, without ROS."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from scipy.spatial.transform import Rotation

from vergence.errors import VergenceError
from vergence.files import whole_file, whole_folder
from vergence.geometry.camera import Camera
from vergence.interchange.ros import DISTORTION_MODELS
from vergence.recordings.recording import Content, JointSample, Message
from vergence.recordings.ros import typestore

Storage = Literal["ros1", "ros2", "mcap"]
"""A ROS 1 bag, and ROS 2 bags in SQLite and in MCAP."""
COMPRESSED = "/compressed"
"""Ending of channels whose images are written as PNG; image_transport names them so."""
_ENCODINGS = {("uint8", 2): "mono8", ("uint8", 3): "rgb8", ("uint16", 2): "mono16"}
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
    that of its first message. VergenceError if the bag exists or cannot be written.
    """
    path, ros1 = Path(path), storage == "ros1"
    if ros1 and path.exists():
        raise VergenceError(f"{path} already exists; name another bag, or remove it.")
    store = typestore(ros1=ros1)
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
    connections: dict[str, Any] = {}
    with (whole_file if ros1 else whole_folder)(path) as part:
        if not ros1:
            part.rmdir()  # the library makes it
        plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
        new = Ros1Writer(part) if ros1 else Ros2Writer(part, version=9, storage_plugin=plugin)
        with new as writer:
            for each in messages:
                ros = _ros_message(each, store.types, ros1=ros1)
                kind, name = ros.__msgtype__, each.channel
                if name not in connections:
                    connections[name] = writer.add_connection(name, kind, typestore=store)
                writer.write(connections[name], each.received_ns, serialize(ros, kind))


def _ros_message(each: Message, types: dict[str, Any], *, ros1: bool) -> Any:
    """Make the ROS message of a content."""

    def make(kind: str, *fields: Any) -> Any:
        return types[kind.replace("/", "/msg/")](*fields)

    def header(frame: str) -> Any:
        stamp = make("builtin_interfaces/Time", *divmod(each.stamp_ns, 1_000_000_000))
        return make("std_msgs/Header", *([0] if ros1 else []), stamp, frame)

    content, frame = each.decode(), each.channel.strip("/").removesuffix(COMPRESSED)
    if isinstance(content, np.ndarray) and each.channel.endswith(COMPRESSED):
        shown = content if content.ndim == 2 else cv2.cvtColor(content, cv2.COLOR_RGB2BGR)
        data = cv2.imencode(".png", shown)[1].ravel()
        return make("sensor_msgs/CompressedImage", header(frame), "png", data)
    if isinstance(content, np.ndarray):
        size, encoding = content.shape[:2], _ENCODINGS[content.dtype.name, content.ndim]
        rows = np.ascontiguousarray(content).view(np.uint8).reshape(len(content), -1)
        fields = header(frame), *size, encoding, 0, rows.shape[1], rows.ravel()
        return make("sensor_msgs/Image", *fields)
    if isinstance(content, JointSample):
        values, nothing = np.asarray(content.values, float), np.zeros(0)
        fields = header(""), list(content.names), values, nothing, nothing
        return make("sensor_msgs/JointState", *fields)
    if isinstance(content, Camera):
        whole = make("sensor_msgs/RegionOfInterest", 0, 0, 0, 0, False)
        lens = DISTORTION_MODELS[content.model], np.array(content.distortion)
        K, P = content.matrix, np.pad(content.matrix, ((0, 0), (0, 1)))
        matrices = (matrix.ravel() for matrix in (K, np.eye(3), P))
        fields = header(frame), content.height, content.width, *lens, *matrices, 0, 0, whole
        return make("sensor_msgs/CameraInfo", *fields)
    transforms = []
    for frame_pose in content:
        q = Rotation.from_matrix(frame_pose.T_parent_child[:3, :3]).as_quat().tolist()
        t = make("geometry_msgs/Vector3", *frame_pose.T_parent_child[:3, 3].tolist())
        transform = make("geometry_msgs/Transform", t, make("geometry_msgs/Quaternion", *q))
        fields = header(frame_pose.parent), frame_pose.child, transform
        transforms.append(make("geometry_msgs/TransformStamped", *fields))
    return types["tf2_msgs/msg/TFMessage"](transforms)
