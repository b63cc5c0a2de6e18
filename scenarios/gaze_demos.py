"""Foveate, track and grasp on the twin (Sec. III and Fig. 12), each with a recording.

python scenarios/gaze_demos.py foveate [--profile ideal] [--trials 20]
python scenarios/gaze_demos.py track [--profile ideal] [--seconds 20]
python scenarios/gaze_demos.py grasp [--profile ideal] [--trials 3]
"""

from pathlib import Path

import tyro

from vergence.cli.terminal import plain_ending
from vergence.demos.experiment import Experiment
from vergence.demos.foveate import SETTLED_PX
from vergence.demos.foveate import foveate as run_foveate
from vergence.demos.grasp import WITHIN_M
from vergence.demos.grasp import grasp as run_grasp
from vergence.demos.track import track as run_track
from vergence.twin.profile import load_profile

OUT = Path("runs")


def foveate(
    out: Path = OUT / "foveate", profile: str = "ideal", seed: int = 0, trials: int = 20
) -> None:
    """Turn the eyes to objects that appear, until both narrow images are centred on them.

    Args:
        out: Folder for the summary as JSON, and for a recording.
        profile: Error profile: ideal, paper, noise-only, or a TOML file.
        seed: Seed of everything random.
        trials: Number of objects; the first ten are recorded.
    """
    found, _ = run_foveate(Experiment(load_profile(profile), seed, out=out), trials=trials)
    print(f"distance from the centre: median {found.median_px:.2f} px, 95 % {found.p95_px:.2f} px")
    slow = "not all" if found.settle_s_p95 is None else f"after {found.settle_s_p95:.2f} s"
    print(f"95 % within {SETTLED_PX:.0f} px: {slow}; lost: {found.lost}")


def track(
    out: Path = OUT / "track", profile: str = "paper", seed: int = 0, seconds: float = 20.0
) -> None:
    """Follow an object that moves and is hidden once, and estimate its position.

    Args:
        out: Folder for the summary as JSON, and for a recording.
        profile: Error profile: ideal, paper, noise-only, or a TOML file.
        seed: Seed of everything random.
        seconds: Length of the run [s].
    """
    found = run_track(Experiment(load_profile(profile), seed, out=out), seconds=seconds)
    print(f"in both narrow images in {found.in_both:.1%} of {found.frames} frames")
    print(f"distance from their centres: {found.rms_px:.1f} px rms")
    print(
        f"position error: {1e3 * found.position_rms_m:.2f} mm rms, "
        f"{1e3 * found.single_frame_rms_m:.2f} mm by single frames, "
        f"{1e3 * found.wide_rms_m:.2f} mm by the wide images"
    )


def grasp(
    out: Path = OUT / "grasp", profile: str = "paper", seed: int = 0, trials: int = 3
) -> None:
    """Grasp an object that a person holds out (Fig. 12).

    Args:
        out: Folder for the summary as JSON, and for a recording.
        profile: Error profile: ideal, paper, noise-only, or a TOML file.
        seed: Seed of everything random.
        trials: Number of objects.
    """
    found, _ = run_grasp(Experiment(load_profile(profile), seed, out=out), trials=trials)
    print(f"closed within {1e3 * WITHIN_M:.0f} mm of the centre: {found.within:.0%} of {trials}")
    for d in found.by_distance:
        print(
            f"{d.from_m:.2f}-{d.to_m:.2f} m: standard deviation of the depth "
            f"{d.depth_std_mm:.2f} mm, by Eq. 20 {d.eq20_mm:.2f} mm"
        )


if __name__ == "__main__":
    with plain_ending("gaze_demos"):
        tyro.extras.subcommand_cli_from_dict({"foveate": foveate, "track": track, "grasp": grasp})
