"""Is the stated accuracy true on images? Datasets are rendered, calibrated, and held against truth.

    python benchmarks/rendered_datasets.py --datasets 20 --out runs/rendered.jsonl

Each dataset has a seed of its own and takes lens, target and profile in turn. Prints for every
group of parameters in how many datasets the 95 % region holds the truth, and the median errors.
A dataset takes about half a minute; one that is in the file already is not made again.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections import defaultdict
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track

from vergence.calibration.calibrate import calibrate
from vergence.data.reader import load_dataset
from vergence.twin.evaluation import TRUTH, evaluate, load_truth
from vergence.twin.profile import load_profile
from vergence.twin.record import record

LENSES = ("2.8mm", "4.0mm")
TARGETS = ("chessboard", "charuco")
PROFILES = ("ideal", "noise-only", "paper")
BAR = 0.90


@dataclass(frozen=True)
class Config:
    """How many, and where the results go."""

    datasets: int = 20
    first_seed: int = 100
    frames: int = 60
    out: Path = Path("runs/rendered.jsonl")


def one(seed: int, frames: int) -> dict[str, Any]:
    """Record, calibrate and evaluate one dataset."""
    kind: dict[str, Any] = {"lens": LENSES[seed % 2], "target": TARGETS[seed // 2 % 2]}
    profile = PROFILES[seed % 3]
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "dataset"
        record(place, profile=load_profile(profile), seed=seed, frames=frames, **kind)
        found = calibrate(load_dataset(place))
        compared = evaluate(found.head, load_truth(place / TRUTH))
    about = {"seed": seed, "profile": profile, "warnings": [str(each) for each in found.findings]}
    return about | kind | asdict(compared)


def main(config: Config) -> int:
    """Make what is missing, print the table, and return 1 if the bar is missed."""
    config.out.parent.mkdir(parents=True, exist_ok=True)
    lines = config.out.read_text().splitlines() if config.out.exists() else []
    done = {row["seed"]: row for row in map(json.loads, lines)}
    wanted = range(config.first_seed, config.first_seed + config.datasets)
    missing = [seed for seed in wanted if seed not in done]
    for seed in track(missing, "datasets", console=Console(stderr=True)):
        done[seed] = one(seed, config.frames)
        with config.out.open("a") as file:
            file.write(json.dumps(done[seed]) + "\n")
    rows = [done[seed] for seed in wanted]
    held: dict[str, list[bool]] = defaultdict(list)
    for row in rows:
        for group, region in row["regions"].items():
            held[group].append(region["holds_truth"])
    print("| group | datasets | 95 % regions that hold the truth |\n|---|---|---|")
    for group, holds in held.items():
        print(f"| {group} | {len(holds)} | {100 * np.mean(holds):.0f} % |")
    everything = np.concatenate(list(held.values()))
    print(f"| all | {len(everything)} | {100 * everything.mean():.1f} % |")
    for kind in ("wide", "narrow"):
        errors = [
            list(row["cameras"][f"{eye}_{kind}"].values())
            for row in rows
            for eye in ("left", "right")
        ]
        deg, mm, percent = np.median(errors, axis=0)
        print(f"{kind}: median errors {deg:.4f} deg, {mm:.3f} mm, focal length {percent:.4f} %")
    return int(everything.mean() < BAR)


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Config, description=__doc__)))
