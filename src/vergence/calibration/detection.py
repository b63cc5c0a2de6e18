"""Find the board in every image of a dataset: in parallel, with progress and with reasons."""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.calibration.observations import NO_CORNERS, UNREADABLE_IMAGE, Observations
from vergence.calibration.other_boards import ANOTHER, mirrored, other_board, why_not_found
from vergence.data.dataset import Dataset, runs
from vergence.data.description import Description
from vergence.data.images import UNREADABLE
from vergence.data.timing import Timing
from vergence.errors import VergenceError, counted
from vergence.findings import Finding, note
from vergence.geometry.board import Board, described
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
DAMAGED = f"the file {UNREADABLE}; leave the cell empty where there is no image"
_PROBES = 4  # images on which other boards are tried when none was found
_FIRST = 12
"""Images, spread over the recording, that are searched first: where none shows the board, and half
of the probes another one, the rest is not, which would take half a second an image."""


@dataclass(frozen=True, eq=False)
class _Detection:
    """What was found in one image."""

    camera: str
    row: int
    corners: Array | None
    """(K, 2) [px]; None: the board was not found."""
    reason: str
    """Why it was not found."""


def detect_target(dataset: Dataset, *, progress: Progress = silent) -> Observations:
    """Find the board in all images of a dataset, in parallel threads.

    Raises:
        VergenceError: images have another size than dataset.json states, no image shows the board,
            or most show another one, all images of a camera are mirrored, or a motion has too few
            rows; or this is no dataset.
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
    timing = None
    if dataset.moving.any():
        timing = Timing(dataset.joint_time_s, runs(dataset), dataset.stream)
    task = "finding the board"
    progress(task, 0, len(jobs))
    first = jobs[:: max(1, len(jobs) // _FIRST)]
    rest = [job for job in jobs if job not in first]
    found: list[_Detection] = []
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for part in (first, rest):
            # An error cancels the rest.
            for each in pool.map(lambda job: _detect(dataset, *job), part):
                found.append(each)
                progress(task, len(found), len(jobs))
            if part is first and rest:
                _check_board(dataset, found, all_images=False)
    order = {job: k for k, job in enumerate(jobs)}
    found.sort(key=lambda each: order[each.camera, each.row])
    _check_board(dataset, found, all_images=True)
    board = dataset.board
    shape = (len(dataset), board.columns * board.rows, 2)
    corners = {name: np.full(shape, np.nan) for name in dataset.files}
    for each in found:
        if each.corners is not None:
            corners[each.camera][each.row] = each.corners
    observations = described_observations(
        dataset.description,
        board,
        placement=dataset.placement,
        eye_angles=dataset.eye_angles,
        corners=corners,
        timing=timing,
    )
    return replace(
        observations,
        T_base_eye=dataset.T_base_eye,
        lines=np.asarray(dataset.lines),
        findings=(*dataset.findings, *_findings(dataset, found)),
    )


def described_observations(
    description: Description,
    board: Board,
    *,
    placement: np.ndarray,
    eye_angles: Array,
    corners: Mapping[str, Array],
    timing: Timing | None,
) -> Observations:
    """Make observations by cameras of a description, with what it states of these and the joints.

    Arrays are as in `Observations`, whose errors are raised.
    """
    cameras = {name: description.cameras[name] for name in corners}
    return Observations(
        board=board,
        placement=placement,
        eye_angles=eye_angles,
        corners=corners,
        sizes={name: (camera.width, camera.height) for name, camera in cameras.items()},
        eyes={name: camera.eye for name, camera in cameras.items()},
        kinematics=description.head_kinematics,
        timing=timing,
        systematic_px=SYSTEMATIC_PX,
        known_lenses={
            name: (camera.intrinsics, camera.intrinsics_std_percent)
            for name, camera in cameras.items()
            if camera.intrinsics is not None and camera.intrinsics_std_percent is not None
        },
    )


def _findings(dataset: Dataset, found: list[_Detection]) -> list[Finding]:
    """Note images without corners."""
    findings = []
    for each in found:
        if each.corners is None:
            line = dataset.lines[each.row]
            sentence = f"Line {line}, {dataset.files[each.camera][each.row]}: {each.reason}."
            code = UNREADABLE_IMAGE if each.reason == DAMAGED else NO_CORNERS
            findings.append(note(code, sentence, f"line {line}, {each.camera}"))
    return findings


def _detect(dataset: Dataset, camera: str, row: int) -> _Detection:
    image = dataset.readable_image(camera, row)
    if image is None:
        return _Detection(camera, row, None, DAMAGED)
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return _Detection(camera, row, *detect_or_explain(grey, dataset.board))


def detect_or_explain(grey: np.ndarray, board: Board) -> tuple[Array | None, str]:
    """Return the corners (K, 2) [px] in an image (H, W) uint8, or None and the reason."""
    corners = detect_board(grey, board)
    if corners is None:
        return None, _why_not(grey, board)
    count = int(np.isfinite(corners).all(axis=1).sum())
    if count < LEAST_CORNERS:
        return None, (
            f"only {counted(count, 'corner')} of the board can be seen; {LEAST_CORNERS} are needed"
        )
    return corners, ""


def _why_not(grey: np.ndarray, board: Board) -> str:
    if min(grey.shape) < 3:
        return "the image is too small"
    low, middle, high = np.percentile(grey, [2, 50, 98])
    if high < 2 * DARK:
        return "the image is too dark"
    if middle > BRIGHT and low > BRIGHT / 2:
        return "the image is overexposed"
    if min(_steepness(grey), _steepness(grey.T)) < BLURRED:
        return "the board was not found; the image is blurred"
    return why_not_found(grey, board)


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


def _check_board(dataset: Dataset, found: list[_Detection], *, all_images: bool) -> None:
    """Refuse mirrored images, and those that mostly show another board than the one described.

    A few views of markers of another board agree with the description by chance. Of the first
    images at least half have to show another board.
    """
    board = dataset.board
    missed = [each for each in found if each.corners is None]
    if all_images:
        for camera in dataset.files:
            own = [each for each in found if each.camera == camera]
            blind = bool(own) and all(each.corners is None for each in own)
            if blind and (cause := mirrored(_probes(dataset, own), board)):
                raise VergenceError(f"{_shown(dataset, own, camera)}; {cause}.")
    if len(found) - len(missed) > sum(each.reason == ANOTHER for each in missed):
        return
    images = _probes(dataset, missed)
    cause = other_board(images, board, least=1 if all_images else len(images) // 2)
    if cause or all_images:
        where = (
            str(dataset.folder) if all_images else f"{dataset.folder}, of {len(found)} all over it,"
        )
        cause = cause or "check board in dataset.json"
        raise VergenceError(f"{_shown(dataset, found, where)}; {cause}.")


def _shown(dataset: Dataset, found: list[_Detection], where: str) -> str:
    """Return the sentence for a board that no image shows, or few, with the usual reason."""
    board = dataset.board
    reasons = [each.reason for each in found if each.corners is None]
    seen = len(found) - len(reasons)
    who = f"Only {seen} of {len(found)} images" if seen else "No image"
    return (
        f"{who} of {where} {'show' if seen > 1 else 'shows'} a {described(board)} "
        f"({max(set(reasons), key=reasons.count)})"
    )


def _probes(dataset: Dataset, missed: list[_Detection]) -> list[np.ndarray]:
    """Return a few of the images (H, W) in which no board was found."""
    return [
        cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        for each in missed[:: max(1, len(missed) // _PROBES)]
        if (image := dataset.readable_image(each.camera, each.row)) is not None
    ]
