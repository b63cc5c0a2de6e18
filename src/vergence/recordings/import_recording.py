"""Make a dataset of a recording: scan it, choose frames, number the board's placements, write."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.data.description import Description
from vergence.data.writer import DatasetRow, write_dataset
from vergence.errors import VergenceError
from vergence.files import check_new
from vergence.findings import Finding
from vergence.geometry.board import Board
from vergence.progress import Progress, silent
from vergence.recordings.board_placements import number_placements
from vergence.recordings.chosen_images import read_images
from vergence.recordings.formats import open_recording
from vergence.recordings.frame_choice import choose_frames
from vergence.recordings.moments import find_moments
from vergence.recordings.recording import Recording
from vergence.recordings.recording_map import RecordingMap, describe
from vergence.recordings.scan import scan
from vergence.vision.board_detection import detect_board

_TASK = "finding the board"


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
        scanned = scan(recording, needed_channels(recording, mapped), progress=progress)
        sizes = {name: track.size for name, track in scanned.images.items()}
        description = describe(mapped, sizes, scanned.lenses)
        moments = find_moments(scanned, mapped, description)
        chosen = choose_frames(moments, mapped.frames)
        channels = {name: source.images for name, source in mapped.cameras.items()}
        again = partial(read_images, recording, scanned.images, channels, moments)
        corners = _corners(description, again(chosen.rows), len(chosen.rows), progress)
        placement = number_placements(description, moments, chosen, corners)

        def rows() -> Iterator[DatasetRow]:
            for k, images in enumerate(again(chosen.rows)):
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


def _corners(
    description: Description,
    images_of: Iterable[Mapping[str, np.ndarray]],
    count: int,
    progress: Progress,
) -> dict[str, Array]:
    """Find the board in the images of chosen frames: by camera (F, K, 2), NaN where not seen."""
    shape = count, description.board.columns * description.board.rows, 2
    found = {name: np.full(shape, np.nan) for name in description.cameras}
    progress(_TASK, 0, count)
    waiting: deque[tuple[int, str, Future[Array | None]]] = deque()
    workers = os.cpu_count() or 1
    with ThreadPoolExecutor(workers) as pool:
        for k, images in enumerate(images_of):
            for name, image in images.items():
                waiting.append((k, name, pool.submit(_detect, image, description.board)))
            while len(waiting) > (4 * workers if k < count - 1 else 0):  # bounds the memory
                row, camera, corners = waiting.popleft()
                if (seen := corners.result()) is not None:
                    found[camera][row] = seen
                progress(_TASK, row + 1, count)
    return found


def _detect(image: np.ndarray, board: Board) -> Array | None:
    if image.dtype == np.uint16:
        image = image >> max(0, int(image.max()).bit_length() - 8)
    try:
        return detect_board(image.astype(np.uint8), board)
    except cv2.error:  # images of a few pixels, for example
        return None
