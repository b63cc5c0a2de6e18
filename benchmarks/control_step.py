"""How long one control step takes: detection in the images it asked for, estimate, command.

Rendering is not counted. The object moves, so that the eyes are in pursuit; every eighth step is
given all four images, as at a hand-over. Time is that of the processor, of all threads, so that
whatever else runs on the machine does not count.

    python benchmarks/control_step.py [--frames 120]
"""

import time
from dataclasses import replace

import cv2
import numpy as np
import tyro

from vergence.arrays import Array
from vergence.experiments.live import FRAME_S, TwinHead
from vergence.gaze import NARROW, WIDE, Settings, start, step
from vergence.motion import HEAD_JOINTS
from vergence.twin.head import Twin
from vergence.twin.profile import load_profile

WARM_UP = 5


def path(time_s: float) -> Array:
    """Return where the object is (3,) [m]: on a circle at 0.2 m/s."""
    turn = 2.5 * time_s
    return np.array([0.6, 0.08 * np.sin(turn) - 0.046, 0.08 * np.cos(turn)])


def main(frames: int = 120) -> None:
    """Print the times of a step.

    Args:
        frames: how many are stepped through.
    """
    cv2.setNumThreads(1)  # one core is what is claimed
    seconds: dict[int, list[float]] = {2: [], 4: []}
    with Twin(load_profile("ideal")) as twin:
        head, settings = TwinHead(twin, 0, path), Settings(calibration=twin.truth)
        state = start(settings, np.zeros(len(HEAD_JOINTS)), head.now_s())
        for k in range(frames + WARM_UP):
            cameras = (*WIDE, *NARROW) if k % 8 == 0 else state.cameras
            frame = head.read(cameras)
            state = replace(state, cameras=cameras)
            began = time.process_time()
            state = step(settings, state, frame, head.now_s())
            if k >= WARM_UP:
                seconds.setdefault(len(cameras), []).append(time.process_time() - began)
            head.command(state.command)
    for cameras, times in seconds.items():
        median, worst = np.median(times), np.quantile(times, 0.95)
        share = median / FRAME_S
        print(
            f"{cameras} images: median {1e3 * median:.1f} ms, 95 % {1e3 * worst:.1f} ms, "
            f"{share:.0%} of a frame's {1e3 * FRAME_S:.0f} ms"
        )


if __name__ == "__main__":
    tyro.cli(main)
