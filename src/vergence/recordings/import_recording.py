"""Make a dataset of a recording: scan it, choose frames, number the board's placements, write."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import repeat
from pathlib import Path

import numpy as np
import pyarrow
from pyarrow import csv

from vergence.arrays import Array
from vergence.data.dataset import LEAST_MOVING, MAX_GAP_S, Dataset, Frame, number_motions
from vergence.data.description import STREAM, TIME, Description
from vergence.data.images import to_8_bits
from vergence.data.reader import load_dataset
from vergence.data.writer import DatasetRow, write_dataset
from vergence.errors import VergenceError, counted
from vergence.files import check_new
from vergence.geometry.board import Board, described
from vergence.progress import Progress, silent
from vergence.recordings.board_placements import number_placements
from vergence.recordings.formats import open_recording
from vergence.recordings.frame_choice import choose_frames, join_at_rest, seconds
from vergence.recordings.moments import check_moments, find_moments, read_images, scan_mapped
from vergence.recordings.readings import interpolate, joint_track
from vergence.recordings.recording_map import RecordingMap
from vergence.recordings.scan import Scan
from vergence.vision.board_detection import detect_board

AROUND_NS = 10**9
"""Time before and after a moving frame [ns]: the window of its polynomial, and usual latencies."""
APART_NS = 1000
"""Least time between rows [ns]; seconds since 1970 as floats are exact to 240 ns."""
_ImagesOf = Callable[[np.ndarray], Iterator[dict[str, np.ndarray]]]


def import_recording(
    path: Path | str, mapped: RecordingMap, out: Path | str, *, progress: Progress = silent
) -> Dataset:
    """Write the frames of a recording that show the board into a new dataset.

    Without a board in the map all frames are written. The findings of the dataset that is returned
    name what is odd in the recording. VergenceError if that is damaged, does not have what the map
    names, or shows no board.
    """
    check_new(Path(out))
    with open_recording(path, stamps=mapped.stamps) as recording:
        scanned, description = scan_mapped(recording, mapped, progress=progress)
        moments = find_moments(scanned, mapped, description)
        findings = check_moments(moments, scanned, mapped, description)
        moments = join_at_rest(moments)
        images_of = partial(read_images, recording, scanned, mapped, moments)
        board, stated = description.board, mapped.frames
        if board is None and stated.moving is None:  # all of them
            rows = np.flatnonzero(moments.known)
            moving = np.ones(len(rows), bool)
        else:
            rows, moving = choose_frames(moments, stated)
        number = np.zeros(len(rows), int)
        if board is not None:
            corners = _corners(board, mapped.cameras, images_of, rows, progress)
            if not any(np.isfinite(uv).any() for uv in corners.values()):
                raise VergenceError(
                    f"None of {counted(len(rows), 'frame')} of {path} shows a "
                    f"{described(board)}, as the map describes it."
                )
            number = number_placements(
                description, moments, rows, moving, corners=corners, stated=stated
            )
        kept = np.flatnonzero(number >= 0)
        rows, moving, placement = rows[kept], moving[kept], number[kept]
        run = number_motions(seconds(moments)[rows], moving)
        few = moving & (np.bincount(run)[run] < LEAST_MOVING)
        if board is None:
            moving &= ~few  # they serve as frames at rest
        else:
            rows, moving, placement = rows[~few], moving[~few], placement[~few]
        if not len(rows):
            raise VergenceError(
                f"No image of {path} can be used: name times at which head and board rest in "
                "frames.rest of the map, or record pauses of a second."
            )

        def frames() -> Iterator[DatasetRow]:
            for k, images in enumerate(images_of(rows)):
                time_s = int(moments.time_ns[rows[k]]) * 1e-9
                angles = moments.eye_angles[rows[k]], moments.neck_angles[rows[k]]
                yield DatasetRow(
                    Frame(time_s, time_s, *angles, images),
                    placement=None if board is None else int(placement[k]),
                    moving=bool(moving[k]),
                    T_base_eye=None if moments.T_base_eye is None else moments.T_base_eye[rows[k]],
                )
                progress("writing the dataset", k + 1, len(rows))

        def beside(folder: Path) -> None:
            if moving.sum() > 1 and not mapped.poses and mapped.max_gap_s <= MAX_GAP_S:
                _write_stream(folder, scanned, description, moments.time_ns[rows[moving]])

        write_dataset(out, description, frames(), beside=beside)
    dataset = load_dataset(out)
    return replace(dataset, findings=(*dataset.findings, *findings))


def _corners(
    board: Board, cameras: Iterable[str], images_of: _ImagesOf, rows: np.ndarray, progress: Progress
) -> dict[str, Array]:
    """Find the board in the images of chosen frames: by camera (F, K, 2), NaN where not seen."""
    pixels = {name: np.full((len(rows), board.columns * board.rows, 2), np.nan) for name in cameras}
    with ThreadPoolExecutor() as pool:
        for k, images in enumerate(images_of(rows)):
            greys = map(to_8_bits, images.values())
            corners = pool.map(detect_board, greys, repeat(board))
            for name, uv in zip(images, corners, strict=True):
                pixels[name][k] = np.nan if uv is None else uv
            progress("finding the board", k + 1, len(rows))
    return pixels


def _write_stream(
    folder: Path, scanned: Scan, description: Description, moving_ns: np.ndarray
) -> None:
    """Write joints.csv of a dataset, around two or more moving frames (M,) [ns], increasing.

    A row is a time at which a joint was read; readings of the others are interpolated.
    """
    columns = [description.sources[n].column for n in description.head_kinematics.readings]
    tracks = [joint_track(scanned, column) for column in columns]
    stamp_ns = np.unique(np.concatenate([track.stamp_ns for track in tracks]))
    stamp_ns = stamp_ns[np.diff(stamp_ns, prepend=stamp_ns[0] - APART_NS) >= APART_NS]
    begin, end = (np.searchsorted(moving_ns, stamp_ns + d) for d in (-AROUND_NS, AROUND_NS))
    stamp_ns = stamp_ns[end > begin]
    if len(stamp_ns) < 2 or np.median(np.diff(stamp_ns)) >= np.median(np.diff(moving_ns)):
        return  # the frames have all of them
    read = [interpolate(track, stamp_ns, max_gap_s=MAX_GAP_S) for track in tracks]
    table = np.column_stack([stamp_ns * 1e-9, *read])
    known = np.isfinite(table).all(axis=1)
    file = folder / STREAM
    csv.write_csv(pyarrow.table([*table[known].T], [TIME, *columns]), file)
