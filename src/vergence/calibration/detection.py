"""Find the board in every image of a dataset: in parallel, with progress and with reasons."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.calibration.observations import DetectionFailure, Observations
from vergence.data.dataset import Dataset, runs
from vergence.data.images import UNREADABLE
from vergence.data.timing import Timing
from vergence.errors import VergenceError, counted
from vergence.geometry.board import DICTIONARIES, Board, Chessboard
from vergence.progress import Progress, silent
from vergence.vision.board_detection import detect_board
from vergence.vision.board_pose import LEAST_CORNERS

DARK, BRIGHT = 25, 230
"""Grey levels between which most of a usable image lies."""
BLURRED = 0.35
"""Part of the strongest edges' height that lies within two pixels, below which an image is blurred:
that of a blur of 2.5 pixels, of one standard deviation."""
HIGH = 20
"""Height of an edge from which its blur is looked at [grey levels]."""
SYSTEMATIC_PX = 0.002
"""Systematic error of the detector, smooth over the image: assumed. It was at most 0.0011 px in
each of 28 cameras, on boards that were rendered, or drawn before lenses of several kinds; cameras
that nobody drew may do worse, and the intrinsics absorb most of this error."""
_PROBES = 4  # images on which other boards are tried when none was found


@dataclass(frozen=True, eq=False)
class _Detection:
    """What was found in one image."""

    camera: str
    row: int
    corners: Array | None
    """(K, 2) [px]; None: the board was not found."""
    reason: str
    """Why it was not found."""
    digest: bytes = b""
    """Of the picture, by which repeated ones are recognised."""


def detect_target(dataset: Dataset, *, progress: Progress = silent) -> Observations:
    """Find the board in all images of a dataset, in parallel threads.

    Raises:
        VergenceError: images have another size than dataset.json states, two cameras gave the
            same picture of the board, no image shows the board, or a motion has too few rows; or
            this is no dataset.
    """
    if not isinstance(dataset, Dataset):
        raise VergenceError(
            f"detect_target takes a dataset, as of vg.load_dataset(folder); found {dataset!r:.80}."
        )
    jobs = [
        (camera, row)
        for row in range(len(dataset))
        for camera, files in dataset.files.items()
        if files[row] is not None
    ]
    if not jobs:
        raise VergenceError(f"{dataset.folder} names no image in frames.csv.")
    timing = Timing(dataset.joint_time_s, runs(dataset)) if dataset.moving.any() else None
    task = "finding the board"
    progress(task, 0, len(jobs))
    found: list[_Detection] = []
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for each in pool.map(lambda job: _detect(dataset, *job), jobs):  # errors cancel the rest
            found.append(each)
            progress(task, len(found), len(jobs))
    found = _without_repeats(dataset, found)
    if all(each.corners is None for each in found):
        raise VergenceError(_nothing_found(dataset, found))
    board, cameras = dataset.description.board, dataset.description.cameras
    shape = (len(dataset), board.columns * board.rows, 2)
    corners = {name: np.full(shape, np.nan) for name in dataset.files}
    failures = []
    for each in found:
        if each.corners is not None:
            corners[each.camera][each.row] = each.corners
        else:
            line, file = int(dataset.lines[each.row]), str(dataset.files[each.camera][each.row])
            failures.append(DetectionFailure(each.row, line, each.camera, file, each.reason))
    blind = [
        f"{name} never sees the board." for name, c in corners.items() if not np.isfinite(c).any()
    ]
    return Observations(
        board=board,
        placement=dataset.placement,
        eye_angles=dataset.eye_angles,
        corners=corners,
        sizes={name: (camera.width, camera.height) for name, camera in cameras.items()},
        eyes={name: camera.eye for name, camera in cameras.items()},
        kinematics=dataset.description.head_kinematics,
        timing=timing,
        T_base_eye=dataset.T_base_eye,
        systematic_px=SYSTEMATIC_PX,
        failures=tuple(failures),
        remarks=(*dataset.remarks, *blind),
    )


def _detect(dataset: Dataset, camera: str, row: int) -> _Detection:
    image = dataset.readable_image(camera, row)
    if image is None:
        return _Detection(camera, row, None, f"the file {UNREADABLE}")
    digest = hashlib.blake2b(image.tobytes(), digest_size=16).digest()
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return _Detection(camera, row, *detect_or_explain(grey, dataset.description.board), digest)


def detect_or_explain(grey: np.ndarray, board: Board) -> tuple[Array | None, str]:
    """Return the corners (K, 2) [px] in an image (H, W) uint8, or None and the reason."""
    try:
        corners = detect_board(grey, board)
    except cv2.error as error:  # images of a few pixels, for example
        return None, f"OpenCV cannot look for the board ({error.err})"
    if corners is None:
        return None, _why_not(grey)
    count = int(np.isfinite(corners).all(axis=1).sum())
    if count < LEAST_CORNERS:
        return None, (
            f"only {counted(count, 'corner')} of the board can be seen; {LEAST_CORNERS} are needed"
        )
    return corners, ""


def _why_not(grey: np.ndarray) -> str:
    if min(grey.shape) < 3:
        return "the image is too small"
    low, middle, high = np.percentile(grey, [2, 50, 98])
    if high < 2 * DARK:
        return "the image is too dark"
    if middle > BRIGHT and low > BRIGHT / 2:
        return "the image is overexposed"
    if min(_steepness(grey), _steepness(grey.T)) < BLURRED:
        return "the board was not found; the image is blurred"
    return "the board was not found"


def _steepness(grey: np.ndarray) -> float:
    """Return how much of the height of the strongest edges across the rows lies within two pixels.

    Their height is the difference over eight pixels; 1 for an image without high edges.
    """
    smooth = cv2.GaussianBlur(grey, (0, 0), 0.7).astype(np.float32)
    if smooth.shape[1] < 16:
        return 1.0
    heights = np.abs(smooth[:, 8:] - smooth[:, :-8])
    steps = np.abs(smooth[:, 2:] - smooth[:, :-2])
    strong = heights > max(float(np.percentile(heights, 99.5)) / 2, HIGH)
    # The largest step between the two ends of each height.
    largest = cv2.dilate(steps, np.ones((1, 7), np.uint8))[:, 3:-3]
    return float(np.median(largest[strong] / heights[strong])) if strong.any() else 1.0


def _without_repeats(dataset: Dataset, seen: list[_Detection]) -> list[_Detection]:
    """Return the detections; those in pictures that a camera gave before count as failures.

    Pictures without a board may be alike: of a covered lens, all are black.
    """
    first: dict[bytes, _Detection] = {}
    kept = []
    for each in seen:
        before = each if each.corners is None else first.setdefault(each.digest, each)
        if before.camera != each.camera:
            raise VergenceError(
                f"{dataset.where(each.row)}: {dataset.files[each.camera][each.row]} of "
                f"{each.camera} is the same picture as "
                f"{dataset.files[before.camera][before.row]} of {before.camera}."
            )
        if before is not each:
            line = dataset.lines[before.row]
            each = replace(each, corners=None, reason=f"the same picture as in line {line}")
        kept.append(each)
    return kept


def _nothing_found(dataset: Dataset, seen: list[_Detection]) -> str:
    """Return the sentence for a board that no image shows, with the cause if it is a usual one."""
    board = dataset.description.board
    stated = f"{board.columns} x {board.rows} inner corners"
    reasons = [each.reason for each in seen]
    common = max(set(reasons), key=reasons.count)
    sentence = f"No image of {dataset.folder} shows a {board.kind} of {stated} ({common})"
    probes = [
        image
        for each in seen[:: max(1, len(seen) // _PROBES)]
        if (image := dataset.readable_image(each.camera, each.row)) is not None
    ]
    for other, advice in _other_descriptions(board):
        for image in probes:
            corners, _ = detect_or_explain(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), other)
            if corners is not None:
                return f"{sentence}; one {advice}."
    return f"{sentence}; check board in dataset.json."


def _other_descriptions(board: Board) -> Iterator[tuple[Board, str]]:
    """Yield boards that are described as this one by mistake, and what to say of them."""
    if isinstance(board, Chessboard):
        for more in product((-1, 0, 1), repeat=2):
            columns, rows = board.columns + more[0], board.rows + more[1]
            if any(more) and min(columns, rows) >= 3:
                yield (
                    Chessboard(columns, rows, board.square_m),
                    f"of {columns} x {rows} is there: board.columns and board.rows count the "
                    "corners inside the board, not its squares",
                )
        return
    yield (
        replace(board, squares_x=board.squares_y, squares_y=board.squares_x),
        f"of {board.squares_y} x {board.squares_x} squares is there: exchange board.squares_x and "
        "board.squares_y",
    )
    yield (
        replace(board, legacy=not board.legacy),
        f"of the other pattern is there: set board.legacy to {str(not board.legacy).lower()}",
    )
    for dictionary in DICTIONARIES:
        with suppress(ValueError):  # of those with too few markers
            yield (
                replace(board, dictionary=dictionary),
                f"with other markers is there: set board.dictionary to {dictionary}",
            )
