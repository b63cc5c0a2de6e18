"""The paper's method beside bundle adjustment, on the same rendered datasets, against the truth.

    python benchmarks/paper_and_bundle.py --seed 3

Prints the table of docs/evidence.md: three datasets from the twin, each calibrated both ways.
Errors of cameras are root mean squares over the four; regions are those of bundle adjustment, as
the paper's method states no accuracy. Takes some five minutes.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from vergence.calibration.calibrate import Method, calibrate
from vergence.data.reader import load_dataset
from vergence.twin import truth
from vergence.twin.evaluation import evaluate
from vergence.twin.profile import load_profile
from vergence.twin.record import record

DATASETS: dict[str, tuple[str, dict[str, Any]]] = {
    "60 views, chessboard, 2.8 mm, profile `noise-only`": ("noise-only", {"frames": 60}),
    "40 views, ChArUco, 4.0 mm, profile `ideal`": (
        "ideal",
        {"frames": 40, "lens": "4.0mm", "target": "charuco"},
    ),
    "40 + 150 moving, 2.8 mm, profile `paper`": ("paper", {"frames": 40, "moving": 150}),
}


def row(folder: Path, method: Method) -> str:
    """Return the cells of one calibration."""
    head = calibrate(load_dataset(folder), method=method).head
    found = evaluate(head, truth.load(folder / truth.TRUTH))
    sizes = [[*vars(camera).values()] for camera in found.cameras.values()]
    rotation, translation, focal = np.sqrt(np.mean(np.square(sizes), axis=0))
    held_out = head.accuracy.held_out if head.accuracy else None
    names = ("transfer_px", "point_mm", "jackknife_ratio")
    px, mm, ratio = (_number(getattr(held_out, name, None)) for name in names)
    holding = sum(region.holds_truth for region in found.regions.values())
    return (
        f"{rotation:.3f} | {translation:.2f} | {focal:.3f} | {found.base_rotation_deg:.3f}, "
        f"{found.base_translation_mm:.2f} | {px} | {mm} "
        f"| {holding} of {len(found.regions)} | {ratio} |"
    )


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def main(seed: int = 3) -> None:
    """Print the table, row by row."""
    print(
        "| Dataset | Method | rotation [deg] | translation [mm] | focal [%] "
        "| T_rbase_lbase [deg, mm] | held out [px] | [mm] | regions | jackknife ratio |\n"
        + "|---" * 10
        + "|"
    )
    for name, (profile, arguments) in DATASETS.items():
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place) / "dataset"
            record(folder, profile=load_profile(profile), seed=seed, **arguments)
            for method in ("paper", "bundle"):
                print(f"| {name} | {method} | {row(folder, method)}", flush=True)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
