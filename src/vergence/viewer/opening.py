"""The file of a recording, with what does not change over time; reports in markdown."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
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
        rr.RecordingStream(style.APPLICATION, recording_id=recording_id) as rec,
    ):
        rec.save(part, default_blueprint=layout)
        rec.set_log_time_enabled(False)  # recordings of one seed stay comparable
        rec.send_recording_name(f"{title} ({folder.name})")
        rec.log("world", rr.ViewCoordinates.FLU, static=True)
        log_geoms(rec, geoms)
        log_cameras(rec, head)
        yield rec


def markdown_table(heading: str, rows: Iterable[Sequence[object]]) -> str:
    """Return a table in markdown, whose heading has its cells divided by vertical bars."""
    lines = [f"| {heading} |", "|" + "---|" * (heading.count("|") + 1)]
    return "\n".join(lines + ["| " + " | ".join(map(str, row)) + " |" for row in rows])


def log_report(rec: rr.RecordingStream, markdown: str) -> None:
    """Record a report, which the viewer shows beside the data."""
    rec.log("report", rr.TextDocument(markdown, media_type=rr.MediaType.MARKDOWN), static=True)
