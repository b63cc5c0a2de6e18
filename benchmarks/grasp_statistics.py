"""Statistics of `vergence grasp` over many heads, each with its own seed.

    python benchmarks/grasp_statistics.py [--profile paper] [--seeds 50] [--trials 1]

A seed takes about a minute, mostly for the calibration. Its result is kept in a file of the output
folder, so that an interrupted series continues; delete the folder to start again, as after a change
of the software.
"""

import json
import pickle
from dataclasses import asdict
from pathlib import Path

import tyro

from vergence.demos.experiment import Experiment
from vergence.demos.grasp import Trial, as_markdown, grasp, summary
from vergence.twin.profile import load_profile

OUT = Path("runs/grasp_statistics")


def trials_of(out: Path, profile: str, seed: int, trials: int) -> list[Trial]:
    """Return the trials of one head, and make them if they are missing."""
    path = out / f"{profile}-{seed}-{trials}.pickle"
    if not path.is_file():
        _, made = grasp(Experiment(load_profile(profile), seed), trials=trials)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(pickle.dumps(made))
    return pickle.loads(path.read_bytes())  # written by this script


def main(profile: str = "paper", seeds: int = 50, trials: int = 1, out: Path = OUT) -> None:
    """Print where each hand closed, and the statistics.

    Args:
        profile: error profile.
        seeds: number of heads, with seeds from 0.
        trials: number of objects for each head.
        out: folder for the results.
    """
    made: list[Trial] = []
    for seed in range(seeds):
        for trial in trials_of(out, profile, seed, trials):
            made.append(trial)
            print(
                f"{seed}: {trial.phase.value} after {trial.seconds:.2f} s, "
                f"{1e3 * trial.miss_m:.1f} mm from the centre, "
                f"{1e3 * trial.unaided_m:.0f} mm by its encoders alone",
                flush=True,
            )
    found = summary(made)
    print("\n".join(as_markdown(found)))
    (out / f"{profile}.json").write_text(json.dumps(asdict(found), indent=1) + "\n")


if __name__ == "__main__":
    tyro.cli(main)
