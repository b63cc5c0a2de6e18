"""How long one control step takes: detection in the images it asked for, estimate, command.

Rendering is not counted. First the gaze alone: the object moves, so that the eyes are in pursuit,
and every eighth step is given all four images, as at a hand-over. Then a whole reach for an object
that is held out, in which the hand's marker is sought as well. Time is the processor's for the
thread that does the step, all of it: what else runs on the machine counts little, and threads of
the renderer that are still at work on the frame before do not.

    python benchmarks/control_step.py [--frames 120]
"""

import os
import time
from collections import defaultdict
from dataclasses import replace

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # one core is what is claimed

import cv2
import numpy as np
import tyro

from vergence.arrays import Array
from vergence.demos.grasp import LONGEST_S, held_out
from vergence.gaze.commands import HEAD_JOINTS
from vergence.gaze.controller import NARROW, WIDE, Settings, start, step
from vergence.geometry.head import T_head_base
from vergence.geometry.se3 import inverse, transform
from vergence.reach import controller
from vergence.twin.hand import HeadWithHand, TwinHand, roughly_mounted
from vergence.twin.head import Twin
from vergence.twin.profile import load_profile
from vergence.twin.simulated_robot import FRAME_S, TwinHead

WARM_UP = 5
FEWEST = 10
"""Steps of a kind, for a line of their own."""


def path(time_s: float) -> Array:
    """Return where the object is (3,) [m]: on a circle at 0.2 m/s."""
    turn = 2.5 * time_s
    return np.array([0.6, 0.08 * np.sin(turn) - 0.046, 0.08 * np.cos(turn)])


def gaze_steps(twin: Twin, frames: int) -> dict[str, list[float]]:
    """Return the seconds of steps of the gaze, by how many images they had."""
    seconds: dict[str, list[float]] = defaultdict(list)
    head, settings = TwinHead(twin, 0, path), Settings(calibration=twin.truth)
    state = start(settings, np.zeros(len(HEAD_JOINTS)), head.now_s())
    for k in range(frames + WARM_UP):
        cameras = (*WIDE, *NARROW) if k % 8 == 0 else state.cameras
        frame = head.read(cameras)
        state = replace(state, cameras=cameras)
        began = time.thread_time()
        state = step(settings, state, frame, head.now_s())
        if k >= WARM_UP:
            seconds[f"gaze, {len(cameras)} images"].append(time.thread_time() - began)
        head.command(state.command)
    return seconds


def reach_steps(twin: Twin, trials: int) -> dict[str, list[float]]:
    """Return the seconds of steps of reaching for an object, by phase and number of images."""
    seconds: dict[str, list[float]] = defaultdict(list)
    settings = controller.Settings(gaze=Settings(calibration=twin.truth))
    T_lbase_head = inverse(T_head_base(twin.truth, "left"))
    for run in range(1, trials + 1):
        object_at = held_out(0, run)
        head = HeadWithHand(twin, run, lambda t, at=object_at: transform(T_lbase_head, at(t)))
        head.hand = hand = TwinHand(twin, settings.home, roughly_mounted(0, run))
        state = controller.start(settings, np.zeros(len(HEAD_JOINTS)), hand.read(), head.now_s())
        while head.now_s() < LONGEST_S and state.phase is not controller.Phase.HELD:
            cameras, frame, reading = state.cameras, head.read(state.cameras), hand.read()
            began = time.thread_time()
            state = controller.step(settings, state, frame, reading, head.now_s())
            took = time.thread_time() - began
            seconds[f"{state.phase.value}, {len(cameras)} images"].append(took)
            head.command(state.gaze.command)
            hand.command(state.command)
    return seconds


def main(frames: int = 120, trials: int = 3) -> None:
    """Print the times of a step.

    Args:
        frames: how many are stepped through with the gaze alone.
        trials: how many objects are reached for.
    """
    cv2.setNumThreads(1)
    with Twin(load_profile("ideal")) as twin:
        seconds = gaze_steps(twin, frames) | reach_steps(twin, trials)
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
