"""Processor time of one control step: detection in the requested images, estimate, command.

Rendering is not counted. First the gaze alone: the object moves, so that the eyes are in pursuit,
and every eighth step has all four images, as after a saccade. Then a whole reach for an object that
is held out, in which the hand's marker is searched for as well. Last the gaze with the geometry
that both eyes see: its step, and what follows once the command was sent. The time is that of the
thread that does the step: other programs, and threads of the renderer, affect it little.

    python benchmarks/control_step.py [--frames 120]
"""

import os
import time
from collections import defaultdict
from dataclasses import replace

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # the figures are stated for one core

import cv2
import numpy as np
import tyro

from vergence.arrays import Array
from vergence.demos.grasp import LONGEST_S, hand_held
from vergence.gaze.controller import step_gaze
from vergence.gaze.observation import update_track
from vergence.gaze.reaching import ReachPhase, ReachSettings, initial_reach_state, step_reach
from vergence.gaze.state import GazeSettings, initial_gaze_state
from vergence.twin.hand import SimulatedHand, arm_mounting_error
from vergence.twin.head import Twin
from vergence.twin.profile import load_profile
from vergence.twin.simulated_robot import FRAME_S, SimulatedHead

WARM_UP = 5
FEWEST = 10
"""Fewest steps of a kind that are reported."""


def path(time_s: float) -> Array:
    """Return the object's position (3,) [m] in frame head: on a circle at 0.2 m/s."""
    turn = 2.5 * time_s
    return np.array([0.6, 0.08 * np.sin(turn), 0.08 * np.cos(turn)])


def gaze_steps(twin: Twin, frames: int) -> dict[str, list[float]]:
    """Return the times of gaze steps [s], by number of images."""
    seconds: dict[str, list[float]] = defaultdict(list)
    head, settings = SimulatedHead(twin, 0, path), GazeSettings(calibration=twin.truth)
    state = initial_gaze_state(settings, np.zeros(len(settings.joints)), head.now_s())
    for k in range(frames + WARM_UP):
        cameras = settings.cameras if k % 8 == 0 else state.cameras
        frame = head.read(cameras)
        state = replace(state, cameras=cameras)
        began = time.thread_time()
        state = step_gaze(settings, state, frame, head.now_s())
        if k >= WARM_UP:
            seconds[f"gaze, {len(cameras)} images"].append(time.thread_time() - began)
        head.command(state.command)
    return seconds


def reach_steps(twin: Twin, trials: int) -> dict[str, list[float]]:
    """Return the times of reach steps [s], by phase and number of images."""
    seconds: dict[str, list[float]] = defaultdict(list)
    settings = ReachSettings(gaze=GazeSettings(calibration=twin.truth))
    for run in range(1, trials + 1):
        head = SimulatedHead(twin, run, hand_held(0, run))
        head.hand = hand = SimulatedHand(twin, settings.home, arm_mounting_error(0, run))
        state = initial_reach_state(
            settings, np.zeros(len(settings.gaze.joints)), hand.read(), head.now_s()
        )
        while head.now_s() < LONGEST_S and state.phase is not ReachPhase.HELD:
            cameras, frame, reading = state.cameras, head.read(state.cameras), hand.read()
            began = time.thread_time()
            state = step_reach(settings, state, frame, reading, head.now_s())
            took = time.thread_time() - began
            seconds[f"{state.phase.value}, {len(cameras)} images"].append(took)
            head.command(state.gaze.command)
            hand.command(state.command)
    return seconds


def seen_steps(twin: Twin, frames: int) -> dict[str, list[float]]:
    """Return the times [s] of gaze steps with all images, and of what follows the command."""
    seconds: dict[str, list[float]] = defaultdict(list)
    head, settings = SimulatedHead(twin, 0, path), GazeSettings(twin.truth, geometry="seen")
    state = initial_gaze_state(settings, np.zeros(len(settings.joints)), head.now_s())
    for k in range(frames + WARM_UP):
        frame = head.read(state.cameras)
        began = time.thread_time()
        state = step_gaze(settings, state, frame, head.now_s())
        sent = time.thread_time()
        head.command(state.command)
        state = update_track(settings, state, frame)
        if k >= WARM_UP:
            seconds["gaze by what both eyes see, until the command"].append(sent - began)
            seconds["gaze by what both eyes see, after it"].append(time.thread_time() - sent)
    return seconds


def main(frames: int = 120, trials: int = 3) -> None:
    """Print the times of a step.

    Args:
        frames: number of steps of the gaze alone.
        trials: number of objects to reach for.
    """
    cv2.setNumThreads(1)
    with Twin(load_profile("ideal")) as twin:
        seconds = gaze_steps(twin, frames) | reach_steps(twin, trials) | seen_steps(twin, frames)
    for kind, times in seconds.items():
        if len(times) < FEWEST:
            continue
        median, high = np.median(times), np.quantile(times, 0.95)
        share = median / FRAME_S
        print(
            f"{kind}: median {1e3 * median:.1f} ms, 95 % {1e3 * high:.1f} ms, "
            f"{share:.0%} of a frame's {1e3 * FRAME_S:.0f} ms ({len(times)} steps)"
        )


if __name__ == "__main__":
    tyro.cli(main)
