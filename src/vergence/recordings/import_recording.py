"""Make a dataset of a recording: scan it, choose frames, number the board's placements, write."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.calibration.detection import detect_or_explain
from vergence.data.dataset import Frame
from vergence.data.description import Description
from vergence.data.writer import DatasetRow, write_dataset
from vergence.errors import VergenceError
from vergence.files import check_new
from vergence.findings import Finding
from vergence.progress import Progress, silent
from vergence.recordings.board_placements import number_placements
from vergence.recordings.formats import open_recording
from vergence.recordings.frame_choice import ChosenFrames, choose_frames
from vergence.recordings.moments import Moments, find_moments
from vergence.recordings.recording import Recording
from vergence.recordings.recording_map import RecordingMap, describe
from vergence.recordings.scan import scan


@dataclass(frozen=True, eq=False)
class ImportedRecording:
    """What was taken of a recording."""

    frames: int
    """At rest and in motion."""
    moving: int
    placements: int
    findings: tuple[Finding, ...] = ()


def import_recording(
    path: Path | str, mapped: RecordingMap, out: Path | str, *, progress: Progress = silent
) -> ImportedRecording:
    """Write the frames of a recording that show the board into a new dataset.

    VergenceError if the recording is damaged, does not have what the map names, or shows no board.
    """
    check_new(Path(out))
    with open_recording(path) as recording:
        channels = needed_channels(recording, mapped)
        scanned = scan(recording, channels, progress=progress)
        sizes = {name: track.size for name, track in scanned.images.items()}
        description = describe(mapped, sizes, scanned.lenses)
        moments = find_moments(scanned, mapped, description)
        chosen = choose_frames(moments, mapped.frames)
        corners = _corners(recording, description, mapped, moments, chosen, progress)
        placement = number_placements(description, moments, chosen, corners)

        def rows() -> Iterator[DatasetRow]:
            for k, images in _images(recording, mapped, moments, chosen):
                row = chosen.rows[k]
                time_s = moments.time_ns[row] * 1e-9
                frame = Frame(
                    time_s=time_s,
                    joint_time_s=time_s,
                    eye_angles=moments.eye_angles[row],
                    neck_angles=moments.neck_angles[row],
                    images=images,
                )
                yield DatasetRow(frame, int(placement[k]), bool(chosen.moving[k]))

        write_dataset(out, description, rows())
    return ImportedRecording(len(placement), int(chosen.moving.sum()), len(np.unique(placement)))


def needed_channels(recording: Recording, mapped: RecordingMap) -> list[str]:
    """List the channels that a map needs; VergenceError for one that is missing."""
    joints = [name for name, each in recording.channels.items() if each.kind == "joints"]
    poses = [name for name, each in recording.channels.items() if each.kind == "poses"]
    named = [source.images for source in mapped.cameras.values()]
    named += [source.lens for source in mapped.cameras.values() if source.lens]
    for name in named:
        if name not in recording.channels:
            raise VergenceError(
                f"{recording.path} has no channel {name}, which the map names; it has "
                f"{', '.join(recording.channels)}."
            )
    return [*named, *joints, *(poses if mapped.poses else ())]


def _images(
    recording: Recording, mapped: RecordingMap, moments: Moments, chosen: ChosenFrames
) -> Iterator[tuple[int, dict[str, np.ndarray]]]:
    """Yield the number of each chosen frame and its images by camera."""
    raise NotImplementedError


def _corners(
    recording: Recording,
    description: Description,
    mapped: RecordingMap,
    moments: Moments,
    chosen: ChosenFrames,
    progress: Progress,
) -> dict[str, Array]:
    """Find the board in the images of chosen frames: by camera (F, K, 2), NaN where not seen."""
    board = description.board
    shape = len(chosen.rows), board.columns * board.rows, 2
    found = {name: np.full(shape, np.nan) for name in mapped.cameras}
    for k, images in _images(recording, mapped, moments, chosen):
        for name, image in images.items():
            grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
            corners, _ = detect_or_explain(cast(np.ndarray, grey), board)
            if corners is not None:
                found[name][k] = corners
        progress("finding the board", k + 1, len(chosen.rows))
    return found
