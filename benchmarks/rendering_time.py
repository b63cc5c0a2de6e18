"""Processor time of the pictures of Figs. 6-11, beside that of an earlier commit.

    python benchmarks/rendering_time.py [--before COMMIT] [--rounds 8] [--scene room]

Two processes, one with the sources of the commit and one with these, take the same frames in turn:
of each figure a few postures along its motion, with the wide cameras, and every fourth with all,
as the recordings of `vergence reproduce` have them. Pictures are finished: distorted, blurred, and
with noise. Reported are the median time of a round of either, and the median of their ratios, which
neither the load of the machine nor its speed changes much.
"""

from __future__ import annotations

import argparse
import io
import os
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
BEFORE = "253f675"
"""The last commit with a grey room."""
BAR = 2 / 3
WORKER = """
import sys, time
import numpy as np
from contextlib import ExitStack
from vergence.paper.figures import FIGURES
from vergence.twin.calibration_sequence import straight_neck
from vergence.twin.head import Twin
from vergence.twin.profile import load_profile

options = {"scene": sys.argv[1]} if sys.argv[1] else {}
with ExitStack() as stack:
    twins = {
        lens: stack.enter_context(Twin(load_profile("paper"), lens=lens, **options))
        for lens in ("2.8mm", "4.0mm")
    }
    for line in sys.stdin:
        spent, number = 0.0, int(line)
        for figure in FIGURES.values():
            twin = twins[figure.lens]
            twin.restart(0)
            twin.place_object(np.array(figure.mean_m))
            for k in range(4):
                right = (1.0, 1.5) if figure.motion == "parallel" else (2.0, 2.5)
                time_s = 11.0 * number + 3 * k
                gaze = 0.25 * np.cos(time_s / np.array([1.0, 1.5, *right]))  # Eqs. 22 and 23
                posture = straight_neck(gaze)
                twin.advance(twin.time_s + 0.3, posture)
                cameras = tuple(twin.truth.cameras) if k == 0 else ("left_wide", "right_wide")
                begin = time.process_time()
                twin.capture(cameras)
                spent += time.process_time() - begin
        print(spent, flush=True)
"""


def start(source: Path, scene: str) -> subprocess.Popen[str]:
    """Start a process that renders a round for each line that it reads, and answers its time."""
    environment = {**os.environ, "PYTHONPATH": str(source / "src"), "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, "-c", WORKER, scene],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def ask(worker: subprocess.Popen[str], number: int) -> float:
    """Return the processor time [s] of a round."""
    assert worker.stdin
    assert worker.stdout
    worker.stdin.write(f"{number}\n")
    worker.stdin.flush()
    return float(worker.stdout.readline())


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--before", default=BEFORE)
    parser.add_argument("--rounds", type=int, default=8)
    parser.add_argument("--scene", default="room")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        archive = subprocess.check_output(["git", "-C", str(ROOT), "archive", asked.before])
        with tarfile.open(fileobj=io.BytesIO(archive)) as sources:
            sources.extractall(folder, filter="data")
        before, now = start(Path(folder), ""), start(ROOT, asked.scene)
        try:
            times = [(ask(before, k), ask(now, k)) for k in range(asked.rounds + 1)][1:]
        finally:
            before.kill()
            now.kill()
    spent = np.array(times)
    ratios = spent[:, 1] / spent[:, 0]
    print(f"24 frames, 60 images: {asked.before} {np.median(spent[:, 0]):.2f} s, now ", end="")
    print(f"{np.median(spent[:, 1]):.2f} s of processor time")
    print(f"ratio: median {np.median(ratios):.3f}, {ratios.min():.3f} to {ratios.max():.3f}")
    print(f"bar: {BAR:.3f}")


if __name__ == "__main__":
    main()
