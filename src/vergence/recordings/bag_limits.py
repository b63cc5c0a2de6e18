"""Limits of bags, which may be damaged or malicious; the library has none.

docs/security.md states them.
"""

from __future__ import annotations

import os
from bz2 import BZ2Decompressor
from collections.abc import Callable
from functools import partial
from itertools import accumulate
from pathlib import Path
from typing import Any

import apsw
from lz4.frame import LZ4FrameDecompressor
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag1 import reader as ros1_reader
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.rosbag2 import storage_mcap

from vergence.errors import VergenceError

MAX_CHUNK_BYTES = 2**28
"""Largest part of a bag that is held in memory [bytes]; an image of 50 million pixels has 150 MB,
and recorders write parts of 1 to 4 MB."""
MAX_METADATA_BYTES = 2**20
"""Largest metadata.yaml [bytes]; one of 500 topics has 400 kB."""
MAX_EXPANSION = 100
"""Most bytes that one byte of a bag compressed as a whole may stand for; of camera images it is 1
to 4."""
_BLOCK_BYTES = 2**20
"""Size of the blocks [bytes] in which a compressed file is measured."""
zstd: Any = storage_mcap.zstd  # a module of Python or a package, by the version of Python


def decompress(decompressor: Any, data: bytes, most_bytes: int = MAX_CHUNK_BYTES) -> bytes:
    """Decompress data; VergenceError if there is more of it than stated."""
    limit = min(most_bytes, MAX_CHUNK_BYTES)
    content = decompressor().decompress(data, max_length=limit + 1)
    if len(content) > limit:
        raise VergenceError(
            f"A part of the bag has more than {limit:,} bytes when it is decompressed; it is "
            "damaged, or far too large."
        )
    return content


# The library's own functions decompress without a limit, and SQLite computes what a file asks for.
ros1_reader.decompressors |= {
    "bz2": partial(decompress, BZ2Decompressor),
    "lz4": partial(decompress, LZ4FrameDecompressor),
}
storage_mcap.DECOMPRESSORS |= {
    "lz4": partial(decompress, LZ4FrameDecompressor),
    "zstd": partial(decompress, zstd.ZstdDecompressor),
}


def _limit_database(connection: apsw.Connection) -> None:
    connection.limit(apsw.SQLITE_LIMIT_LENGTH, MAX_CHUNK_BYTES)
    connection.config(apsw.SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0)


apsw.connection_hooks.append(_limit_database)


class BoundedRos1Reader(Ros1Reader):
    """Reads ROS 1 bags whose index lists each chunk once.

    A small index that lists one chunk many times would take any amount of memory.
    """

    def __init__(self, path: Path) -> None:
        """Name the bag."""
        super().__init__(path)
        self._listed: set[int] = set()

    def read_chunk_info(self) -> Any:
        """Read where a chunk is; VergenceError if it was listed before."""
        info = super().read_chunk_info()
        if info.pos in self._listed:
            raise VergenceError(f"{self.path} is damaged: its index lists a chunk twice.")
        self._listed.add(info.pos)
        return info


def check_folder(path: Path) -> None:
    """Raise VergenceError if files of a bag lie elsewhere, or are not regular or far too large."""
    root = path.resolve()
    for each in path.iterdir():
        if each.suffix not in (".yaml", ".bag", ".db3", ".mcap", ".zstd"):
            continue
        try:
            inside = each.resolve(strict=True).is_relative_to(root)
        except (OSError, RuntimeError):  # a link to nothing, or to itself
            inside = False
        if not inside:
            raise VergenceError(f"{each} leads out of the recording's folder.")
        if not each.is_file():
            raise VergenceError(f"{each} is not a regular file.")
    metadata = path / "metadata.yaml"
    if os.path.exists(metadata) and metadata.stat().st_size > MAX_METADATA_BYTES:
        raise VergenceError(
            f"{metadata} is too large: it has at most {MAX_METADATA_BYTES:,} bytes."
        )
    for each in path.glob("*.zstd"):
        _check_expansion(each)


def _check_expansion(path: Path) -> None:
    """Raise VergenceError if a compressed file would fill the disk."""
    limit, size = path.stat().st_size * MAX_EXPANSION + MAX_CHUNK_BYTES, 0
    with path.open("rb") as file, zstd.open(file, "rb") as content:
        while block := content.read(_BLOCK_BYTES):
            size += len(block)
            if size > limit:
                raise VergenceError(
                    f"{path} has more than {limit:,} bytes when it is decompressed."
                )


def limit_opened(reader: Ros2Reader) -> Callable[[bytes], bytes]:
    """Check an opened bag, and return the function that decompresses its messages.

    VergenceError if reading it would take too much memory.
    """
    bag: Any = reader.storage
    for storage in getattr(bag, "storages", [bag]):
        # Chunks that overlap in time are in memory at once.
        changes = []
        for chunk in getattr(storage, "chunks", ()):
            size = chunk.uncompressed_size
            changes += [(chunk.message_start_time, size), (chunk.message_end_time + 1, -size)]
        together = max(accumulate(size for _, size in sorted(changes)), default=0)
        if together > MAX_CHUNK_BYTES:
            raise VergenceError(
                f"{reader.path} has {together:,} bytes of messages that were received at one time; "
                f"at most {MAX_CHUNK_BYTES:,} are read."
            )
    if bag.metadata.compression_mode != "message":
        return lambda data: data
    bag.metadata = bag.metadata._replace(compression_mode=None)
    return partial(decompress, zstd.ZstdDecompressor)
