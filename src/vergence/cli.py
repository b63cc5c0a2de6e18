"""The command line: parses, calls, prints."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console
from rich.progress import Progress, TaskID

from vergence.errors import VergenceError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from vergence.data.dataset import Frame
    from vergence.gaze.state import GazeState


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
    from vergence.paper.reproduce import reproduce as run
    from vergence.twin.profile import load_profile

    chosen = load_profile(profile)
    console = Console()
    if (out / "statistics.json").exists():
        console.print(f"Replacing the results of an earlier run in {out}.")
    done = run(out, figures=figures, profile=chosen, seed=seed, duration_s=duration, rate_hz=rate)
    recordings = " ".join(f"fig{number:02d}.rrd" for number in sorted(done.replays))
    console.print(f"Wrote {recordings}, figures.png, report.md and statistics.json to {out}.")
    console.print(f"To look at one: rerun {out / recordings.split()[0]}")


def record(
    *,
    out: Path,
    profile: str = "ideal",
    seed: int = 0,
    frames: int = 60,
    lens: Literal["2.8mm", "4.0mm"] = "2.8mm",
    target: Literal["chessboard", "charuco"] = "chessboard",
    moving: int = 0,
) -> None:
    """Record a dataset on the twin, with the truth beside it in truth.json.

    Args:
        out: Folder, new or empty.
        profile: Error profile: ideal, paper, noise-only, or a TOML file.
        seed: Of everything random.
        frames: Frames in which the eyes stand still.
        lens: Of the wide cameras.
        target: Board that is shown to the head.
        moving: Frames at 30 Hz that follow, in which the eyes move before the board.
    """
    from vergence.commands.record import record as run
    from vergence.twin.profile import load_profile

    chosen = load_profile(profile)
    images = run(
        out, profile=chosen, seed=seed, frames=frames, lens=lens, target=target, moving=moving
    )
    print(f"Wrote {images} images, dataset.json, frames.csv and truth.json to {out}.")
    print(f"To calibrate: vergence calibrate {out} --out calibration.json")


def calibrate(
    dataset: Annotated[Path, tyro.conf.Positional],
    /,
    *,
    out: Path,
    report: Path | None = None,
    method: Literal["refined", "paper"] = "refined",
    json: Path | None = None,
) -> None:
    """Calibrate a head from a dataset, and say how well.

    Args:
        dataset: Folder with dataset.json, frames.csv and images.
        out: JSON file of the calibration.
        report: Folder for report.md, its pictures and a recording of the dataset.
        method: The paper's steps, or one estimate of everything that starts from them.
        json: File for the accuracy alone, in figures.
    """
    # Its matrices are small: threads of linear algebra would wait for each other. Before numpy.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from vergence.calibration.calibrate import solve
    from vergence.commands.calibration_report import summary, write_json, write_report
    from vergence.geometry.head import save

    with Progress(console=Console(stderr=True)) as progress:
        solved = solve(dataset, method=method, progress=progress)
        save(solved.head, out)
        if json is not None:
            write_json(solved, json)
        if report is not None:
            task = progress.add_task("writing the report", total=len(solved.dataset))
            write_report(solved, report, done=lambda: progress.advance(task))
    print("\n".join([*summary(solved), f"Wrote {out}."]))


def evaluate(
    calibration: Annotated[Path, tyro.conf.Positional],
    /,
    *,
    truth: Path,
    json: Path | None = None,
) -> None:
    """Hold a calibration against the truth of a dataset from the twin.

    Args:
        calibration: JSON file that `vergence calibrate` wrote.
        truth: truth.json of the dataset.
        json: File for all errors.
    """
    from vergence.commands import evaluate as evaluation
    from vergence.commands import truth as truth_file
    from vergence.geometry.head import load

    found = evaluation.evaluate(load(calibration), truth_file.load(truth))
    if json is not None:
        evaluation.save(found, json)
    print(evaluation.as_text(found))


def export(
    calibration: Annotated[Path, tyro.conf.Positional],
    /,
    *,
    format: Literal["kalibr", "ros", "opencv", "urdf"],
    out: Path,
) -> None:
    """Write a calibration in another program's format.

    Args:
        calibration: JSON file that `vergence calibrate` wrote.
        format: ros writes a folder, the others a file.
        out: What to write.
    """
    from vergence.geometry.head import load
    from vergence.interchange.formats import export_head

    export_head(load(calibration), out, format)
    print(f"Wrote {out}.")


def import_(
    path: Annotated[Path, tyro.conf.Positional],
    /,
    *,
    format: Literal["kalibr", "ros", "opencv"],
    out: Path,
    start: Path | None = None,
) -> None:
    """Make a calibration from another program's files.

    Args:
        path: File, or for ros a folder of them.
        format: opencv holds all of a head; kalibr cameras and their poses, ros cameras alone.
        out: JSON file of the calibration.
        start: Calibration that says what kalibr and ros files do not.
    """
    from vergence.geometry.head import load, save
    from vergence.interchange.formats import import_head

    save(import_head(path, format, template=None if start is None else load(start)), out)
    print(f"Wrote {out}.")


def foveate(
    *,
    trials: int = 100,
    seed: int = 0,
    profile: str = "ideal",
    out: Path | None = None,
    json: Path | None = None,
) -> None:
    """Let objects appear, and turn both eyes until the narrow images are centred on them.

    Args:
        trials: How many objects.
        seed: Of everything random.
        profile: Error profile: ideal, paper, noise-only, or a TOML file.
        out: Folder for foveate.json, the recording foveate.rrd of the first ten, and depth.png.
        json: File for the summary.
    """
    from vergence.demos.foveate import foveate as run
    from vergence.twin.profile import load_profile

    chosen = load_profile(profile)
    with _progress("foveating", trials) as (progress, task):
        found, _ = run(
            trials=trials, seed=seed, profile=chosen, out=out, done=lambda: progress.advance(task)
        )
    _summarise(found, json, out, "foveate.rrd")


def track(
    *,
    seconds: float = 60.0,
    seed: int = 0,
    profile: str = "ideal",
    out: Path | None = None,
    json: Path | None = None,
) -> None:
    """Follow a moving object with both narrow cameras; it is hidden once on its way.

    Args:
        seconds: Length of the run [s].
        seed: Of everything random.
        profile: Error profile: ideal, paper, noise-only, or a TOML file.
        out: Folder for track.json and the recording track.rrd.
        json: File for the summary.
    """
    from vergence.demos.track import track as run
    from vergence.twin.profile import load_profile

    chosen = load_profile(profile)
    with _progress("seconds followed", seconds) as (progress, task):

        def watch(state: GazeState, frame: Frame | None) -> None:
            progress.update(task, completed=max(0.0, state.frame_s))

        found = run(seconds=seconds, seed=seed, profile=chosen, out=out, watch=watch)
    _summarise(found, json, out, "track.rrd")


def grasp(
    *,
    trials: int = 10,
    seed: int = 0,
    profile: str = "ideal",
    out: Path | None = None,
    json: Path | None = None,
) -> None:
    """Take objects that are held out, with a hand that goes by what the eyes see of it.

    Args:
        trials: How many objects.
        seed: Of everything random.
        profile: Error profile: ideal, paper, noise-only, or a TOML file.
        out: Folder for grasp.json and grasp.rrd.
        json: File for the summary.
    """
    from vergence.demos.grasp import grasp as run
    from vergence.twin.profile import load_profile

    chosen = load_profile(profile)
    with _progress("grasping", trials) as (progress, task):
        found, _ = run(
            trials=trials, seed=seed, profile=chosen, out=out, done=lambda: progress.advance(task)
        )
    _summarise(found, json, out, "grasp.rrd")


@contextmanager
def _progress(what: str, total: float) -> Iterator[tuple[Progress, TaskID]]:
    """Show on the terminal how much of the total is done; before that the head is calibrated."""
    with Progress(console=Console(stderr=True)) as progress:
        yield progress, progress.add_task(what, total=total)


def _summarise(
    summary: DataclassInstance, path: Path | None, out: Path | None, recording: str
) -> None:
    """Print a summary, write it where a file is named, and say what there is to look at."""
    from dataclasses import asdict

    from vergence.files import write_whole

    text = dumps(asdict(summary), indent=1)
    if path is not None:
        write_whole(path, text + "\n")
    print(text)
    if out is not None:
        print(f"To look at it: rerun {out / recording}", file=sys.stderr)


COMMANDS = {
    "reproduce": reproduce,
    "record": record,
    "calibrate": calibrate,
    "evaluate": evaluate,
    "export": export,
    "import": import_,
    "foveate": foveate,
    "track": track,
    "grasp": grasp,
}


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
