"""Record a dataset on the twin: the calibration sequence, then frames with moving eyes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass

from vergence.arrays import Array
from vergence.data.dataset import LEAST_MOVING
from vergence.data.description import (
    DatasetCamera,
    DatasetJoint,
    DatasetReading,
    Description,
    EyeJoint,
)
from vergence.data.reader import load_dataset
from vergence.data.writer import DatasetRow, write_dataset
from vergence.errors import VergenceError
from vergence.files import as_json, check_new, parse_json, read_parsed, validated
from vergence.geometry.board import Board, Charuco
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYE_JOINTS, EYES, Side
from vergence.progress import Progress, silent
from vergence.twin.bag import BagSettings, write_twin_bag
from vergence.twin.calibration_sequence import (
    BOARD,
    NARROW_VIEWS,
    ORIENTATIONS,
    WIDE_VIEWS,
    Shot,
    board_as_given,
    carry_out,
    plan,
    straight_neck,
    visible,
)
from vergence.twin.evaluation import TRUTH, Truth
from vergence.twin.head import Twin
from vergence.twin.model import NECK_JOINTS, nominal_head
from vergence.twin.profile import ErrorProfile, Lens
from vergence.twin.renderer import FINE
from vergence.twin.scene import Scene, put_charuco
from vergence.twin.sensors import with_sensors

Target = Literal["chessboard", "charuco"]

CHARUCO = Charuco(
    squares_x=8, squares_y=6, square_m=0.042, marker_m=0.032, dictionary="DICT_4X4_50"
)
"""As large as the chessboard; the 2.8 mm lens resolves its markers up to 0.6 m."""
LEAST_FRAMES, MOST_FRAMES = 12, 10_000
"""Numbers of frames at rest; below 12 some camera has fewer than three views."""
RATE_HZ = 30.0
"""Rate of the frames with moving eyes [Hz], as of usual cameras."""


@dataclass(frozen=True, eq=False, config=ConfigDict(extra="ignore"))
class StatedJoints:
    """Joints of the eyes in a dataset.json, whose other fields are not read."""

    kinematics: dict[Side, tuple[EyeJoint, ...]]
    readings: dict[str, DatasetReading]


def record(
    out: Path,
    *,
    profile: ErrorProfile,
    scene: Scene = "room",
    seed: int = 0,
    frames: int = 60,
    lens: Lens = "2.8mm",
    target: Target = "chessboard",
    moving: int = 0,
    kinematics: Path | None = None,
    bag: BagSettings | None = None,
    progress: Progress = silent,
) -> int:
    """Record a dataset with its truth into a new or empty folder; return the number of images.

    `frames` are taken with the eyes at rest. `moving` frames follow, at RATE_HZ, with moving eyes
    and the board at rest. `kinematics` is a JSON file with the twin's `kinematics` and `readings`
    as in dataset.json; None: pan, then tilt. `bag` asks for a bag with the same images in the
    folder. Progress is called after each frame. VergenceError if an argument is out of range, or
    the folder cannot be written.
    """
    if not LEAST_FRAMES <= frames <= MOST_FRAMES:
        raise VergenceError(
            f"A dataset has {LEAST_FRAMES} to {MOST_FRAMES} frames at rest; asked for {frames}."
        )
    if moving != 0 and not LEAST_MOVING <= moving <= MOST_FRAMES:
        raise VergenceError(
            f"A motion has {LEAST_MOVING} to {MOST_FRAMES} frames; asked for {moving}."
        )
    check_new(out)
    board: Board = CHARUCO if target == "charuco" else BOARD
    note = f"Recorded on the twin: profile {profile.name}, {lens} lens, seed {seed}."
    description = _description(lens, board_as_given(profile, board), note, kinematics)
    joints = description.head_kinematics
    true_angles: list[Array] = []
    images = 0
    with Twin(
        profile,
        seed=seed,
        lens=lens,
        kinematics=joints,
        scene=scene,
        oversampling=FINE,
        furnish=partial(put_charuco, board=board) if isinstance(board, Charuco) else None,
    ) as twin:
        shots = _shots(twin, board, seed, frames)
        total = len(shots) + moving
        task = f"recording {total} frames"
        progress(task, 0, total)

        def rows() -> Iterator[DatasetRow]:
            nonlocal images
            for true, row in _capture(twin, shots, board, moving):
                true_angles.append(true)
                images += len(row.frame.images)
                progress(task, len(true_angles), total)
                yield row

        def write_truth(folder: Path) -> None:
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
            (folder / TRUTH).write_text(as_json(truth), encoding="utf-8")

        log: list[tuple[float, Array]] = []
        if bag is not None and bag.joint_rate_hz:
            twin.watch = lambda *posture: log.append(posture)
        write_dataset(out, description, rows(), beside=write_truth)
        if bag is not None:
            data, sensors = load_dataset(out), profile.joints
            write_twin_bag(data, log, twin.truth, bag, joints=sensors, seed=seed, progress=progress)
    return images


def _shots(twin: Twin, board: Board, seed: int, frames: int) -> list[Shot]:
    """Plan the sequence with all the cameras that see enough of the board in each shot."""
    whole = WIDE_VIEWS + 2 * NARROW_VIEWS + ORIENTATIONS
    wide = max(3, round(frames * WIDE_VIEWS / whole))
    narrow = max(3, round(frames * NARROW_VIEWS / whole))
    views = (wide, narrow, frames - wide - 2 * narrow)
    shots = plan(twin.nominal, seed, board=board, views=views)
    shots[-views[2] :] = _verging(twin.nominal, shots[-views[2] :])
    return [replace(shot, cameras=_seeing(twin, board, shot)) for shot in shots]


def _verging(head: HeadCalibration, shots: list[Shot]) -> list[Shot]:
    """Add vergence to shots of eyes with separate readings.

    Exchanged readings of left and right cannot be detected in images of eyes that move alike.
    """
    left, right = (head.kinematics.used(eye) for eye in EYES)
    if set(left) & set(right):
        return shots
    moved = []
    for k, shot in enumerate(shots):
        readings = shot.eye_angles.copy()
        by = 0.03 * np.sin(2.4 * k + np.arange(max(len(left), len(right))))
        readings[left] += by[: len(left)] / head.kinematics.gear_ratios[left]
        readings[right] -= by[: len(right)] / head.kinematics.gear_ratios[right]
        moved.append(replace(shot, eye_angles=readings))
    return moved


def _seeing(twin: Twin, board: Board, shot: Shot) -> tuple[str, ...]:
    """Select the cameras that see the whole chessboard, or enough of a ChArUco board."""
    part = 1.0 if board.kind == "chessboard" else 0.4
    head = twin.nominal
    return tuple(n for n in head.cameras if visible(head, board, n, shot).mean() >= part)


def _capture(
    twin: Twin, shots: list[Shot], board: Board, moving: int
) -> Iterator[tuple[Array, DatasetRow]]:
    """Yield the true eye angles (r,) and the dataset's row of each frame."""
    for shot in carry_out(twin, shots, interval_s=0.1):  # each row has its own time stamp
        yield _frame(twin, shot, moving=False)
    if moving:
        fixed, begin, factors = shots[-1], twin.time_s + 0.6, twin.nominal.kinematics.gear_ratios
        twin.settle(straight_neck(_sweep(0.0, factors)))
        for k in range(moving):
            time_s = k / RATE_HZ
            twin.advance(begin + time_s, lambda now: straight_neck(_sweep(now - begin, factors)))
            shot = replace(fixed, eye_angles=_sweep(time_s, factors))
            yield _frame(twin, replace(shot, cameras=_seeing(twin, board, shot)), moving=True)


def _frame(twin: Twin, shot: Shot, *, moving: bool) -> tuple[Array, DatasetRow]:
    true_angles = twin.true_readings()
    frame = twin.capture(shot.cameras)
    return true_angles, DatasetRow(frame=frame, placement=shot.placement, moving=moving)


def _sweep(time_s: float, factors: Array) -> Array:
    """Compute readings (r,) [rad] of a smooth motion as in Eqs. 22-23, but faster."""
    n = len(factors)
    periods = np.concatenate([[1.0, 1.5, 1.2, 1.8], 2.0 + 0.2 * np.arange(max(0, n - 4))])
    # With 0.2 rad and a phase of 2.5 rad/s as fast as eyes that pursue a hand.
    return 0.2 * np.cos(2.5 * time_s / periods[:n]) / factors


def _description(lens: Lens, board: Board, note: str, kinematics: Path | None) -> Description:
    """Describe the dataset; VergenceError if the file of the joints is not valid."""
    cameras = {
        name: DatasetCamera(
            eye=mounted.eye, width=mounted.intrinsics.width, height=mounted.intrinsics.height
        )
        for name, mounted in nominal_head(lens).cameras.items()
    }
    neck = {name: DatasetJoint(column=name, unit="rad") for name in NECK_JOINTS}
    if kinematics is None:
        eyes = {name: DatasetJoint(column=name, unit="rad") for name in EYE_JOINTS}
        return Description(cameras=cameras, board=board, joints=eyes | neck, note=note)

    def build(content: object) -> Description:
        stated = validated(content, StatedJoints)
        return Description(
            cameras=cameras,
            board=board,
            joints=neck,
            kinematics=stated.kinematics,
            readings=stated.readings,
            note=note,
        )

    return read_parsed(kinematics, "a description of joints", build, parse_json)
