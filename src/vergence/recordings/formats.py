"""Formats of recordings, and opening a recording of any of them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from vergence.errors import VergenceError
from vergence.recordings import lerobot, ros, tables, yarp
from vergence.recordings.recording import Message, Recording
from vergence.recordings.recording_map import Stamps

FORMATS = (ros, yarp, lerobot, tables)
"""Modules with `recognise` and `open_recording`, asked in this order."""


def is_recording(path: Path) -> bool:
    """Test whether a path looks like a recording of a known format."""
    return any(format.recognise(path) for format in FORMATS)


@contextmanager
def open_recording(path: Path | str, *, stamps: Stamps = "header") -> Iterator[Recording]:
    """Open a recording of any known format for a `with` block, with the stamps that count.

    VergenceError if it is missing, damaged, or of an unknown format.
    """
    path = Path(path)
    if path.suffix and not os.path.exists(path):  # an episode is no path of its own
        raise VergenceError(f"There is no recording {path}.")
    for format in FORMATS:
        if format.recognise(path):
            with format.open_recording(path) as recording:
                yield recording if stamps == "header" else _as_received(recording)
            return
    if not os.path.exists(path):
        raise VergenceError(f"There is no recording {path}.")
    raise VergenceError(
        f"{path} is not a recording that can be read: a ROS 1 .bag, a ROS 2 folder, .db3 or .mcap, "
        "a folder of yarpdatadumper, an episode of a LeRobot dataset, or a csv with images."
    )


def _as_received(recording: Recording) -> Recording:
    def read(*asked: Any) -> Iterator[Message]:
        return (replace(m, stamp_ns=m.received_ns) for m in recording.read(*asked))

    return replace(recording, read=read)
