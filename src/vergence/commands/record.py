"""Record a dataset on the twin: the calibration sequence, and eyes that move before the board."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from vergence.arrays import Array
from vergence.commands import truth as truth_file
from vergence.commands.truth import Truth, with_sensors
from vergence.data.dataset import DatasetCamera, DatasetJoint, Description
from vergence.data.writer import DatasetRow, check_new, write_dataset
from vergence.errors import VergenceError
from vergence.geometry.board import Board, Charuco
from vergence.geometry.kinematics import EYE_JOINTS, NECK_JOINTS
from vergence.twin.calibration_sequence import (
    BOARD,
    NARROW_VIEWS,
    ORIENTATIONS,
    WIDE_VIEWS,
    Shot,
    plan,
    told_board,
    visible,
)
from vergence.twin.head import Twin
from vergence.twin.profile import ErrorProfile, Lens

Target = Literal["chessboard", "charuco"]

CHARUCO = Charuco(
    squares_x=8, squares_y=6, square_m=0.042, marker_m=0.032, dictionary="DICT_4X4_50"
)
"""As large as the chessboard; smaller squares have markers that the 2.8 mm lens does not resolve
at 0.6 m."""

FRAMES = 60
"""Still frames of a dataset, unless asked for others."""
LEAST_FRAMES = 12
"""Fewer leave no three views for each camera."""
PART_SEEN = 0.4
"""Part of a ChArUco board that is worth an image."""

LEAST_MOVING = 3
"""Frames of a motion, as docs/dataset.md has it."""
RATE_HZ = 30.0
_SPEED_RAD_S = 2.5  # of the phase of pan: at 0.2 rad as fast as eyes that follow a hand
_AMPLITUDE_RAD = 0.2


def record(
    out: Path,
    *,
    profile: ErrorProfile,
    seed: int = 0,
    frames: int = FRAMES,
    lens: Lens = "2.8mm",
    target: Target = "chessboard",
    moving: int = 0,
) -> int:
    """Record a dataset on the twin, and the truth beside it in truth.json.

    Args:
        out: folder that is new or empty.
        profile: imperfections of the head.
        seed: of everything random.
        frames: how many still frames.
        lens: of the wide cameras.
        target: what is shown to the head.
        moving: how many frames follow in which the eyes move before the board at rest, at RATE_HZ.

    Returns:
        How many images were written.

    Raises:
        VergenceError: an argument cannot be met, or the folder cannot be written.
    """
    if frames < LEAST_FRAMES:
        raise VergenceError(f"A dataset has at least {LEAST_FRAMES} frames; asked for {frames}.")
    if moving < LEAST_MOVING and moving != 0:
        raise VergenceError(f"A motion has at least {LEAST_MOVING} frames; asked for {moving}.")
    if seed < 0:
        raise VergenceError(f"The seed must be a whole number from 0, found {seed}.")
    check_new(out)
    board: Board = CHARUCO if target == "charuco" else BOARD
    with (
        Twin(profile, seed=seed, lens=lens, board=CHARUCO if target == "charuco" else None) as twin,
        _progress() as progress,
    ):
        shots = _shots(twin, board, seed, frames)
        total = len(shots) + moving
        task = progress.add_task(f"recording {total} frames", total=total)
        true_angles: list[Array] = []
        images = 0

        def entries() -> Iterator[DatasetRow]:
            nonlocal images
            for shot, entry in _taken(twin, shots, board, moving):
                true_angles.append(shot.eye_angles)
                images += len(entry.frame.images)
                progress.advance(task)
                yield entry

        write_dataset(out, _description(twin, told_board(profile, board), lens, seed), entries())
        truth = Truth(
            head=with_sensors(twin.truth, profile.joints),
            time_offset_s=profile.joints.delay_ms * 1e-3,
            eye_angles=np.array(true_angles),
            T_lbase_target={shot.placement: shot.T_lbase_target for shot in shots},
            board=board,
            seed=seed,
            lens=lens,
            profile=profile,
        )
        truth_file.save(truth, out / truth_file.TRUTH)
    return images


def _progress() -> Progress:
    return Progress(
        TextColumn("{task.description:<28}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )


def _shots(twin: Twin, board: Board, seed: int, frames: int) -> list[Shot]:
    """Return the sequence, with each shot's cameras: all that see enough of the board."""
    whole = WIDE_VIEWS + 2 * NARROW_VIEWS + ORIENTATIONS
    wide = max(3, round(frames * WIDE_VIEWS / whole))
    narrow = max(3, round(frames * NARROW_VIEWS / whole))
    views = (wide, narrow, frames - wide - 2 * narrow)
    shots = plan(twin.nominal, seed, board=board, views=views)
    return [replace(shot, cameras=_watching(twin, board, shot)) for shot in shots]


def _watching(twin: Twin, board: Board, shot: Shot) -> tuple[str, ...]:
    part = 1.0 if board.kind == "chessboard" else PART_SEEN
    head = twin.nominal
    return tuple(n for n in head.cameras if visible(head, board, n, shot).mean() >= part)


def _taken(
    twin: Twin, shots: list[Shot], board: Board, moving: int
) -> Iterator[tuple[Shot, DatasetRow]]:
    """Yield each shot, its angles the true ones, and its row of the dataset."""
    posture: Array | None = None
    for shot in shots:
        twin.place_board(shot.T_lbase_target)
        if posture is None or (shot.eye_angles != posture).any():
            posture = shot.eye_angles
            twin.settle(_command(posture))
        else:
            twin.advance(twin.time_s + 0.1, _command(posture))  # each row has its own time stamp
        yield _take(twin, shot, moving=False)
    if moving:
        fixed, begin = shots[-1], twin.time_s + 0.6
        twin.settle(_command(_sweep(0.0)))
        for k in range(moving):
            time_s = k / RATE_HZ
            twin.advance(begin + time_s, lambda now: _command(_sweep(now - begin)))
            shot = replace(fixed, eye_angles=_sweep(time_s))
            yield _take(twin, replace(shot, cameras=_watching(twin, board, shot)), moving=True)


def _take(twin: Twin, shot: Shot, *, moving: bool) -> tuple[Shot, DatasetRow]:
    true_angles = twin.true_angles()[len(NECK_JOINTS) :]
    frame = twin.capture(shot.cameras)
    entry = DatasetRow(frame=frame, placement=shot.placement, moving=moving)
    return replace(shot, eye_angles=true_angles), entry


def _command(eye_angles: Array) -> Array:
    return np.concatenate([np.zeros(len(NECK_JOINTS)), eye_angles])


def _sweep(time_s: float) -> Array:
    """Return (4,) angles [rad] of a smooth motion: Eqs. 22 and 23, faster, each eye its own."""
    phase = _SPEED_RAD_S * time_s / np.array([1.0, 1.5, 1.2, 1.8])
    return _AMPLITUDE_RAD * np.cos(phase)


def _description(twin: Twin, board: Board, lens: str, seed: int) -> Description:
    cameras = {
        name: DatasetCamera(
            eye=mounted.eye, width=mounted.intrinsics.width, height=mounted.intrinsics.height
        )
        for name, mounted in twin.nominal.cameras.items()
    }
    return Description(
        cameras=cameras,
        board=board,
        joints={n: DatasetJoint(column=n, unit="rad") for n in (*EYE_JOINTS, *NECK_JOINTS)},
        note=f"Recorded on the twin: profile {twin.profile.name}, {lens} lens, seed {seed}.",
    )
