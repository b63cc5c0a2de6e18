"""The file of a recording, with what does not change over time; reports in markdown."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import rerun as rr
import rerun.blueprint as rrb

from vergence.files import whole_file
from vergence.geometry.head import HeadCalibration
from vergence.viewer import style
from vergence.viewer.shapes import log_cameras, log_geoms

if TYPE_CHECKING:  # the twin, and with it mujoco, is not needed to record a real head
    from vergence.twin.appearance import VisualGeom

Recording = rr.RecordingStream
"""A recording that is being written, for rooms that do not import rerun."""
_BATCHES = rr.ChunkBatcherConfig(flush_tick=10.0)
"""Rows of an entity that come within ten seconds are stored together: for each batch rerun keeps a
record in memory, and at every frame these would add up to 25 kB."""


@contextmanager
def recording_file(
    path: Path,
    title: str,
    layout: rrb.Blueprint,
    head: HeadCalibration,
    geoms: Sequence[VisualGeom],
) -> Iterator[rr.RecordingStream]:
    """Record in a `with` block; the file appears as that of `whole_file`, when the block ends well.

    The head's cameras are drawn, and the visible shapes of the robot, of which there may be none.
    The name of the folder is added to the title.
    """
    rr.set_strict_mode(True)  # by default bad data is dropped with a warning
    folder = path.resolve().parent
    # The viewer merges recordings that have the same id: those of two runs must differ.
    recording_id = f"{folder.name}-{path.stem}"
    with (
        whole_file(path) as part,
        _noticing_errors(part) as sink,
        rr.RecordingStream(
            style.APPLICATION, recording_id=recording_id, batcher_config=_BATCHES
        ) as rec,
    ):
        rec.save(sink, default_blueprint=layout)
        rec.set_log_time_enabled(False)  # recordings of one seed stay comparable
        rec.send_recording_name(f"{title} ({folder.name})")
        rec.log("world", rr.ViewCoordinates.FLU, static=True)
        log_geoms(rec, geoms)
        log_cameras(rec, head)
        yield rec


@contextmanager
def _noticing_errors(path: Path) -> Iterator[str]:
    """Give a `with` block a pipe for rerun to write to, and copy what comes out of it to a file.

    Rerun's own writer only logs that a disk is full, and waits for ever afterwards. OSError, when
    the block ends, if the file could not be written.
    """
    if sys.platform == "win32":
        yield str(path)
        return
    errors: list[OSError] = []
    file = path.open("wb", buffering=0)
    source, sink = os.pipe()

    def copy() -> None:
        with os.fdopen(source, "rb", buffering=0) as pipe, file:
            while data := pipe.read(1 << 20):
                try:
                    while data and not errors:  # after an error the pipe is emptied, so that
                        data = data[file.write(data) :]  # whoever fills it can end
                except OSError as error:
                    errors.append(error)

    copier = threading.Thread(target=copy)
    copier.start()
    try:
        yield f"/dev/fd/{sink}"
    finally:
        os.close(sink)
        copier.join()
    if errors:
        raise errors[0]


def log_report(rec: rr.RecordingStream, markdown: str) -> None:
    """Record a report, which the viewer shows beside the data."""
    rec.log("report", rr.TextDocument(markdown, media_type=rr.MediaType.MARKDOWN), static=True)
