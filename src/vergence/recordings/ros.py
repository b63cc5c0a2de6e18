"""Read bags of ROS 1 and ROS 2 with rosbags, without ROS.

Messages are decoded by ROS's own definitions of the types in KINDS, which are the same in all its
versions. Definitions in a bag are not used: the library makes code of them.
"""

from __future__ import annotations

import os
from bz2 import BZ2Decompressor
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache, partial
from itertools import groupby
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from lz4.frame import LZ4FrameDecompressor
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag1 import reader as ros1_library
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.rosbag2 import storage_mcap as mcap_library
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from scipy.spatial.transform import Rotation

from vergence.data.images import decode_image
from vergence.errors import VergenceError, explain
from vergence.files import file_inside, read_bytes
from vergence.geometry.camera import Camera
from vergence.geometry.se3 import pose
from vergence.interchange.ros import LENS_MODELS
from vergence.interchange.serialization import camera_of
from vergence.recordings.recording import (
    Channel,
    Content,
    FramePose,
    JointSample,
    Kind,
    Message,
    Recording,
)

SUFFIXES = (".bag", ".db3", ".mcap")
METADATA = "metadata.yaml"
KINDS: dict[str, Kind] = {
    "sensor_msgs/msg/Image": "images",
    "sensor_msgs/msg/CompressedImage": "images",
    "sensor_msgs/msg/CameraInfo": "lens",
    "sensor_msgs/msg/JointState": "joints",
    "tf2_msgs/msg/TFMessage": "poses",
    "tf/msg/tfMessage": "poses",
}
"""Kinds of channel by the type of their messages."""
MAX_CHUNK_BYTES = 2**28
"""Largest part of a bag that is decompressed [bytes]; an image of 50 million pixels has 150 MB, and
recorders write parts of 1 to 4 MB."""
MAX_METADATA_BYTES = 2**19
"""Largest metadata.yaml [bytes]; one of 500 topics has 400 kB, which the library parses in 3 s."""

_ENCODINGS: dict[str, tuple[str, int, int | None]] = {
    "mono8": ("u1", 1, None),
    "8UC1": ("u1", 1, None),
    "mono16": ("u2", 1, None),
    "16UC1": ("u2", 1, None),
    "rgb8": ("u1", 3, None),
    "bgr8": ("u1", 3, cv2.COLOR_BGR2RGB),
    "8UC3": ("u1", 3, cv2.COLOR_BGR2RGB),
    "rgba8": ("u1", 4, cv2.COLOR_RGBA2RGB),
    "bgra8": ("u1", 4, cv2.COLOR_BGRA2RGB),
    "yuv422": ("u1", 2, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": ("u1", 2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": ("u1", 2, cv2.COLOR_YUV2RGB_YUY2),
    "yuyv": ("u1", 2, cv2.COLOR_YUV2RGB_YUY2),
    **{
        f"bayer_{order}{8 * size}": (f"u{size}", 1, getattr(cv2, f"COLOR_Bayer{order.upper()}2RGB"))
        for order in ("rggb", "bggr", "gbrg", "grbg")
        for size in (1, 2)
    },
}
"""Type, channels and conversion by name of the encoding."""


@cache
def typestore(*, ros1: bool) -> Typestore:
    """Make the library's store of message types, with all types in KINDS."""
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    for name in KINDS.keys() - store.types.keys() if ros1 else ():
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
    return store


def recognise(path: Path) -> bool:
    """Test whether a path is a bag by its name or its metadata."""
    return path.suffix in SUFFIXES or os.path.exists(path / METADATA)


@contextmanager
def open_recording(path: Path) -> Iterator[Recording]:
    """Open a bag; VergenceError if it is damaged."""
    _check_files(path)
    with ExitStack() as stack:
        _bound_decompression(stack)
        with _explained(str(path)):
            ros1 = path.suffix == ".bag" and path.is_file()
            reader = stack.enter_context(Ros1Reader(path) if ros1 else Ros2Reader(path))
            channels = {
                name: Channel(name, KINDS.get(kind or "", "other"), str(kind), count)
                for name, (kind, _, count, _) in reader.topics.items()
            }
        yield Recording(path, channels, partial(_read, path, reader))


def _check_files(path: Path) -> None:
    """Raise VergenceError where the library would open a pipe, a file elsewhere or a huge list."""
    if os.path.isdir(path):
        for each in path.iterdir():
            if each.suffix in (*SUFFIXES, ".yaml", ".zstd"):
                file_inside(path, each.name, str(each), of="recording")
        read_bytes(path / METADATA, MAX_METADATA_BYTES)
    elif not os.path.isfile(path):
        raise VergenceError(f"{path} is not a regular file.")


def _bound_decompression(stack: ExitStack) -> None:
    """Bound what the library decompresses, which it does in one piece, while a bag is open."""

    def decompress(decompressor: Any, data: bytes, stated: int = MAX_CHUNK_BYTES) -> bytes:
        limit = min(stated, MAX_CHUNK_BYTES)
        content = decompressor().decompress(data, max_length=limit + 1)
        if len(content) > limit:
            raise ValueError(f"a part of it has more than {limit:,} bytes when decompressed")
        return content

    zstd = vars(mcap_library)["zstd"]  # a module of Python or a package, by the version of Python
    decompressors = {
        "bz2": BZ2Decompressor,
        "lz4": LZ4FrameDecompressor,
        "zstd": zstd.ZstdDecompressor,
    }
    tables: list[dict[str, Any]] = [ros1_library.decompressors, mcap_library.DECOMPRESSORS]
    for table in tables:
        stack.callback(table.update, dict(table))
        for name in table.keys() & decompressors.keys():
            table[name] = partial(decompress, decompressors[name])


@contextmanager
def _explained(what: str) -> Iterator[None]:
    """Raise errors of the library, which are of many kinds for damaged bags, as VergenceError."""
    try:
        yield
    except VergenceError:
        raise
    except Exception as error:
        reason = explain(error) or type(error).__name__
        raise VergenceError(f"{what} is damaged, or cannot be read: {reason}.") from error


def _read(
    path: Path,
    reader: Ros1Reader | Ros2Reader,
    names: Collection[str],
    start: int | None,
    stop: int | None,
) -> Iterator[Message]:
    connections = [c for c in reader.connections if c.topic in names and c.msgtype in KINDS]
    ros1 = isinstance(reader, Ros1Reader)
    deserialize = getattr(typestore(ros1=ros1), "deserialize_" + ("ros1" if ros1 else "cdr"))
    with _explained(str(path)):
        messages = reader.messages(connections, start, stop) if connections else ()
        for connection, received_ns, raw in messages:
            message: Any = deserialize(raw, connection.msgtype)
            if KINDS[connection.msgtype] == "poses":  # each has a header
                parts = [
                    (stamp_ns, partial(_poses, list(each)))
                    for stamp_ns, each in groupby(message.transforms, _stamp_ns)
                ]
            else:
                parts = [(_stamp_ns(message), partial(_content, message, connection.msgtype))]
            for stamp_ns, content in parts:
                decode = _explained(f"A message of {path}: {connection.topic}")(content)
                yield Message(connection.topic, stamp_ns, received_ns, decode)


def _stamp_ns(message: Any) -> int:
    """Take the stamp of a header."""
    stamp = message.header.stamp
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def _content(message: Any, type_name: str) -> Content:
    kind = KINDS[type_name]
    if kind == "images":
        return raw_image(message) if hasattr(message, "step") else compressed_image(message)
    if kind == "lens":
        return camera_lens(message)
    n = min(len(message.name), len(message.position))  # a message may have velocities only
    values = np.array(message.position[:n], float)
    stated = np.flatnonzero(np.isfinite(values))
    return JointSample(tuple(message.name[k] for k in stated), values[stated])


def _poses(transforms: list[Any]) -> tuple[FramePose, ...]:
    poses = []
    for tf in transforms:
        t, q = tf.transform.translation, tf.transform.rotation
        if not abs(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w - 1) < 0.1:
            raise ValueError("the norm of a quaternion is not 1")
        T = pose(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), [t.x, t.y, t.z])
        poses.append(FramePose(tf.header.frame_id.strip("/"), tf.child_frame_id.strip("/"), T))
    return tuple(poses)


def raw_image(message: Any) -> np.ndarray:
    """Decode an Image."""
    if message.encoding not in _ENCODINGS:
        known = ", ".join(_ENCODINGS)
        raise ValueError(f"its encoding is {message.encoding!r:.40}; known are {known}")
    kind, channels, conversion = _ENCODINGS[message.encoding]
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    height, width, step = message.height, message.width, message.step
    stored = np.asarray(message.data, np.uint8)[: height * step].reshape(height, step)
    rows = np.ascontiguousarray(stored[:, : width * channels * dtype.itemsize])
    image = rows.view(dtype).astype(kind, copy=False).reshape(height, width, channels)
    image = image[:, :, 0] if channels == 1 else image
    if not image.size:
        raise ValueError("its image has no pixels")
    return image if conversion is None else cv2.cvtColor(image, conversion)


def compressed_image(message: Any) -> np.ndarray:
    """Decode a CompressedImage."""
    image = decode_image(np.asarray(message.data, np.uint8).tobytes())
    if image is None:
        raise ValueError(f"its image of format {message.format!r:.60} is damaged, or far too large")
    return image


def camera_lens(message: Any) -> Camera:
    """Read the lens of a CameraInfo of ROS 1, with K and D, or of ROS 2, with k and d."""
    ros1, name = hasattr(message, "K"), message.distortion_model
    matrix, distortion = (message.K, message.D) if ros1 else (message.k, message.d)
    if not distortion.any() and name not in LENS_MODELS:
        name = "plumb_bob"
    if name not in LENS_MODELS:
        raise ValueError(f"its lens model is {name!r:.40}; known are {', '.join(LENS_MODELS)}")
    size = message.width, message.height
    return camera_of(size, matrix.reshape(3, 3), LENS_MODELS[name], distortion)
