"""Commands that read recordings of other programs."""

from __future__ import annotations

from pathlib import Path

from vergence.cli.options import Optional, Positional, check_outputs
from vergence.cli.report import Report
from vergence.cli.terminal import progress_bars
from vergence.errors import counted


def import_recording(
    source: Positional[Path], /, *, map: Optional[Path] = None, out: Optional[Path] = None
) -> Report:
    """Make a dataset of a robot's recording, such as a ROS bag.

    Args:
        source: Recording: a ROS 1 .bag, or a ROS 2 folder, .db3 or .mcap.
        map: TOML file that names the recording's cameras, joints and board; left out: map.toml in
            the folder that holds the recording.
        out: Folder of the dataset to write.
    """
    from vergence.recordings.import_recording import import_recording as import_mapped
    from vergence.recordings.recording_map import MAP, load_map

    map = map or source.parent / MAP
    check_outputs(folder=out, inputs=[map])
    mapped = load_map(map)
    assert out is not None
    with progress_bars() as progress:
        found = import_mapped(source, mapped, out, progress=progress)
    text = (
        f"{counted(found.frames, 'frame')}, {found.moving} of them in motion; the board stood at "
        f"{counted(found.placements, 'place')}."
    )
    return Report("Recording", (text,), None, files=f"Wrote {out}.")
