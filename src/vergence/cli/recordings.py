"""Commands that read recordings of other programs."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Literal

import vergence as vg
from vergence.cli.options import DATASET_FILES, Optional, Positional, check_outputs
from vergence.cli.report import Report
from vergence.cli.terminal import invocation, progress_bars
from vergence.errors import VergenceError, counted
from vergence.files import markdown_table, write_whole

if TYPE_CHECKING:
    from vergence.data.dataset import Dataset
    from vergence.progress import Progress
    from vergence.recordings.recording_map import RecordingMap

MAP = "map.toml"
"""Name of the map in the folder that holds a recording."""
_JOINTS = 60
"""Most joints that a listing shows."""


def import_recording(
    source: Positional[Path], /, *, map: Optional[Path] = None, out: Optional[Path] = None
) -> Report:
    """Make a dataset of a robot's recording, or list what is in it.

    Args:
        source: Recording: a ROS 1 .bag; a ROS 2 folder, .db3 or .mcap; a folder of yarpdatadumper;
            an episode of a LeRobot dataset as FOLDER/episode_3; a csv, or a folder
            with csv of joints and images or videos.
        map: TOML file that names cameras, joints and board of the recording; left out: map.toml in
            the folder that holds the recording. Without --out a first one is written there.
        out: Folder of the dataset to write; left out: the contents of the recording are listed.
    """
    from vergence.recordings.import_recording import import_recording as import_mapped

    if out is None:
        return _listed(source, map or source.parent / MAP)
    check_outputs(folder=out, inputs=[map])
    mapped = _map_of(source, map)
    with progress_bars() as progress:
        dataset = import_mapped(source, mapped, out, progress=progress)
    text = f"{counted(len(dataset), 'frame')}, {dataset.moving.sum()} of them with moving eyes"
    if mapped.board is not None:
        text += f"; the board stood at {counted(len(set(dataset.placement)), 'place')}"
    parts = (f"{text}.", *(finding.sentence for finding in dataset.findings))
    return Report("Recording", parts, None, files=f"Wrote {out}.")


def _listed(source: Path, place: Path) -> Report:
    """List what is in a recording, and write a first map unless there is one."""
    import numpy as np

    from vergence.recordings.first_map import first_map
    from vergence.recordings.formats import open_recording
    from vergence.recordings.recording_map import UNKNOWN, load_map
    from vergence.recordings.scan import scan

    there = os.path.exists(place)
    if there:
        load_map(place)
    else:
        check_outputs(place, inputs=[source])
    with progress_bars() as progress, open_recording(source) as recording:
        scanned = scan(recording, progress=progress)
        text = "" if there else first_map(scanned)
        channels = recording.channels
    stamps = {channel: [track.stamp_ns] for channel, track in scanned.images.items()}
    for (channel, _), track in scanned.joints.items():  # a message may have some of the joints
        stamps.setdefault(channel, []).append(track.stamp_ns)
    rows = []
    for name, each in channels.items():
        times_ns = np.unique(np.concatenate(stamps.get(name, [np.empty(0)])))
        steps_s = np.sort(np.diff(times_ns)) * 1e-9
        rate = f"{1 / steps_s[len(steps_s) // 2]:.3g}" if len(steps_s) else ""
        size = "x".join(map(str, scanned.sizes[name])) if name in scanned.sizes else ""
        gap = f"{steps_s[-1]:.3g}" if len(steps_s) else ""
        rows.append((name, each.type, each.count, rate, gap, scanned.errors.get(name, size)))
    heading = "channel | type | messages | per second | largest gap [s] | size"
    parts = [markdown_table(heading, rows)]
    joints = [
        (name, channel, f"{track.values.min():.4g}", f"{track.values.max():.4g}")
        for (channel, name), track in [*scanned.joints.items()][:_JOINTS]
    ]
    if joints:
        parts.append(markdown_table("joint | channel | lowest | highest", joints))
    command = invocation("vergence", "import-recording", source, "--out", "DATASET")
    if there:
        return Report("Recording", parts, None, files=f"{place} is complete. Next: {command}")
    write_whole(place, text)
    missing = sum(f'"{UNKNOWN}"' in line for line in text.splitlines()[1:])
    todo = f"correct its guesses, fill in {counted(missing, 'value')}" if missing else "check it"
    return Report("Recording", parts, None, files=f"Wrote {place}: {todo}. Then: {command}")


def _map_of(source: Path, place: Path | None) -> RecordingMap:
    """Load the map of a recording; None: the one in the folder that holds it."""
    from vergence.recordings.formats import open_recording
    from vergence.recordings.recording_map import load_map

    place = place or source.parent / MAP
    if not os.path.exists(place):
        with open_recording(source):  # VergenceError if there is no recording either
            command = invocation("vergence", "import-recording", source)
            raise VergenceError(f"{source} has no map {place}; {command} writes a first one.")
    return load_map(place)


@contextmanager
def dataset_of(path: Path, progress: Progress) -> Iterator[Dataset]:
    """Load a dataset, or import a recording by its map into a temporary one."""
    from vergence.recordings.formats import is_recording
    from vergence.recordings.import_recording import import_recording as import_mapped

    if any(os.path.exists(path / name) for name in DATASET_FILES) or not is_recording(path):
        yield vg.load_dataset(path)
        return
    mapped = _map_of(path, None)
    with TemporaryDirectory(prefix="vergence-") as folder:
        place = Path(folder) / path.name
        yield import_mapped(path, mapped, place, progress=progress)


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
    from vergence.recordings.camera_poses import dataset_poses, recording_poses, write_poses
    from vergence.recordings.formats import open_recording
    from vergence.recordings.moments import scan_mapped

    if format == "tf" and out.exists():
        raise VergenceError(f"{out} already exists; name another bag, or remove it.")
    check_outputs(None if format == "tf" else out, inputs=[calibration, recording, map])
    head = vg.load_head(calibration)
    with progress_bars() as progress:
        if (recording / DESCRIPTION).is_file():
            poses = dataset_poses(vg.load_dataset(recording), head, progress=progress)
        else:
            mapped = _map_of(recording, map)
            with open_recording(recording, stamps=mapped.stamps) as opened:
                scanned = scan_mapped(opened, mapped, progress=progress)
            poses = recording_poses(*scanned, mapped, head, progress=progress)
    write_poses(poses, head, out, format)
    text = "; ".join(
        f"{counted(len(each.index), 'pose')} of {each.camera}, {counted(each.left_out, 'image')} "
        "without joint readings at the moment"
        for each in poses
    )
    return Report("Poses", (f"{text}.",), None, files=f"Wrote {out}.")
