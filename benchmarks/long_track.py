"""Memory and time of a step over a long run of `vergence track`: both stay flat.

The run is recorded, as by `vergence track --out`. The time of a step of the gaze controller is that
of its thread: other programs affect it little. Memory is read from Linux's /proc.

    python benchmarks/long_track.py [--seconds 600]
"""

import os
import time
from pathlib import Path
from unittest.mock import patch

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import cv2
import numpy as np
import tyro

from vergence.demos.experiment import Experiment
from vergence.demos.track import track
from vergence.gaze import controller
from vergence.gaze.state import GazeState
from vergence.twin.profile import load_profile
from vergence.twin.simulated_robot import FRAME_S

PARTS = 10


def memory_mb() -> float:
    """Return the resident memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def main(seconds: float = 600.0, out: Path = Path("runs/long_track")) -> None:
    """Print a table over ten parts of the run.

    Args:
        seconds: simulated length of the run.
        out: folder of its recording.
    """
    cv2.setNumThreads(1)
    took: list[float] = []
    memory: list[float] = []
    step_gaze, part = controller.step_gaze, int(seconds / FRAME_S / PARTS)

    def timed(*arguments: object) -> GazeState:
        began = time.thread_time()
        state = step_gaze(*arguments)  # pyright: ignore[reportArgumentType]
        took.append(time.thread_time() - began)
        if len(took) % part == 0:
            memory.append(memory_mb())
            times = np.array(took[-part:]) * 1e3
            print(
                f"| {len(took)} | {memory[-1]:.0f} | {np.median(times):.2f} "
                f"| {np.quantile(times, 0.99):.2f} |",
                flush=True,
            )
        return state

    print("| frames | memory [MB] | step, median [ms] | 99 % [ms] |\n|---|---|---|---|")
    with patch.object(controller, "step_gaze", timed):
        track(Experiment(load_profile("ideal"), out=out), seconds=seconds)
    size_mb = (out / "track.rrd").stat().st_size / 1e6
    print(f"{len(took)} frames; a recording of {size_mb:.0f} MB")
    print(f"memory, last part minus second: {memory[-1] - memory[1]:+.0f} MB")


if __name__ == "__main__":
    tyro.cli(main)
