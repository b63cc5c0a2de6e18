"""How fast `vergence design` sweeps, and how true what it says of the calibration's effort is.

    python benchmarks/design_sweep.py

Speed: the default sweep, in combinations of a design, a point and a posture, by one process and by
one for each core, with processes started, chunks written and results read; and its processor time
alone. Set OPENBLAS_NUM_THREADS=1, as the command does.

Effort: for designs drawn at random, recordings as docs/calibrate.md advises them are simulated
(the board held at straight gaze, then at rest before eyes that move) and calibrated by bundle
adjustment. Printed is the root mean square of what their calibrations add to points of the
workspace, relative to what the sweep says of as many views.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import tyro

from simulated_head import rough_start
from simulated_recording import BOARD, Noise, Recording, record
from vergence.accuracy.design import designed_head, fixating_joints, sensitivity
from vergence.accuracy.design_chunks import sweep
from vergence.accuracy.design_settings import DesignSettings, chunks
from vergence.accuracy.design_sweep import compute_chunk, costs, located_points
from vergence.accuracy.plan_workspace import point_by_parameters
from vergence.calibration.bundle_adjustment import bundle_adjust
from vergence.geometry.parameters import parameter_names

BAR = 1e6
PAIR = ("left_wide", "right_wide")


@dataclass(frozen=True)
class Config:
    """How much is measured."""

    repeats: int = 3
    """Of the sweep, of which the fastest counts."""
    heads: int = 20
    seed: int = 0


def speed(repeats: int) -> float:
    """Print combinations a second, and return those of all cores."""
    settings = DesignSettings()
    points, _ = located_points(settings)
    count = costs(settings).size * points[..., 0].size
    started = time.process_time()
    for chunk in chunks(settings):
        compute_chunk(chunk)
    used = time.process_time() - started
    print(f"{count:,} combinations, {count / used:,.0f} a second of processor time")
    fastest = 0.0
    for jobs in (1, -1):
        seconds = []
        for _ in range(repeats):
            with TemporaryDirectory() as folder:
                started = time.perf_counter()
                sweep(settings, Path(folder), jobs=jobs)
                seconds.append(time.perf_counter() - started)
        fastest = count / min(seconds)
        print(f"jobs {jobs:2d}: {fastest:,.0f} a second")
    return fastest


def effort_ratio(rng: np.random.Generator) -> float:
    """Return what a simulated calibration adds to points, relative to what the sweep says."""
    baseline_m, focal_px = rng.uniform(0.06, 0.12), rng.uniform(250, 500)
    joint_rad = np.radians(np.exp(rng.uniform(*np.log([0.02, 0.1]))))
    head = designed_head(baseline_m, focal_px, 0.02, (640, 480))
    how = Recording(
        straight=int(rng.integers(10, 20)),
        orientations=int(rng.integers(20, 40)),
        noise=Noise(pixel_px=0.1, joint_rad=float(joint_rad)),
    )
    recorded = record(head, rng, how)
    found = bundle_adjust(rough_start(head, rng), recorded)
    points, off = located_points(DesignSettings())
    points_m = points - [0.0, baseline_m / 2, 0.0]
    joints = (fixating_joints(baseline_m, points_m) + np.tile(off, 2)).reshape(-1, 4)
    points_m = points_m.reshape(-1, 3)
    columns = [parameter_names(head).index(name) for name in found.accuracy.parameters]
    moved = point_by_parameters(found.head, PAIR, points_m, joints)[..., columns]
    stated = np.einsum("nip,pq,niq->n", moved, found.accuracy.covariance, moved, optimize=True)
    predicted = sensitivity(
        head,
        replace(BOARD),
        points=points_m,
        joints=joints,
        corner_std_px=0.1,
        joint_std_rad=np.array([joint_rad]),
    )
    said = predicted.calibration[0] / len(recorded.placement)
    return float(np.sqrt(np.mean(stated / said)))


def main(config: Config) -> int:
    """Print both, and return 1 if the bar of speed is missed."""
    found = speed(config.repeats)
    ratios = [effort_ratio(np.random.default_rng([config.seed, k])) for k in range(config.heads)]
    low, middle, high = np.percentile(ratios, [10, 50, 90])
    print(f"calibration / said: median {middle:.2f}, 10 to 90 % {low:.2f} to {high:.2f}")
    return int(found < BAR)


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Config, description=__doc__)))
