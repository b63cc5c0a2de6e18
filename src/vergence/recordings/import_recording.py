"""Make a dataset of a recording: scan it, choose frames, number the board's placements, write."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import LEAST_MOVING, MAX_GAP_S, Frame
from vergence.data.images import to_8_bits
from vergence.data.writer import DatasetRow, write_dataset
from vergence.errors import VergenceError, counted
from vergence.files import check_new
from vergence.findings import Finding, note
from vergence.geometry.board import Board, described
from vergence.progress import Progress, silent
from vergence.recordings.board_placements import number_placements
from vergence.recordings.formats import open_recording
from vergence.recordings.frame_choice import ChosenFrames, choose_frames
from vergence.recordings.joint_streams import write_stream
from vergence.recordings.mapped_scan import on_the_clock, read_images, scan_mapped
from vergence.recordings.moments import Moments, check_stamps, find_moments
from vergence.recordings.recording_map import RecordingMap
from vergence.vision.board_detection import detect_board

_ImagesOf = Callable[[np.ndarray], Iterator[dict[str, np.ndarray]]]
_TASK = "finding the board"


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
        findings += _without_readings(moments, mapped)
        channels = {name: source.images for name, source in mapped.cameras.items()}
        again = partial(read_images, recording, scanned.images, channels, moments)
        found = mapped.frames.moving is None and description.board is None
        chosen = _all_frames(moments) if found else choose_frames(moments, mapped.frames)
        placement = None
        if description.board is not None:
            corners = _corners(description.board, channels, again, chosen.rows, progress)
            if not any(np.isfinite(uv).any() for uv in corners.values()):
                board = description.board
                raise VergenceError(
                    f"None of {counted(len(chosen.rows), 'frame')} of {path} shows a "
                    f"{described(board)}, as the map describes it."
                )
            placement = number_placements(description, moments, chosen, corners, mapped.frames)
            kept = np.flatnonzero(placement >= 0)
            kept = kept[_long_enough(moments.time_ns[chosen.rows[kept]], chosen.moving[kept])]
            chosen = ChosenFrames(chosen.rows[kept], chosen.moving[kept])
            placement = placement[kept]

        def rows() -> Iterator[DatasetRow]:
            for k, images in enumerate(again(chosen.rows)):
                row = chosen.rows[k]
                time_s = int(moments.time_ns[row]) * 1e-9
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


def _without_readings(moments: Moments, mapped: RecordingMap) -> tuple[Finding, ...]:
    """Note images without readings; VergenceError if all are."""
    sentence = (
        f"{int((~moments.known).sum())} of {len(moments)} images have no joint readings around "
        f"them within max_gap_s = {mapped.max_gap_s:g} s of the map"
    )
    if not moments.known.any():
        raise VergenceError(f"{sentence}.")
    return () if moments.known.all() else (note("no-readings", f"{sentence}; they were left out."),)


def _all_frames(moments: Moments) -> ChosenFrames:
    """Choose all moments with readings, in motion where enough of them follow each other."""
    rows = np.flatnonzero(moments.known)
    return ChosenFrames(rows, _long_enough(moments.time_ns[rows], np.ones(len(rows), bool)))


def _long_enough(time_ns: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """Select the moments (F,) at rest, and those of motions of LEAST_MOVING moments or more."""
    late = np.diff(time_ns, prepend=time_ns[:1]) > MAX_GAP_S * 1e9
    run = np.cumsum(late | np.diff(moving, prepend=moving[:1]))
    return ~moving | (np.bincount(run)[run] >= LEAST_MOVING)


def _corners(
    board: Board, cameras: Iterable[str], images_of: _ImagesOf, rows: np.ndarray, progress: Progress
) -> dict[str, Array]:
    """Find the board in the images of chosen frames: by camera (F, K, 2), NaN where not seen."""
    shape = len(rows), board.columns * board.rows, 2
    found = {name: np.full(shape, np.nan) for name in cameras}
    progress(_TASK, 0, len(rows))
    with ThreadPoolExecutor() as pool:
        for k, images in enumerate(images_of(rows)):
            corners = pool.map(partial(_detect, board), images.values())
            for name, seen in zip(images, corners, strict=True):
                found[name][k] = np.nan if seen is None else seen
            progress(_TASK, k + 1, len(rows))
    return found


def _detect(board: Board, image: np.ndarray) -> Array | None:
    try:
        return detect_board(to_8_bits(image), board)
    except cv2.error:  # images of a few pixels, for example
        return None
