"""Commands that read recordings of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import vergence as vg
from vergence.cli.options import Optional, Positional, check_outputs
from vergence.cli.report import Report
from vergence.cli.terminal import progress_bars
from vergence.errors import VergenceError, counted


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


def export_poses(
    calibration: Positional[Path],
    recording: Positional[Path],
    /,
    *,
    out: Path,
    format: Literal["csv", "parquet", "tf"] = "csv",
    map: Optional[Path] = None,
) -> Report:
    """Write where the cameras were in each image of a recording, with lenses and joint readings.

    Args:
        calibration: JSON file that `vergence calibrate` wrote.
        recording: Folder of a dataset, or a recording as for import-recording.
        out: File to write; for tf a new bag: a ROS 1 .bag, or a folder for ROS 2.
        format: A table as csv or parquet, or transforms (tf) from frame head to the cameras.
        map: TOML file that names the recording's cameras, joints and board; left out: map.toml in
            the folder that holds the recording.
    """
    from vergence.data.description import DESCRIPTION
    from vergence.recordings.camera_poses import dataset_poses, recording_poses
    from vergence.recordings.pose_files import WRITERS
    from vergence.recordings.recording_map import MAP, load_map

    if not recording.exists():
        raise VergenceError(f"There is no recording {recording}.")
    is_dataset = (recording / DESCRIPTION).is_file()
    map = map or recording.parent / MAP
    if format == "tf":
        if out.exists():
            raise VergenceError(f"{out} already exists; name another bag, or remove it.")
    else:
        check_outputs(out, inputs=[calibration, recording, None if is_dataset else map])
    head = vg.load_head(calibration)
    with progress_bars() as progress:
        if is_dataset:
            poses = dataset_poses(vg.load_dataset(recording), head, progress=progress)
        else:
            poses = recording_poses(recording, load_map(map), head, progress=progress)
    WRITERS[format](poses, out)
    text = [f"{counted(len(poses.camera), 'pose')} of {counted(len(poses.left_out), 'camera')}."]
    text += [
        f"{counted(count, 'image')} of {name} left out: no joint readings at the moment."
        for name, count in poses.left_out.items()
        if count
    ]
    return Report("Poses", (" ".join(text),), None, files=f"Wrote {out}.")
