"""Read what a map needs of a recording: one scan, then images of chosen moments."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from vergence.data.description import Description
from vergence.errors import VergenceError, explain
from vergence.progress import Progress, silent
from vergence.recordings.moments import Moments
from vergence.recordings.pose_tracks import needed_frames
from vergence.recordings.recording import Recording
from vergence.recordings.recording_map import RecordingMap, describe
from vergence.recordings.scan import ImageTrack, Scan, scan

JOINED_NS = 10**9
"""Images received within this time [ns] are read in one go: to seek takes as long as to read on for
some tenths of a second."""


def on_the_clock(recording: Recording, mapped: RecordingMap) -> Recording:
    """Give the messages of a recording the times that count, as the map states."""
    read = recording.read
    if mapped.stamps == "received":
        return replace(
            recording,
            read=lambda *span: (replace(each, stamp_ns=each.received_ns) for each in read(*span)),
        )
    return recording


def scan_mapped(
    recording: Recording, mapped: RecordingMap, *, progress: Progress = silent
) -> tuple[Scan, Description]:
    """Scan what a map needs of a recording `on_the_clock`, and describe the dataset of it.

    VergenceError if the recording is damaged, or does not have what the map names.
    """
    sources = mapped.cameras.values()
    images, lenses = [each.images for each in sources], [each.lens for each in sources if each.lens]
    for name, kind in (
        *((name, "images") for name in images),
        *((each, "lens") for each in lenses),
    ):
        channel = recording.channels.get(name)
        if channel is None or channel.kind != kind or not channel.count:
            has = ", ".join(n for n, each in recording.channels.items() if each.kind == kind)
            raise VergenceError(
                f"{recording.path} has no {kind} in a channel {name}, which the map names; "
                f"channels of that kind are {has or 'missing'}."
            )
    kinds = ("joints", "poses") if mapped.poses else ("joints",)
    others = [name for name, each in recording.channels.items() if each.kind in kinds]
    columns = {joint.column for joint in mapped.joints.values()} | set(mapped.readings)
    frames = needed_frames(recording, mapped.poses) if mapped.poses else ()
    scanned = scan(
        recording, [*images, *lenses, *others], columns=columns, frames=frames, progress=progress
    )
    sizes = {name: track.size for name, track in scanned.images.items()}
    try:
        return scanned, describe(mapped, sizes, scanned.lenses)
    except ValueError as error:
        raise VergenceError(f"The map describes no head: {explain(error)}.") from None


def read_images(
    recording: Recording,
    tracks: Mapping[str, ImageTrack],
    channels: Mapping[str, str],
    moments: Moments,
    rows: np.ndarray,
) -> Iterator[dict[str, np.ndarray]]:
    """Yield the images by camera of moments (F,), in their order.

    `tracks` are by channel, and `channels` by camera. VergenceError if an image is damaged.
    """
    wanted: dict[tuple[str, int, int], tuple[int, str]] = {}
    missing = [0] * len(rows)
    for camera, channel in channels.items():
        images, track = moments.images[camera][rows], tracks[channel]
        for k in np.flatnonzero(images >= 0).tolist():
            stamp_ns, received_ns = track.stamp_ns[images[k]], track.received_ns[images[k]]
            wanted[channel, int(received_ns), int(stamp_ns)] = k, camera
            missing[k] += 1
    waiting: list[dict[str, np.ndarray]] = [{} for _ in rows]  # until their turn
    turn = 0
    received = np.unique([received_ns for _, received_ns, _ in wanted])
    for span in np.split(received, np.flatnonzero(np.diff(received) > JOINED_NS) + 1):
        for each in recording.read({*channels.values()}, int(span[0]), int(span[-1]) + 1):
            # Of repeated messages the first counts.
            k, camera = wanted.pop((each.channel, each.received_ns, each.stamp_ns), (-1, ""))
            if k < 0:
                continue
            content = each.decode()
            assert isinstance(content, np.ndarray)
            waiting[k][camera] = content
            while turn < len(rows) and len(waiting[turn]) == missing[turn]:
                yield waiting[turn]
                waiting[turn], turn = {}, turn + 1
    if turn < len(rows):
        raise VergenceError(f"{recording.path} has changed while it was read.")
