"""Finding the board in every image of a dataset: in parallel, with progress and with reasons."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np
from rich.progress import Progress

from vergence.arrays import Array
from vergence.calibration.sequential.sequential import Views
from vergence.data.dataset import Dataset, read_image, runs
from vergence.data.timing import Timing
from vergence.errors import VergenceError
from vergence.geometry.board import Board, Chessboard
from vergence.vision.board_detection import detect_board

LEAST_CORNERS = 6
"""Fewer do not say where a board is."""
DARK, BRIGHT = 25, 230
"""Grey levels between which most of a usable image lies."""
BLURRED = 0.35
"""Part of an image's contrast that is left in steps of two pixels, below which it is blurred."""
FOUND_ALIKE_PX = 0.003
"""Smooth errors that corners share which were found in images: assumed. On rendered boards they are
0.001 to 0.002 px over the image, and a lens takes up more of them than of errors of any shape."""
_PROBES = 4  # images on which other boards are tried when none was found


@dataclass(frozen=True, eq=False)
class Failure:
    """An image that gave no corners."""

    row: int
    """Of the dataset, from 0."""
    line: int
    """Of frames.csv."""
    camera: str
    file: str
    reason: str

    def __str__(self) -> str:
        return f"line {self.line}, {self.file}: {self.reason}"


@dataclass(frozen=True, eq=False)
class Detections:
    """All that calibration needs of a dataset; V views are its rows."""

    views: Views
    timing: Timing | None
    """When the readings were taken; None: the eyes stood still."""
    T_base_eye: Array | None
    """(V, 2, 4, 4) poses of the eyes, where the dataset gives them instead of angles."""
    failures: tuple[Failure, ...]
    remarks: tuple[str, ...]
    """What is odd in the dataset, though it may be right."""


@dataclass(frozen=True, eq=False)
class _Seen:
    camera: str
    row: int
    corners: Array | None
    reason: str
    digest: bytes


def detect(
    dataset: Dataset, *, progress: Progress | None = None, least_corners: int = LEAST_CORNERS
) -> Detections:
    """Find the board in all images of a dataset, in parallel threads.

    Args:
        dataset: what was recorded.
        progress: gets a bar of its own; None: silent.
        least_corners: with fewer an image counts as a failure.

    Raises:
        VergenceError: images have another size than dataset.json states, two cameras gave the
            same picture, or no image shows the board.
    """
    jobs = [
        (camera, row)
        for row in range(len(dataset))
        for camera, files in dataset.files.items()
        if files[row] is not None
    ]
    if not jobs:
        raise VergenceError(f"{dataset.folder} names no image in frames.csv.")
    task = progress.add_task("finding the board", total=len(jobs)) if progress else None
    seen: list[_Seen] = []
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        futures = [pool.submit(_look, dataset, camera, row, least_corners) for camera, row in jobs]
        try:
            for future in futures:
                seen.append(future.result())
                if progress and task is not None:
                    progress.advance(task)
        finally:
            for future in futures:
                future.cancel()
    seen = _without_repeats(dataset, seen)
    if all(each.corners is None for each in seen):
        raise VergenceError(_nothing_found(dataset, seen))
    board = dataset.description.board
    shape = (len(dataset), board.columns * board.rows, 2)
    corners = {name: np.full(shape, np.nan) for name in dataset.files}
    for each in seen:
        if each.corners is not None:
            corners[each.camera][each.row] = each.corners
    cameras = dataset.description.cameras
    views = Views(
        board=board,
        placement=dataset.placement,
        eye_angles=dataset.eye_angles,
        corners=corners,
        sizes={name: (camera.width, camera.height) for name, camera in cameras.items()},
        eyes={name: camera.eye for name, camera in cameras.items()},
        shared_px=FOUND_ALIKE_PX,
    )
    failures = tuple(
        Failure(
            row=each.row,
            line=int(dataset.lines[each.row]),
            camera=each.camera,
            file=str(dataset.files[each.camera][each.row]),
            reason=each.reason,
        )
        for each in seen
        if each.corners is None
    )
    remarks = (*dataset.remarks, *_blind(views))
    timed = dataset.moving.any() and dataset.T_base_eye is None
    timing = Timing(dataset.joint_time_s, runs(dataset)) if timed else None
    return Detections(views, timing, dataset.T_base_eye, failures, remarks)


def _look(dataset: Dataset, camera: str, row: int, least_corners: int) -> _Seen:
    image = read_image(dataset.folder / str(dataset.files[camera][row]))
    if image is None:
        return _Seen(camera, row, None, "the file is not a readable image", b"")
    dataset.check_size(camera, row, image)
    digest = hashlib.blake2b(image.tobytes(), digest_size=16).digest()
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    corners, reason = look_for(grey, dataset.description.board, least_corners)
    return _Seen(camera, row, corners, reason, digest)


def look_for(
    grey: np.ndarray, board: Board, least_corners: int = LEAST_CORNERS
) -> tuple[Array | None, str]:
    """Return the corners (K, 2) [px] in an image (H, W) uint8, or None and the reason."""
    try:
        corners = detect_board(grey, board)
    except cv2.error as error:  # images of a few pixels, for example
        return None, f"OpenCV cannot look for the board ({error.err})"
    if corners is None:
        return None, _why_not(grey)
    count = int(np.isfinite(corners).all(axis=1).sum())
    if count < least_corners:
        return None, f"only {count} corners of the board are seen; {least_corners} are needed"
    return corners, ""


def _why_not(grey: np.ndarray) -> str:
    low, middle, high = np.percentile(grey, [2, 50, 98])
    if high < 2 * DARK:
        return "the image is too dark"
    if middle > BRIGHT and low > BRIGHT / 2:
        return "the image is overexposed"
    # The steepest slopes of a sharp image take its contrast in a pixel or two.
    smooth = cv2.GaussianBlur(grey, (0, 0), 0.7).astype(np.float32)
    steep = np.abs(smooth[:, 2:] - smooth[:, :-2])
    if np.percentile(steep, 99.5) < BLURRED * (high - low):
        return "the board was not found; the image is blurred, or shows nothing with edges"
    return "the board was not found"


def _without_repeats(dataset: Dataset, seen: list[_Seen]) -> list[_Seen]:
    """Return the same with pictures that a camera gave twice as failures."""
    first: dict[bytes, _Seen] = {}
    kept = []
    for each in seen:
        before = first.setdefault(each.digest, each) if each.digest else each
        if before.camera != each.camera:
            raise VergenceError(
                f"{dataset.where(each.row)}: {dataset.files[each.camera][each.row]} of "
                f"{each.camera} is the same picture as "
                f"{dataset.files[before.camera][before.row]} of {before.camera}."
            )
        if before is not each and each.corners is not None:
            line = dataset.lines[before.row]
            each = replace(each, corners=None, reason=f"the same picture as in line {line}")
        kept.append(each)
    return kept


def _nothing_found(dataset: Dataset, seen: list[_Seen]) -> str:
    """Return the sentence for a board that is in no image, with the usual cause if it is that."""
    board = dataset.description.board
    stated = f"{board.columns} x {board.rows} inner corners"
    reasons = [each.reason for each in seen]
    common = max(set(reasons), key=reasons.count)
    sentence = f"No image of {dataset.folder} shows a {board.kind} of {stated} ({common})"
    if isinstance(board, Chessboard):
        for other, each in _alternatives(board, seen):
            image = read_image(dataset.folder / str(dataset.files[each.camera][each.row]))
            if image is not None and detect_board(image, other) is not None:
                return (
                    f"{sentence}; one of {other.columns} x {other.rows} is there: board.columns "
                    "and board.rows count the corners inside the board, not its squares."
                )
    return f"{sentence}; check board in dataset.json."


def _alternatives(board: Chessboard, seen: list[_Seen]) -> Iterator[tuple[Chessboard, _Seen]]:
    others = [(board.columns - 1, board.rows - 1), (board.columns + 1, board.rows + 1)]
    for each in seen[:: max(1, len(seen) // _PROBES)]:
        for columns, rows in others:
            if min(columns, rows) >= 3:
                yield Chessboard(columns, rows, board.square_m), each


def _blind(views: Views) -> list[str]:
    return [
        f"{name} never sees the board."
        for name, corners in views.corners.items()
        if not np.isfinite(corners).any()
    ]
