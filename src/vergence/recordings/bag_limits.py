"""Bound the memory that reading a bag takes, which the library does not."""

from __future__ import annotations

from bz2 import BZ2Decompressor
from collections.abc import Callable
from functools import partial
from itertools import accumulate
from pathlib import Path
from typing import Any

import apsw
from lz4.frame import LZ4FrameDecompressor
from rosbags.rosbag1 import reader as ros1_reader
from rosbags.rosbag2 import Reader, ReaderError, storage_mcap

from vergence.files import file_inside, read_bytes

MAX_CHUNK_BYTES = 2**28
"""Largest part of a bag that is held in memory [bytes]; an image of 50 million pixels has 150 MB,
and recorders write parts of 1 to 4 MB."""
MAX_METADATA_BYTES = 2**19
"""Largest metadata.yaml [bytes]; one of 500 topics has 400 kB, which the library parses in 3 s."""
METADATA = "metadata.yaml"
zstd: Any = storage_mcap.zstd  # a module of Python or a package, by the version of Python


def decompress(decompressor: Any, data: bytes, most_bytes: int = MAX_CHUNK_BYTES) -> bytes:
    """Decompress data; ReaderError if there is more of it than stated, or than is read."""
    limit = min(most_bytes, MAX_CHUNK_BYTES)
    content = decompressor().decompress(data, max_length=limit + 1)
    if len(content) > limit:
        raise ReaderError(f"a part of it has more than {limit:,} bytes when it is decompressed")
    return content


_BOUNDED = {
    "bz2": partial(decompress, BZ2Decompressor),
    "lz4": partial(decompress, LZ4FrameDecompressor),
    "zstd": partial(decompress, zstd.ZstdDecompressor),
}
for _library in (ros1_reader.decompressors, storage_mcap.DECOMPRESSORS):
    _library.update({name: _BOUNDED[name] for name in _library.keys() & _BOUNDED.keys()})
apsw.connection_hooks.append(
    lambda connection: connection.limit(apsw.SQLITE_LIMIT_LENGTH, MAX_CHUNK_BYTES)
)


def check_folder(path: Path) -> None:
    """Raise VergenceError if files of a bag lie elsewhere, or are not regular or far too large."""
    for pattern in (METADATA, "*.bag", "*.db3", "*.mcap", "*.zstd"):
        for each in path.glob(pattern):
            file_inside(path, each.name, str(each), of="recording")
    if (path / METADATA).exists():
        read_bytes(path / METADATA, MAX_METADATA_BYTES)


def limit_opened(reader: Reader) -> Callable[[bytes], bytes]:
    """Check an opened bag of ROS 2, and return the function that decompresses its messages.

    ReaderError if reading it would take too much memory: of chunks that overlap in time, all are
    in memory.
    """
    bag: Any = reader.storage
    for storage in getattr(bag, "storages", [bag]):
        changes = []
        for chunk in getattr(storage, "chunks", ()):
            size = chunk.uncompressed_size
            changes += [(chunk.message_start_time, size), (chunk.message_end_time + 1, -size)]
        if max(accumulate(size for _, size in sorted(changes)), default=0) > MAX_CHUNK_BYTES:
            raise ReaderError(f"more than {MAX_CHUNK_BYTES:,} bytes of it are of one moment")
    if bag.metadata.compression_mode != "message":
        return lambda data: data
    bag.metadata = bag.metadata._replace(compression_mode=None)
    return _BOUNDED["zstd"]
