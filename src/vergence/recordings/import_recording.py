"""Make a dataset of a recording: scan it, choose frames, number the board's placements, write."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.calibration.other_boards import other_board
from vergence.data.dataset import LEAST_MOVING, MAX_GAP_S, Frame
from vergence.data.images import to_8_bits
from vergence.data.writer import DatasetRow, write_dataset
from vergence.errors import VergenceError, counted
from vergence.files import check_new
from vergence.findings import Finding, note
from vergence.geometry.board import Board, described
from vergence.progress import Progress, silent
from vergence.recordings.board_placements import number_placements
from vergence.recordings.chosen_images import read_images
from vergence.recordings.clocks import check_stamps
from vergence.recordings.formats import open_recording
from vergence.recordings.frame_choice import ChosenFrames, choose_frames
from vergence.recordings.joint_streams import write_stream
from vergence.recordings.mapped_scan import on_the_clock, scan_mapped
from vergence.recordings.moments import STILL, Moments, find_moments
from vergence.recordings.recording_map import RecordingMap
from vergence.vision.board_detection import detect_board
from vergence.vision.exposure import grey_levels

_ImagesOf = Callable[[np.ndarray], Iterator[dict[str, np.ndarray]]]
_TASK = "finding the board"
_PROBES = 4
"""Frames in which another board is sought where none shows the one of the map."""


@dataclass(frozen=True, eq=False)
class ImportedRecording:
    """What was taken of a recording."""

    frames: int
    """At rest and in motion."""
    moving: int
    placements: int
    """Places of the board in the head; 0 without a board."""
    findings: tuple[Finding, ...] = ()


def import_recording(
    path: Path | str, mapped: RecordingMap, out: Path | str, *, progress: Progress = silent
) -> ImportedRecording:
    """Write the frames of a recording that show the board into a new dataset.

    Without a board in the map all frames are written. VergenceError if the recording is damaged,
    does not have what the map names, or shows no board.
    """
    check_new(Path(out))
    with open_recording(path) as opened:
        recording = on_the_clock(opened, mapped)
        scanned, description = scan_mapped(recording, mapped, progress=progress)
        findings = check_stamps(scanned, mapped, description)
        moments = find_moments(scanned, mapped, description)
        findings = (*findings, *_check_readings(moments, mapped))
        channels = {name: source.images for name, source in mapped.cameras.items()}
        again = partial(read_images, recording, scanned.images, channels, moments)
        found = mapped.frames.moving is None and description.board is None
        chosen = _all_frames(moments) if found else choose_frames(moments, mapped.frames)
        placement = None
        if description.board is not None:
            corners = _corners(description.board, channels, again, chosen.rows, progress)
            if not any(np.isfinite(uv).any() for uv in corners.values()):
                raise VergenceError(f"{path}: {_why_no_board(description.board, again, chosen)}.")
            placement = number_placements(description, moments, chosen, corners, mapped.frames)
            kept = placement >= 0
            chosen = ChosenFrames(chosen.rows[kept], chosen.moving[kept])
            placement = placement[kept]

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
                yield DatasetRow(
                    frame,
                    placement=None if placement is None else int(placement[k]),
                    moving=bool(chosen.moving[k]),
                    T_base_eye=None if moments.T_base_eye is None else moments.T_base_eye[row],
                )
                progress("writing the dataset", k + 1, len(chosen.rows))

        def beside(folder: Path) -> None:
            moving_ns = moments.time_ns[chosen.rows[chosen.moving]]
            if len(moving_ns) > 1 and not mapped.poses and mapped.max_gap_s <= MAX_GAP_S:
                write_stream(folder, scanned, description, moving_ns)

        write_dataset(out, description, rows(), beside=beside)
    places = 0 if placement is None else len(np.unique(placement))
    return ImportedRecording(len(chosen.rows), int(chosen.moving.sum()), places, findings)


def _check_readings(moments: Moments, mapped: RecordingMap) -> Iterator[Finding]:
    """Note images without readings; VergenceError if all are."""
    missing = int((~moments.known).sum())
    if missing == len(moments):
        raise VergenceError(
            f"No image has joint readings before and after it within {mapped.max_gap_s:g} s; set "
            "max_gap_s in the map to the longest time between two readings."
        )
    if missing:
        yield note(
            "no-readings",
            f"{counted(missing, 'moment')} of {len(moments)} have images but no joint readings "
            f"around them within {mapped.max_gap_s:g} s, and were left out.",
        )


def _all_frames(moments: Moments) -> ChosenFrames:
    """Choose the moments with readings and images of all cameras; in motion if the eyes move.

    In motion, those with too few neighbours in sequence are left out.
    """
    whole = moments.known & np.all([rows >= 0 for rows in moments.images.values()], axis=0)
    rows = np.flatnonzero(whole)
    if not len(rows):
        raise VergenceError(
            "The cameras of the map have no images of one moment: their stamps are of other times."
        )
    posture = moments.eye_angles if moments.T_base_eye is None else moments.T_base_eye
    moving = bool(np.ptp(posture[rows], axis=0).max(initial=0.0) > STILL)
    late = np.diff(moments.time_ns[rows], prepend=moments.time_ns[rows[0]]) > MAX_GAP_S * 1e9
    run = np.cumsum(late)
    rows = rows[(np.bincount(run)[run] >= LEAST_MOVING) | (not moving)]
    return ChosenFrames(rows, np.full(len(rows), moving))


def _corners(
    board: Board,
    cameras: Iterable[str],
    images_of: _ImagesOf,
    rows: np.ndarray,
    progress: Progress,
) -> dict[str, Array]:
    """Find the board in the images of chosen frames: by camera (F, K, 2), NaN where not seen."""
    count = len(rows)
    found = {name: np.full((count, board.columns * board.rows, 2), np.nan) for name in cameras}
    progress(_TASK, 0, count)
    waiting: deque[tuple[int, str, Future[Array | None]]] = deque()
    workers = os.cpu_count() or 1
    with ThreadPoolExecutor(workers) as pool:
        for k, images in enumerate(images_of(rows)):
            for name, image in images.items():
                waiting.append((k, name, pool.submit(_detect, image, board)))
            while len(waiting) > (4 * workers if k < count - 1 else 0):  # bounds the memory
                row, camera, corners = waiting.popleft()
                if (seen := corners.result()) is not None:
                    found[camera][row] = seen
                progress(_TASK, row + 1, count)
    return found


def _detect(image: np.ndarray, board: Board) -> Array | None:
    try:
        return detect_board(to_8_bits(image), board)
    except cv2.error:  # images of a few pixels, for example
        return None


def _why_no_board(board: Board, images_of: _ImagesOf, chosen: ChosenFrames) -> str:
    """Say what a few of the frames show in place of the board."""
    rows = chosen.rows[:: max(1, len(chosen.rows) // _PROBES)][:_PROBES]
    images = [grey_levels(to_8_bits(each)) for frame in images_of(rows) for each in frame.values()]
    instead = other_board(images, board)
    return (
        f"none of {counted(len(chosen.rows), 'frame')} shows a {described(board)}; "
        f"{instead or 'check board in the map'}"
    )
