"""One of the paper's three experiments, with parallel and with divergent eye motion.

- near: Figs. 6 and 7, an object at 0.43 m, 2.8 mm lenses
- far: Figs. 8 and 9, an object at 1.1 m, 2.8 mm lenses
- longer-lens: Figs. 10 and 11, an object at 0.64 m, 4.0 mm lenses. A longer lens gives more pixels
  of disparity, but an error in orientation becomes more pixels too (Eq. 21): on moving eyes it
  helps less than one would expect.

    python scenarios/figure_pair.py far [--profile ideal] [--duration 20]
"""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from vergence.cli.terminal import plain_ending
from vergence.paper.reproduce import ReproductionSettings, reproduce
from vergence.twin.profile import load_profile

FIGURES = {"near": (6, 7), "far": (8, 9), "longer-lens": (10, 11)}


def main(
    pair: Annotated[Literal["near", "far", "longer-lens"], tyro.conf.Positional],
    /,
    out: Path | None = None,
    profile: str = "paper",
    seed: int = 0,
    duration: float | None = None,
    rate: float | None = None,
) -> None:
    """Replay one of the paper's three experiments, with parallel and with divergent eye motion.

    Args:
        pair: near: Figs. 6 and 7, far: Figs. 8 and 9, longer-lens: Figs. 10 and 11.
        out: Folder for recordings, plots, report and statistics; default: runs/ and the pair.
        profile: Error profile: ideal, paper, noise-only, or a TOML file.
        seed: Seed of everything random.
        duration: Length of each figure [s]; default: its full combined period, at least 60 s.
        rate: Samples per second [Hz]; default: 640 samples per figure.
    """
    figures = FIGURES[pair]
    settings = ReproductionSettings(
        out or Path("runs") / pair,
        figures=figures,
        profile=load_profile(profile),
        seed=seed,
        duration_s=duration,
        rate_hz=rate,
    )
    done = reproduce(settings)
    parallel, divergent = (done.replays[number].statistics for number in figures)
    for number, found in zip(figures, (parallel, divergent), strict=True):
        x, y, z = 1e3 * found.std_m
        print(f"Fig. {number}: std {x:.0f} mm in depth, {y:.0f} and {z:.0f} mm across")
    print(f"divergent / parallel std of depth: {divergent.std_m[0] / parallel.std_m[0]:.2f}")


if __name__ == "__main__":
    with plain_ending("figure_pair"):
        tyro.cli(main, config=(tyro.conf.DisallowNone,))
