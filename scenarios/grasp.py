"""Somebody holds out an object; the eyes stay on it, and the hand takes it (Fig. 12).

python scenarios/grasp.py [--profile ideal] [--trials 3]
"""

from pathlib import Path

import tyro

from vergence.demos.grasp import WITHIN_M, grasp
from vergence.twin.profile import load_profile

OUT = Path("runs/grasp")


def main(out: Path = OUT, profile: str = "paper", seed: int = 0, trials: int = 3) -> None:
    found, _ = grasp(trials=trials, seed=seed, profile=load_profile(profile), out=out)
    print(f"closed within {1e3 * WITHIN_M:.0f} mm of the centre: {found.within:.0%} of {trials}")
    for d in found.by_distance:
        print(
            f"{d.from_m:.2f}-{d.to_m:.2f} m: depth scatters by {d.depth_scatter_mm:.2f} mm, "
            f"by Eq. 20 {d.eq20_mm:.2f} mm"
        )
    print(f"To look at the first trials: rerun {out / 'grasp.rrd'}")


if __name__ == "__main__":
    tyro.cli(main)
