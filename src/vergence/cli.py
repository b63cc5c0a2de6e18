"""The command line: parses, calls, prints."""

from __future__ import annotations

import sys
from pathlib import Path

import tyro
from rich.console import Console

from vergence.errors import VergenceError


def reproduce(
    *,
    out: Path = Path("runs/paper"),
    figures: tuple[int, ...] = (6, 7, 8, 9, 10, 11),
    profile: str = "paper",
    seed: int = 0,
    duration: float | None = None,
    rate: float | None = None,
) -> None:
    """Replay the paper's Figs. 6-11 on rendered images.

    Args:
        out: Folder for recordings, plots, report and statistics.
        figures: Which figures.
        profile: Error profile: ideal, paper, noise-only, or a TOML file.
        seed: Of everything random.
        duration: Length of each figure [s]; left out: its full combined period, at least 60 s.
        rate: Samples a second [Hz]; left out: 640 samples a figure.
    """
    # Imported here, so that help and wrong arguments do not wait for OpenGL.
    from vergence.experiments.reproduce import reproduce as run
    from vergence.twin.profile import load_profile

    chosen = load_profile(profile)
    console = Console()
    if (out / "statistics.json").exists():
        console.print(f"Replacing the results of an earlier run in {out}.")
    done = run(out, figures=figures, profile=chosen, seed=seed, duration_s=duration, rate_hz=rate)
    recordings = " ".join(f"fig{number:02d}.rrd" for number in sorted(done.replays))
    console.print(f"Wrote {recordings}, figures.png, report.md and statistics.json to {out}.")
    console.print(f"To look at one: rerun {out / recordings.split()[0]}")


COMMANDS = {"reproduce": reproduce}


def main() -> None:
    """Run the command line; a mistake of the user's ends in one sentence and exit code 2."""
    try:
        tyro.extras.subcommand_cli_from_dict(
            COMMANDS, prog="vergence", description="Active 3-D vision: a twin, and its calibration."
        )
    except VergenceError as error:
        print(f"vergence: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        print("vergence: interrupted; what was finished is in the output folder.", file=sys.stderr)
        raise SystemExit(130) from None


if __name__ == "__main__":
    main()
