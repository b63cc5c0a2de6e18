"""Record a dataset on the twin: the calibration sequence, then frames with moving eyes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

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
from vergence.files import as_json, check_new
from vergence.geometry.board import Board, Charuco
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYE_JOINTS, EYES, Kinematics, Side, same_design
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
    other_cameras,
    plan,
    visible,
    within,
)
from vergence.twin.evaluation import TRUTH, Truth
from vergence.twin.head import Twin
from vergence.twin.head_model import HeadModel, load_head_model
from vergence.twin.profile import ErrorProfile
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
HOLD_S = 0.3
"""Time [s] for which the eyes stay after a frame where joints are read at their own rate, so that
readings around the frame are of one posture, whatever the latency."""


def record(
    out: Path,
    *,
    profile: ErrorProfile,
    scene: Scene = "room",
    seed: int = 0,
    frames: int = 60,
    target: Target = "chessboard",
    moving: int = 0,
    head: HeadModel | None = None,
    bag: BagSettings | None = None,
    progress: Progress = silent,
) -> int:
    """Record a dataset with its truth into a new or empty folder; return the number of images.

    `frames` are taken with the eyes at rest. `moving` frames follow, at RATE_HZ, with moving eyes
    and the board at rest. `head` is one that `load_head_model` reads; None: the default one.
    `bag` asks for a bag with the same images in the folder. VergenceError if an argument is out of
    range, or the folder cannot be written.
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
    head = load_head_model() if head is None else head
    with_lens = f"{head.lens} lens" if head.lens else head.stated.model
    note = f"Recorded on the twin: profile {profile.name}, {with_lens}, seed {seed}."
    description = describe_twin(head.designed.head, board_as_given(profile, board), note)
    true_angles: list[Array] = []
    images = 0
    with Twin(
        profile,
        head=head,
        seed=seed,
        scene=scene,
        oversampling=FINE,
        furnish=partial(put_charuco, board=board) if isinstance(board, Charuco) else None,
    ) as twin:
        shots = _shots(twin, board, seed, frames)
        total = len(shots) + moving
        task = f"recording {total} frames"
        progress(task, 0, total)
        log: list[tuple[float, Array]] = []
        streamed = bag is not None and bag.joint_rate_hz > 0
        if streamed:
            twin.watch = lambda *posture: log.append(posture)
        hold_s = HOLD_S if streamed else 0.0

        def rows() -> Iterator[DatasetRow]:
            nonlocal images
            for true, row in _capture(twin, shots, board, moving, hold_s):
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
                lens=head.lens,
                profile=profile,
            )
            (folder / TRUTH).write_text(as_json(truth), encoding="utf-8")

        write_dataset(out, description, rows(), beside=write_truth)
        if bag is not None:
            data, sensors = load_dataset(out), profile.joints
            write_twin_bag(data, log, twin.truth, bag, joints=sensors, seed=seed, progress=progress)
    return images


def _shots(twin: Twin, board: Board, seed: int, frames: int) -> list[Shot]:
    """Plan the sequence with all the cameras that see enough of the board in each shot."""
    others = len(other_cameras(twin.nominal))
    whole = WIDE_VIEWS + others * NARROW_VIEWS + ORIENTATIONS
    wide = max(3, round(frames * WIDE_VIEWS / whole))
    narrow = max(3, round(frames * NARROW_VIEWS / whole))
    views = (wide, narrow, frames - wide - others * narrow)
    shots = plan(twin.nominal, seed, board=board, limits=twin.limits, views=views)
    shots[-views[2] :] = _verging(twin, shots[-views[2] :])
    return [replace(shot, cameras=_seeing(twin, board, shot)) for shot in shots]


def _verging(twin: Twin, shots: list[Shot]) -> list[Shot]:
    """Add vergence where eyes have separate readings, so that exchanged ones can be detected."""
    head, ranges = twin.nominal, _ranges(twin)
    left, right = (head.kinematics.used(eye) for eye in EYES)
    if set(left) & set(right):
        return shots
    moved = []
    for k, shot in enumerate(shots):
        readings = shot.eye_angles.copy()
        by = 0.03 * np.sin(2.4 * k + np.arange(max(len(left), len(right))))
        readings[left] += by[: len(left)] / head.kinematics.gear_ratios[left]
        readings[right] -= by[: len(right)] / head.kinematics.gear_ratios[right]
        moved.append(replace(shot, eye_angles=np.clip(readings, *ranges.T)))
    return moved


def _seeing(twin: Twin, board: Board, shot: Shot) -> tuple[str, ...]:
    """Select the cameras that see the whole chessboard, or enough of a ChArUco board."""
    part = 1.0 if board.kind == "chessboard" else 0.4
    head = twin.nominal
    return tuple(n for n in head.cameras if visible(head, board, n, shot).mean() >= part)


def _capture(
    twin: Twin, shots: list[Shot], board: Board, moving: int, hold_s: float
) -> Iterator[tuple[Array, DatasetRow]]:
    """Yield the true eye angles (r,) and the dataset's row of each frame.

    After each frame at rest the eyes stay for `hold_s`; unless it is 0, one follows the motion.
    """
    for shot in carry_out(twin, shots, interval_s=0.1):  # each row has its own time stamp
        yield _frame(twin, shot, moving=False)
        twin.advance(twin.time_s + hold_s, twin.posture(shot.eye_angles))
    if moving:
        fixed, begin = shots[-1], twin.time_s + 0.6
        twin.settle(twin.posture(_sweep(twin, 0.0)))
        for k in range(moving):
            time_s = k / RATE_HZ
            twin.advance(begin + time_s, lambda now: twin.posture(_sweep(twin, now - begin)))
            shot = replace(fixed, eye_angles=_sweep(twin, time_s))
            yield _frame(twin, replace(shot, cameras=_seeing(twin, board, shot)), moving=True)
        if hold_s:  # the motion goes on for a while, since readings are interpolated
            twin.advance(twin.time_s + hold_s, lambda now: twin.posture(_sweep(twin, now - begin)))
            twin.settle(twin.posture(fixed.eye_angles))
            yield _frame(twin, fixed, moving=False)
            twin.advance(twin.time_s + hold_s, twin.posture(fixed.eye_angles))


def _frame(twin: Twin, shot: Shot, *, moving: bool) -> tuple[Array, DatasetRow]:
    true_angles = twin.true_readings()
    frame = twin.capture(shot.cameras)
    return true_angles, DatasetRow(frame=frame, placement=shot.placement, moving=moving)


def _ranges(twin: Twin) -> Array:
    """Look up the ranges (r, 2) [rad] of set points of the readings."""
    return twin.limits.setpoint_range_rad[len(twin.nominal.neck.axes) :]


def _sweep(twin: Twin, time_s: float) -> Array:
    """Compute readings (r,) [rad] of a smooth motion as in Eqs. 22-23, but faster."""
    factors = twin.nominal.kinematics.gear_ratios
    n = len(factors)
    periods = np.concatenate([[1.0, 1.5, 1.2, 1.8], 2.0 + 0.2 * np.arange(max(0, n - 4))])
    # With 0.2 rad and a phase of 2.5 rad/s as fast as eyes that pursue a hand.
    readings = 0.2 * np.cos(2.5 * time_s / periods[:n]) / factors
    return within(_ranges(twin), readings, 0.2 / factors)


def describe_twin(head: HeadCalibration, board: Board | None, note: str) -> Description:
    """Describe the dataset of a head as designed."""
    cameras = {
        name: DatasetCamera(
            eye=mounted.eye, width=mounted.intrinsics.width, height=mounted.intrinsics.height
        )
        for name, mounted in head.cameras.items()
    }
    neck = {name: DatasetJoint(column=name, unit="rad") for name in head.neck.names}
    readings = head.kinematics.readings
    if readings == EYE_JOINTS and same_design(head.kinematics, Kinematics()):
        eyes = {name: DatasetJoint(column=name, unit="rad") for name in readings}
        return Description(cameras=cameras, board=board, joints=eyes | neck, note=note)
    joints: dict[Side, tuple[EyeJoint, ...]] = {
        eye: tuple(EyeJoint(each.name, each.axis, each.readings, each.point_m) for each in chain)
        for eye, chain in head.kinematics.eyes.items()
        if chain
    }
    return Description(
        cameras=cameras,
        board=board,
        joints=neck,
        kinematics=joints,
        readings={name: DatasetReading(unit="rad") for name in readings},
        note=note,
    )
