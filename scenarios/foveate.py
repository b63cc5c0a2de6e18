"""Objects appear; the eyes turn until they are in the middle of both narrow images (Sec. III).

python scenarios/foveate.py [--profile ideal] [--trials 20]
"""

from pathlib import Path

import tyro

from vergence.demos.foveate import SETTLED_PX, foveate
from vergence.twin.profile import load_profile

OUT = Path("runs/foveate")


def main(out: Path = OUT, profile: str = "ideal", seed: int = 0, trials: int = 20) -> None:
    found, _ = foveate(trials=trials, seed=seed, profile=load_profile(profile), out=out)
    print(f"distance from the centre: median {found.median_px:.2f} px, 95 % {found.p95_px:.2f} px")
    print(f"95 % within {SETTLED_PX:.0f} px after {found.settle_s_p95} s; lost: {found.lost}")


if __name__ == "__main__":
    tyro.cli(main)
