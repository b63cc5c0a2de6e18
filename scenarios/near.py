"""Figs. 6 and 7: an object at 0.43 m, 2.8 mm lenses, parallel and divergent motion.

python scenarios/near.py [--profile ideal] [--duration 20]
"""

from pathlib import Path

import tyro

from vergence.paper.reproduce import reproduce
from vergence.twin.profile import load_profile

FIGURES = (6, 7)
OUT = Path("runs/near")


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
    parallel, divergent = (done.replays[number].statistics for number in FIGURES)
    print(f"divergent / parallel depth spread: {divergent.std_m[0] / parallel.std_m[0]:.2f}")


if __name__ == "__main__":
    tyro.cli(main)
