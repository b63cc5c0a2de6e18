"""Open the file of a recording: whole or not there, with its layout and what never changes."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import rerun as rr
import rerun.blueprint as rrb

from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration

if TYPE_CHECKING:  # the twin, and with it mujoco, is not needed to record a real head
    from vergence.twin.appearance import VisualGeom
from vergence.viewer import style
from vergence.viewer.shapes import log_cameras, log_geoms


@contextmanager
def recording_file(
    path: Path,
    title: str,
    layout: rrb.Blueprint,
    head: HeadCalibration,
    geoms: Sequence[VisualGeom],
) -> Iterator[rr.RecordingStream]:
    """Record in a `with` block.

    The file appears under its name only when the block ends well: an interrupted run leaves no
    half a file.

    Args:
        path: of the `.rrd` file; one that is there is replaced.
        title: of the recording; the name of its folder is added.
        layout: what the viewer shows when it is opened.
        head: whose cameras are drawn, as it is believed to be.
        geoms: the head's shapes.

    Raises:
        VergenceError: the file cannot be written.
    """
    rr.set_strict_mode(True)  # by default bad data is dropped with a warning
    part = path.with_name(f".{path.name}.part")
    folder = path.resolve().parent
    try:
        if path.is_dir():  # found out now, not when all is recorded
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        folder.mkdir(parents=True, exist_ok=True)
        part.write_bytes(b"")  # rerun's own message names neither the file nor the reason
    except OSError as error:
        raise VergenceError(f"Cannot write {path}: {error.strerror}.") from error
    try:
        # The viewer takes recordings of one id for one: those of two runs must differ.
        with rr.RecordingStream(
            style.APPLICATION, recording_id=f"{folder.name}-{path.stem}"
        ) as rec:
            rec.save(part, default_blueprint=layout)
            rec.set_log_time_enabled(False)  # recordings of one seed stay comparable
            rec.send_recording_name(f"{title} ({folder.name})")
            rec.log("world", rr.ViewCoordinates.FLU, static=True)
            log_geoms(rec, geoms)
            log_cameras(rec, head)
            yield rec
        os.replace(part, path)
    except OSError as error:
        raise VergenceError(f"Cannot write {path}: {error.strerror}.") from error
    finally:
        part.unlink(missing_ok=True)
