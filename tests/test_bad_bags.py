"""Damaged and malicious bags: one sentence, in time and within memory."""

import os
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lz4.frame import compress as lz4_compress
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, storage_mcap
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from test_bags import assert_same, bag_name, contents
from vergence.errors import VergenceError
from vergence.recordings.bag import write_bag
from vergence.recordings.formats import open_recording
from vergence.recordings.ros import typestore
from vergence.recordings.scan import scan

Change = Callable[[Path], object]
MOST_S, MOST_BYTES = 10, 10**9
"""Limits of processor time [s] for each bag, and of resident memory [bytes]."""


def refusal(path: Path) -> str:
    """Read all of a recording and return the sentence with which it is refused."""
    with pytest.raises(VergenceError) as refused, open_recording(path) as recording:
        scan(recording, list(recording.channels))
    assert "\n" not in str(refused.value)
    assert str(path) in str(refused.value)
    return str(refused.value)


def written(folder: Path, storage: Any) -> Path:
    path = folder / bag_name(storage)
    write_bag(path, contents(), storage=storage)
    return path


def stored(path: Path) -> Path:
    """The file that holds the messages of a bag."""
    return next(
        each for each in (path, *path.glob("*.db3"), *path.glob("*.mcap")) if each.is_file()
    )


def changed(edit: Callable[[bytes], bytes]) -> Change:
    return lambda path: stored(path).write_bytes(edit(stored(path).read_bytes()))


def cut(content: bytes) -> bytes:
    return content[: len(content) // 2]


def without_index(content: bytes) -> bytes:
    """As a recorder leaves a ROS 1 bag that is killed."""
    at = content.index(b"index_pos=") + len(b"index_pos=")
    return content[:at] + bytes(8) + content[at + 8 :]


def with_long_record(content: bytes) -> bytes:
    """State 20 GB as the size of the first MCAP record."""
    return content[:9] + struct.pack("<Q", 20_000_000_000) + content[17:]


@pytest.mark.parametrize(
    ("storage", "change", "said"),
    [
        ("ros1", changed(cut), "index looks damaged"),
        ("ros2", changed(cut), "malformed|damaged bag"),
        ("mcap", changed(cut), "File end magic is invalid"),
        *((storage, changed(lambda _: b""), "") for storage in ("ros1", "ros2", "mcap")),
        *((storage, changed(lambda _: b"a" * 999), "") for storage in ("ros1", "ros2", "mcap")),
        ("ros1", changed(without_index), "Bag is not indexed, reindex before reading"),
        ("mcap", changed(with_long_record), "Truncated record|damaged bag"),
        ("mcap", lambda path: (path / "metadata.yaml").write_text(""), "Invalid bag metadata"),
        ("mcap", lambda path: (path / "metadata.yaml").write_bytes(b" " * 2**21), "too large"),
        ("mcap", lambda path: (path / "metadata.yaml").unlink(), "is not a recording that can be"),
        ("mcap", lambda path: stored(path).unlink(), "files are missing"),
        ("ros2", lambda path: swapped(stored(path), os.mkfifo), "or not a regular file"),
        ("ros1", lambda path: swapped(path, os.mkfifo), "not a regular file"),
    ],
)  # fmt: skip
def test_a_damaged_bag_is_refused(tmp_path: Path, storage: str, change: Change, said: str):
    path = written(tmp_path, storage)
    change(path)
    sentence = refusal(path)
    assert any(each in sentence for each in said.split("|")), sentence


def swapped(path: Path, make: Callable[[Path], object]) -> None:
    path.unlink()
    make(path)


@pytest.mark.parametrize("linked", ["a.db3", "metadata.yaml"])
def test_files_of_a_bag_lie_in_its_folder(tmp_path: Path, linked: str):
    path = written(tmp_path, "ros2")
    shutil.move(path / linked, tmp_path / linked)
    (path / linked).symlink_to(tmp_path / linked)
    assert f"{path / linked} leads out of the recording's folder" in refusal(path)


def test_metadata_cannot_name_files_outside(tmp_path: Path):
    path = written(tmp_path, "ros2")
    shutil.move(path / "a.db3", tmp_path / "b.db3")
    metadata = path / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("a.db3", "../b.db3"))
    assert "database files are missing" in refusal(path)


def test_other_types_are_listed_and_not_read(tmp_path: Path):
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("float64[] q", "acme_msgs/msg/Arm"))
    with Ros1Writer(tmp_path / "a.bag") as writer:
        arm = writer.add_connection("/arm", "acme_msgs/msg/Arm", typestore=store)
        message = store.types["acme_msgs/msg/Arm"](np.zeros(2))
        writer.write(arm, 10**18, store.serialize_ros1(message, "acme_msgs/msg/Arm"))
    with open_recording(tmp_path / "a.bag") as recording:
        assert recording.channels["/arm"].kind == "other"
        assert list(recording.read(["/arm"], None, None)) == []


@pytest.mark.parametrize("compression", ["bz2", "lz4", "message", "file", "storage"])
def test_compressed_bags_are_read(tmp_path: Path, compression: str):
    path = compressed(written(tmp_path, "ros1" if "z" in compression else "mcap"), compression)
    with open_recording(path) as recording, open_recording(tmp_path / path.name[1:]) as plain:
        names = list(plain.channels)
        found, expected = (list(each.read(names, None, None)) for each in (recording, plain))
        assert len(found) == 21
        assert [each.stamp_ns for each in found] == [each.stamp_ns for each in expected]
        assert_same(found[0].decode(), expected[0].decode())


def compressed(path: Path, compression: str) -> Path:
    """Copy a bag with the library's own compression, for ROS 2 one of its modes."""
    copy, ros1 = path.with_name("c" + path.name), "z" in compression
    reader, writer = (Ros1Reader(path), Ros1Writer(copy)) if ros1 else (
        Reader(path), Ros2Writer(copy, version=9, storage_plugin=StoragePlugin.MCAP))  # fmt: skip
    if isinstance(writer, Ros1Writer):
        writer.set_compression(Ros1Writer.CompressionFormat[compression.upper()])
    else:
        writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with reader, writer:
        new: dict[int, Any] = {
            each.id: writer.add_connection(each.topic, each.msgtype, typestore=typestore(ros1=ros1))
            for each in reader.connections
        }
        for connection, time, data in reader.messages():
            writer.write(new[connection.id], time, data)
    return copy


@pytest.mark.parametrize("suffix", [".db3", ".mcap"])
def test_a_bare_file_is_read(tmp_path: Path, suffix: str):
    path = written(tmp_path, "ros2" if suffix == ".db3" else "mcap")
    with open_recording(path / f"a{suffix}") as recording:
        assert len(list(recording.read(list(recording.channels), None, None))) == 21


BOMB_BYTES = 2**29
"""Zeros in a chunk that is 20,000 times smaller in its file; more take too long to make."""


def lies(folder: Path) -> list[Path]:
    """Write bags that ask for more memory than there is."""
    made = []

    def new(name: str, storage: str) -> Path:
        path = folder / name
        path.mkdir()
        made.append(written(path, storage))
        return made[-1]

    messages = new("messages", "ros1")
    data, at = bytearray(messages.read_bytes()), 0
    while (at := data.find(b"op=\x02", at + 1)) >= 0:  # the first field of a message's header
        length = at - 4 + struct.unpack_from("<I", data, at - 8)[0]
        struct.pack_into("<I", data, length, 2**32 - 1)
    messages.write_bytes(bytes(data))
    record = new("record", "mcap") / "a.mcap"
    record.write_bytes(with_long_record(record.read_bytes()))
    zeros, zstd = bytes(BOMB_BYTES), vars(storage_mcap)["zstd"]
    for compression, packed in (("lz4", lz4_compress(zeros)), ("zstd", zstd.compress(zeros))):
        bomb = new(compression, "mcap") / "a.mcap"
        bomb.write_bytes(mcap_of(compression, packed))
    image = new("image", "mcap") / "a.mcap"
    content = image.read_bytes()
    at = content.index(b"\x06\x00\x00\x00mono8\x00") - 8  # behind height and width
    image.write_bytes(content[:at] + struct.pack("<II", 100_000, 200_000) + content[at + 8 :])
    return made


def mcap_of(compression: str, packed: bytes) -> bytes:
    """Make an MCAP file without a summary, of one chunk."""

    def record(kind: int, content: bytes) -> bytes:
        return struct.pack("<BQ", kind, len(content)) + content

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value)) + value.encode()

    chunk = struct.pack("<QQQI", 0, 1, BOMB_BYTES, 0) + text(compression)
    chunk += struct.pack("<Q", len(packed)) + packed
    magic = b"\x89MCAP0\r\n"
    parts = record(1, text("ros2") + text("")), record(6, chunk), record(2, bytes(20))
    return magic + b"".join(parts) + magic


READ = """
import sys, time
from pathlib import Path
from vergence.errors import VergenceError
from vergence.recordings.formats import open_recording
from vergence.recordings.scan import scan
most_s, *paths = sys.argv[1:]
for path in paths:
    began = time.process_time()
    try:
        with open_recording(path) as recording:
            scan(recording, list(recording.channels))
        print("read", path)
    except VergenceError as error:
        print("refused", error)
    assert time.process_time() - began < float(most_s)
# The usage by `resource` begins with that of the process that started this one.
print(next(l.split()[1] for l in open("/proc/self/status") if l.startswith("VmHWM")))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="memory is measured as on Linux")
def test_bags_that_lie_about_sizes_are_refused_within_memory(tmp_path: Path):
    paths = lies(tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", READ, *map(str, [MOST_S, *paths])],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    *sentences, peak_kb = done.stdout.splitlines()
    assert [each for each in sentences if not each.startswith("refused")] == []
    assert len(sentences) == len(paths)
    assert int(peak_kb) * 1024 < MOST_BYTES
