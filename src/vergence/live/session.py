"""Run a guided capture with a driver; a thread calibrates the views meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.data.writer import DatasetRow, check_images
from vergence.gaze.commands import HeadCommand, HeadDriver, JointLimits, hold, setpoint
from vergence.geometry.head import main_cameras
from vergence.live.capture import (
    SWEEP_PERIODS_S,
    SWEEP_RAD,
    CaptureSettings,
    CaptureState,
    step_capture,
    with_estimate,
)
from vergence.live.estimate import Estimate, estimate
from vergence.live.guide import STRAIGHT_VIEWS
from vergence.live.stillness import Detect, find_board

LEAST_VIEWS = STRAIGHT_VIEWS + 6
"""Views from which a calibration is tried: those with straight gaze, and some by turned eyes."""
AFTER_S = 1.0
"""Time between the last row that was kept and the first frame, where the clock began anew [s]."""

Keep = Callable[[tuple[DatasetRow, ...]], None]
"""Stores rows of the dataset."""
Look = Callable[[CaptureState, Frame], None]
"""Is called after each frame."""


def run_capture(
    driver: HeadDriver,
    settings: CaptureSettings,
    state: CaptureState,
    keep: Keep,
    *,
    until_s: float = np.inf,
    detect: Detect = find_board,
    look: Look = lambda state, frame: None,
    pool: Executor | None = None,
) -> CaptureState:
    """Capture until the accuracy is reached, more views do not help, or a time of the clock.

    With limits in the settings the eyes are commanded to the readings of the views. Where the clock
    began anew, frames are moved behind the rows that were kept before.
    """
    every, main = tuple(settings.description.cameras), main_cameras(state.head)
    kept_s = max((view.frame.time_s for view in state.kept), default=-np.inf)
    last_s, shift_s = -np.inf, None
    command: HeadCommand | None = None
    with pool or ThreadPoolExecutor(1) as pool:
        job: Future[Estimate] | None = None
        while not state.finished and driver.now_s() < until_s:
            frame = driver.read(every if state.all_cameras else main)
            if frame is None or frame.time_s <= last_s:
                continue
            last_s = frame.time_s
            if shift_s is None:
                check_images(settings.description, frame)
                shift_s = max(0.0, kept_s + AFTER_S - frame.time_s)
            moved_s = frame.time_s + shift_s, frame.joint_time_s + shift_s
            frame = replace(frame, time_s=moved_s[0], joint_time_s=moved_s[1])
            state, rows = step_capture(settings, state, frame, detect)
            if rows:
                keep(rows)
            if job is not None and job.done():
                state, job = with_estimate(settings, state, job.result()), None
            known = 0 if state.estimate is None else state.estimate.rows
            if job is None and state.views >= LEAST_VIEWS and len(state.kept) > known:
                job = pool.submit(
                    estimate,
                    settings.description,
                    state.kept,
                    limits_rad=settings.limits_rad,
                    distance_m=settings.distance_m,
                    seed=settings.seed,
                )
            if settings.limits is not None:
                command = _command(settings.limits, state, frame, command, driver.now_s())
                driver.command(command)
            look(state, frame)
    return state


def _command(
    limits: JointLimits,
    state: CaptureState,
    frame: Frame,
    last: HeadCommand | None,
    now_s: float,
) -> HeadCommand:
    """Turn the eyes to the readings of the view that is asked for, or sweep; the neck stays."""
    posture = np.concatenate([frame.neck_angles, frame.eye_angles])
    start = posture if last is None else setpoint(last, now_s)
    command, neck = hold(start, limits, now_s), start[: len(frame.neck_angles)]
    if state.sweep is None:
        return replace(command, goal=np.concatenate([neck, state.asked[0].joints]))
    joints = len(frame.eye_angles)
    turn, rate = sweep(frame.time_s - state.sweep.begin_s, joints)
    goal = state.sweep.posture + np.concatenate([0 * neck, turn])
    return replace(command, goal=goal, rate=np.concatenate([0 * neck, rate]))


def sweep(time_s: float, joints: int) -> tuple[Array, Array]:
    """Compute turns (r,) [rad] and rates (r,) [rad/s] of a sweep at a time from its begin."""
    frequency = 2 * np.pi / np.resize(SWEEP_PERIODS_S, joints)
    phase = frequency * time_s
    return SWEEP_RAD * np.sin(phase), SWEEP_RAD * frequency * np.cos(phase)
