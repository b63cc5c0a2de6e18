"""Figs. 10 and 11: an object at 0.64 m through 4.0 mm lenses, parallel and divergent motion.

A longer lens sees more pixels of disparity, but an error in orientation becomes more pixels too
(Eq. 21): on moving eyes it helps less than one would expect.

    python scenarios/longer_lens.py [--profile ideal] [--duration 20]
"""

from pathlib import Path

import tyro

from vergence.paper.reproduce import reproduce
from vergence.twin.profile import load_profile

FIGURES = (10, 11)
OUT = Path("runs/longer_lens")


def main(
    out: Path = OUT,
    profile: str = "paper",
    seed: int = 0,
    duration: float | None = None,
    rate: float | None = None,
) -> None:
    done = reproduce(
        out,
        figures=FIGURES,
        profile=load_profile(profile),
        seed=seed,
        duration_s=duration,
        rate_hz=rate,
    )
    for number in FIGURES:
        x, y, z = 1e3 * done.replays[number].statistics.std_m
        print(f"Fig. {number}: std {x:.0f} mm in depth, {y:.0f} and {z:.0f} mm across")


if __name__ == "__main__":
    tyro.cli(main)
