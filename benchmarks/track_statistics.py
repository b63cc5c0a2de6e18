"""Statistics of `vergence track` over many runs, each with its own seed.

    python benchmarks/track_statistics.py [--profile ideal] [--runs 20] [--seconds 60]

A run takes a few minutes. Its result is kept in a file of the output folder, so that an interrupted
series continues; delete the folder to start again, as after a change of the software.
"""

import json
from pathlib import Path

import numpy as np
import tyro

from vergence.demos.experiment import Experiment
from vergence.demos.track import track
from vergence.files import write_json
from vergence.twin.profile import load_profile

OUT = Path("runs/track_statistics")
IN_BOTH, RMS_PX = 0.99, 32.0
"""Limits: least share of frames in both narrow images, greatest distance from their centres."""


def summaries(out: Path, profile: str, runs: int, seconds: float) -> list[dict[str, float]]:
    """Return the summaries of all runs, and make those that are missing."""
    found = []
    for seed in range(runs):
        file = out / f"{profile}-{seconds:g}s-{seed}.json"
        if not file.is_file():
            made = track(Experiment(load_profile(profile), seed), seconds=seconds)
            write_json(made, file)
        kept = json.loads(file.read_text())
        found.append({key: np.inf if value is None else value for key, value in kept.items()})
        print(row(f"{seed}", found[-1]), flush=True)
    return found


def row(name: str, found: dict[str, float]) -> str:
    """Return a row of the table in Markdown."""
    position = (f"{1e3 * found[key]:.3f}" for key in ("position_rms_m", "single_frame_rms_m"))
    return (
        f"| {name} | {found['in_both']:.2%} | {found['rms_px']:.2f} | {' | '.join(position)} "
        f"| {1e3 * found['wide_rms_m']:.2f} | {'yes' if found['found_again'] else 'no'} |"
    )


def main(profile: str = "ideal", runs: int = 20, seconds: float = 60.0, out: Path = OUT) -> None:
    """Print a table of all runs, and how many meet the limits.

    Args:
        profile: error profile.
        runs: number of runs, with seeds from 0.
        seconds: length of each.
        out: folder for the results.
    """
    print(
        "| seed | in both narrow images | from their centres, rms px | position, rms mm: fused "
        "| one frame | by the wide images | found again |"
    )
    print("|---|---|---|---|---|---|---|")
    found = summaries(out, profile, runs, seconds)
    values = {key: np.array([float(run[key]) for run in found]) for key in found[0]}
    print(row("median", {key: float(np.median(value)) for key, value in values.items()}))
    better = values["position_rms_m"] < values["single_frame_rms_m"]
    for name, met in (
        (f"in both narrow images in {IN_BOTH:.0%} of the frames", values["in_both"] >= IN_BOTH),
        (f"at most {RMS_PX:.0f} px rms from their centres", values["rms_px"] <= RMS_PX),
        ("fused better than one frame", better),
        ("found again", values["found_again"] == 1),
    ):
        print(f"{name}: {met.sum()} of {len(met)} runs")
    gain = 1 - (values["position_rms_m"] / values["single_frame_rms_m"]) ** 2
    print(f"squared error removed by fusing: median {np.median(gain):.2%}, least {gain.min():.2%}")


if __name__ == "__main__":
    tyro.cli(main)
