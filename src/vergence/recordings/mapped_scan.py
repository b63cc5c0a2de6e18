"""Scan what a map needs of a recording, by the times that count."""

from __future__ import annotations

from dataclasses import replace

from vergence.data.description import Description
from vergence.errors import VergenceError, explain
from vergence.progress import Progress, silent
from vergence.recordings.pose_tracks import needed_frames
from vergence.recordings.recording import Recording
from vergence.recordings.recording_map import RecordingMap, describe
from vergence.recordings.scan import Scan, scan


def on_the_clock(recording: Recording, mapped: RecordingMap) -> Recording:
    """Give the messages of a recording the times that count, as the map states."""
    if mapped.stamps == "header":
        return recording
    read = recording.read
    return replace(
        recording,
        read=lambda *span: (replace(each, stamp_ns=each.received_ns) for each in read(*span)),
    )


def scan_mapped(
    recording: Recording, mapped: RecordingMap, *, progress: Progress = silent
) -> tuple[Scan, Description]:
    """Scan what a map needs of a recording `on_the_clock`, and describe the dataset of it.

    VergenceError if the recording is damaged, or does not have what the map names.
    """
    channels = needed_channels(recording, mapped)
    columns = {joint.column for joint in mapped.joints.values()} | set(mapped.readings)
    frames = needed_frames(recording, mapped.poses) if mapped.poses else ()
    scanned = scan(recording, channels, columns=columns, frames=frames, progress=progress)
    for source in mapped.cameras.values():
        if source.images not in scanned.images:
            raise VergenceError(f"{recording.path} has no images in the channel {source.images}.")
    sizes = {name: track.size for name, track in scanned.images.items()}
    try:
        return scanned, describe(mapped, sizes, scanned.lenses)
    except ValueError as error:
        raise VergenceError(f"The map describes no head: {explain(error)}.") from None


def needed_channels(recording: Recording, mapped: RecordingMap) -> list[str]:
    """List the channels that a map needs; VergenceError for one that is missing."""
    named = [source.images for source in mapped.cameras.values()]
    named += [source.lens for source in mapped.cameras.values() if source.lens]
    for name in named:
        if name not in recording.channels:
            raise VergenceError(
                f"{recording.path} has no channel {name}, which the map names; it has "
                f"{', '.join(recording.channels) or 'none'}."
            )
    kinds = ("joints", "poses") if mapped.poses else ("joints",)
    return named + [name for name, each in recording.channels.items() if each.kind in kinds]
