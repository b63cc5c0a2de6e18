"""Commands that run the twin, or depth images of the twin or of a dataset."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from vergence.cli.progress import progress_bars, say_if_unfinished
from vergence.commands.invocation import invocation
from vergence.errors import VergenceError
from vergence.writable import check_outputs
from vergence.writing import as_json, write_json

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from vergence.demos.experiment import Experiment
    from vergence.progress import Progress

Scene = Literal["room", "sparse", "moving"]
"""As `twin.scene.room` has it, which is imported only where OpenGL is needed."""
Geometry = Literal["joints", "seen"]
"""As `self_calibration.sequence` has it, which imports numpy."""


def reproduce(
    *,
    out: Path = Path("runs/paper"),
    figures: tuple[int, ...] = (6, 7, 8, 9, 10, 11),
    profile: str = "paper",
    scene: Scene = "room",
    seed: int = 0,
    duration: float | None = None,
    rate: float | None = None,
    method: Literal["paper", "self-calibrated"] = "paper",
    compare: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    floor: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    jobs: int = -1,
) -> None:
    """Replay the paper's Figs. 6-11 on rendered images.

    Args:
        out: Folder for recordings, plots, report and statistics.
        figures: Numbers of the figures.
        profile: Error profile: ideal, paper, noise-only, or a TOML file.
        scene: What the head looks at.
        seed: Seed of everything random.
        duration: Length of each figure [s]; default: its full combined period, at least 60 s.
        rate: Samples per second [Hz]; default: 640 samples per figure.
        method: Method whose positions are plotted: by the joint readings as in the paper, or by the
            geometry that is learned from the same images.
        compare: State the results of all methods side by side.
        floor: Compare also with self-calibration that is given the true head.
        jobs: Processes on this machine; -1: one for each core.
    """
    # Imported here, so that help and wrong arguments do not wait for OpenGL.
    from vergence.paper.reproduce import check
    from vergence.paper.reproduce import reproduce as run
    from vergence.twin.profile import load_profile

    chosen = load_profile(profile)
    check(out, figures=figures, seed=seed, duration_s=duration, rate_hz=rate, jobs=jobs)
    if (out / "statistics.json").exists():
        print(f"Replacing the results of an earlier run in {out}.")
    say_if_unfinished(out)
    with progress_bars() as progress:
        done = run(
            out,
            figures=figures,
            profile=chosen,
            scene=scene,
            seed=seed,
            duration_s=duration,
            rate_hz=rate,
            method=method,
            compare=compare,
            floor=floor,
            jobs=jobs,
            progress=progress,
        )
    recordings = [f"fig{number:02d}.rrd" for number in sorted(done.replays)]
    if older := {path.name for path in out.glob("fig??.rrd")} - set(recordings):
        print(f"Of an earlier run: {' '.join(sorted(older))}.")
    print(f"Wrote {' '.join(recordings)}, figures.png, report.md and statistics.json to {out}.")
    typed = invocation("rerun", out / recordings[0])
    made = out == Path("runs/paper") and 6 in done.replays and Path("Makefile").is_file()
    print(f"To view a recording: {typed}" + (", or make view" if made else ""))


def record(
    *,
    out: Path,
    profile: str = "ideal",
    scene: Scene = "room",
    seed: int = 0,
    frames: int = 60,
    lens: Literal["2.8mm", "4.0mm"] = "2.8mm",
    target: Literal["chessboard", "charuco"] = "chessboard",
    moving: int = 0,
    kinematics: Path | None = None,
) -> None:
    """Record a dataset on the twin, with the ground truth beside it in truth.json.

    Args:
        out: Folder, new or empty.
        profile: Error profile: ideal, paper, noise-only, or a TOML file.
        scene: What the head looks at.
        seed: Seed of everything random.
        frames: Number of frames with the eyes at rest, 12 or more.
        lens: Focal length of the wide cameras.
        target: Kind of calibration board.
        moving: Number of frames that follow, at 30 Hz, with moving eyes and the board at rest: 0,
            or 3 or more.
        kinematics: JSON file with the eyes' joints, `kinematics` and `readings` as in dataset.json;
            default: pan, then tilt.
    """
    from vergence.commands.record import record as run
    from vergence.twin.profile import load_profile

    with progress_bars() as progress:
        images = run(
            out,
            profile=load_profile(profile),
            scene=scene,
            seed=seed,
            frames=frames,
            lens=lens,
            target=target,
            moving=moving,
            kinematics=kinematics,
            progress=progress,
        )
    print(f"Wrote {images} images, dataset.json, frames.csv and truth.json to {out}.")
    print(f"To calibrate: {invocation('vergence', 'calibrate', out, '--out', 'calibration.json')}")


@dataclass(frozen=True)
class ExperimentOptions:
    """Options that foveate, track and grasp have in common."""

    seed: int = 0
    """Seed of everything random."""
    profile: str = "ideal"
    """Error profile: ideal, paper, noise-only, or a TOML file."""
    scene: Scene = "room"
    """What the head looks at."""
    geometry: Geometry = "joints"
    """Locate objects by the joint readings, or by these as corrected by what both eyes see."""
    out: Path | None = None
    """Folder for the summary as JSON and a recording; left out: the summary is only printed."""
    json: Path | None = None
    """JSON file of the summary."""


Options = Annotated[ExperimentOptions, tyro.conf.arg(name="")]
DEFAULT = ExperimentOptions()
PRINTED_DIGITS = 4
"""Significant digits of a printed summary: trials leave less. The files have all digits."""


def foveate(*, trials: int = 100, options: Options = DEFAULT) -> None:
    """Show objects, and turn both eyes until the narrow images are centred on them.

    Args:
        trials: Number of objects; the first ten are recorded.
        options: Common options.
    """
    from vergence.demos.foveate import foveate as run

    _experiment("foveate", lambda *given: run(*given, trials=trials)[0], options, "depth.png")


def track(*, seconds: float = 60.0, options: Options = DEFAULT) -> None:
    """Track a moving object, which is hidden once, with both narrow cameras.

    Args:
        seconds: Length of the run, 3 to 3600 [s].
        options: Common options.
    """
    from vergence.demos.track import track as run

    _experiment("track", lambda *given: run(*given, seconds=seconds), options)


def grasp(*, trials: int = 10, options: Options = DEFAULT) -> None:
    """Grasp objects that are held out to the robot, guided by what the eyes see of the hand.

    Args:
        trials: Number of objects.
        options: Common options.
    """
    from vergence.demos.grasp import grasp as run

    _experiment("grasp", lambda *given: run(*given, trials=trials)[0], options)


def depth(
    dataset: Annotated[Path | None, tyro.conf.Positional] = None,
    /,
    *,
    out: Path,
    twin: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    calibration: Path | None = None,
    profile: str | None = None,
    scene: Scene | None = None,
    seed: int | None = None,
    pairs: int = 20,
    geometry: Geometry = "joints",
) -> None:
    """Compute the depth of every pixel from rectified pairs, of the twin or of a dataset.

    Args:
        dataset: Folder with dataset.json, frames.csv and images; none with --twin.
        out: Folder for depth.rrd, depth.json and report.md.
        twin: Use the twin, with its eyes in divergent motion, and state the error of the depth.
        calibration: JSON file that `vergence calibrate` wrote; the twin can do without.
        profile: Error profile of the twin: ideal, paper (default), noise-only, or a TOML file.
        scene: Scene that the twin looks at; default: room.
        seed: Seed of everything random on the twin; default: 0.
        pairs: Number of pairs; from a dataset, at most this many.
        geometry: Rectify by the joint readings, or by these as corrected by what both eyes see.
    """
    if twin == (dataset is not None):
        found = "both" if twin else "neither"
        raise VergenceError(f"Depth is of a dataset or, with --twin, of the twin; found {found}.")
    for name, value in (("profile", profile), ("scene", scene), ("seed", seed)):
        if value is not None and not twin:
            raise VergenceError(f"--{name} is of the twin; found it with a dataset.")
    # The twin, and with it OpenGL, only where it is asked for.
    from vergence.commands.depth import depth as of_dataset
    from vergence.commands.depth_report import as_markdown

    say_if_unfinished(out)
    with progress_bars() as progress:
        if dataset is None:
            from vergence.demos.depth import depth as of_twin
            from vergence.twin.profile import load_profile

            done = of_twin(
                out,
                calibration=calibration,
                profile=load_profile(profile or "paper"),
                scene=scene or "room",
                seed=seed or 0,
                pairs=pairs,
                geometry=geometry,
                progress=progress,
            )
        elif calibration is None:
            raise VergenceError(
                "Depth of a dataset needs --calibration FILE, which `vergence calibrate` makes of "
                "it."
            )
        else:
            done = of_dataset(
                out,
                dataset=dataset,
                calibration=calibration,
                pairs=pairs,
                geometry=geometry,
                progress=progress,
            )
    print(as_markdown(done), end="")
    print(f"To view the recording: {invocation('rerun', out / 'depth.rrd')}")


def _experiment(
    name: str,
    run: Callable[[Experiment, Progress], DataclassInstance],
    options: ExperimentOptions,
    *figures: str,
) -> None:
    """Run an experiment, print and write its summary, and say how to view its recording.

    Its folder gets a summary and a recording of its name, and figures.
    """
    from vergence.demos.experiment import Experiment
    from vergence.twin.profile import load_profile

    profile = load_profile(options.profile)
    results = f"{name}.json", f"{name}.rrd", *figures
    read = [Path(options.profile)]
    check_outputs(options.json, folder=options.out, names=results, inputs=read)
    say_if_unfinished(options.out)
    with progress_bars() as progress:
        settings = Experiment(profile, options.seed, options.scene, options.geometry, options.out)
        found = run(settings, progress)
    if options.json is not None:
        write_json(found, options.json)
    print(as_json(found, PRINTED_DIGITS), end="")
    if options.out is not None:
        typed = invocation("rerun", options.out / f"{name}.rrd")
        print(f"To view the recording: {typed}", file=sys.stderr)
