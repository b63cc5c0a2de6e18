"""Commands that run the twin, and dense depth of the twin or of a dataset."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack, closing, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import vergence as vg
from vergence.cli.options import (
    EXPERIMENT,
    IDEAL,
    NO_BAG,
    NO_VIEWER,
    PAPER,
    BagArguments,
    ExperimentArguments,
    ExperimentOptions,
    Flag,
    Geometry,
    Optional,
    Positional,
    TwinArguments,
    ViewerArguments,
    check_outputs,
)
from vergence.cli.report import Report
from vergence.cli.terminal import invocation, progress_bars, viewing
from vergence.errors import VergenceError
from vergence.files import as_json, results_folder

if TYPE_CHECKING:
    from vergence.demos.experiment import Experiment
    from vergence.progress import Progress


def reproduce(
    *,
    out: Path = Path("runs/paper"),
    figures: tuple[int, ...] = (6, 7, 8, 9, 10, 11),
    options: TwinArguments = PAPER,
    duration: Optional[float] = None,
    rate: Optional[float] = None,
    method: Literal["paper", "self-calibrated"] = "paper",
    compare: Flag = False,
    floor: Flag = False,
    jobs: int = -1,
) -> Report:
    """Replay the paper's Figs. 6-11 on rendered images.

    Args:
        out: Folder for recordings, plots, report and statistics.
        figures: Numbers of the figures.
        options: Options of the twin.
        duration: Length of each figure [s]; default: its full combined period, at least 60 s.
        rate: Samples per second [Hz]; default: 640 samples per figure.
        method: Method whose positions are plotted: by the joint readings as in the paper, or by the
            geometry that is learned from the same images.
        compare: State the results of all methods side by side.
        floor: Compare also with self-calibration that is given the true head.
        jobs: Processes on this machine; -1: one for each core.
    """
    from vergence.paper.reproduce import RESULTS, ReproductionSettings
    from vergence.paper.reproduce import reproduce as replay_figures
    from vergence.parallel import process_count
    from vergence.twin.profile import load_profile

    if options.head is not None:
        raise VergenceError("The paper's figures are of the paper's head; leave out --head.")
    settings = ReproductionSettings(
        out,
        figures,
        load_profile(options.profile),
        seed=options.seed,
        scene=options.scene,
        duration_s=duration,
        rate_hz=rate,
        method=method,
        compare=compare,
        floor=floor,
    )
    process_count(jobs)
    check_outputs(folder=out, names=RESULTS)
    with progress_bars(out) as progress:
        done = replay_figures(settings, jobs=jobs, progress=progress)
    recordings = [f"fig{number:02d}.rrd" for number in sorted(done.replays)]
    files = (
        f"Wrote {' '.join(recordings)}, figures.png, report.md and statistics.json to {out}.\n"
        f"To view a recording: {invocation('rerun', out / recordings[0])}"
    )
    return Report("Figures", (), None, files=files)


def record(
    *,
    out: Path,
    options: TwinArguments = IDEAL,
    frames: int = 60,
    lens: Optional[str] = None,
    target: Literal["chessboard", "charuco"] = "chessboard",
    moving: int = 0,
    bag: BagArguments = NO_BAG,
) -> Report:
    """Record a dataset on the twin, with its ground truth in truth.json.

    Args:
        out: Folder, new or empty.
        options: Options of the twin.
        frames: Number of frames with the eyes at rest, 12 or more.
        lens: Lens of a head that has several to choose from, such as 4.0mm; default: the first.
        target: Kind of calibration board.
        moving: Number of frames that follow, at 30 Hz, with moving eyes and the board at rest: 0,
            or 3 or more.
        bag: Options of a bag.
    """
    from vergence.twin.bag import BagSettings
    from vergence.twin.head_model import load_head_model
    from vergence.twin.profile import load_profile
    from vergence.twin.record import record as record_dataset

    settings = None
    if bag.bag is not None:
        settings = BagSettings(bag.bag, bag.joint_rate, bag.missing, bag.camera_info)
    with progress_bars() as progress:
        images = record_dataset(
            out,
            profile=load_profile(options.profile),
            scene=options.scene,
            seed=options.seed,
            frames=frames,
            head=load_head_model(options.head, lens),
            target=target,
            moving=moving,
            bag=settings,
            progress=progress,
        )
    typed = invocation("vergence", "calibrate", out, "--out", "calibration.json")
    also = "" if settings is None else ", a bag"
    files = (
        f"Wrote {images} images, dataset.json, frames.csv{also} and truth.json to {out}.\n"
        f"To calibrate: {typed}"
    )
    return Report("Dataset", (), None, files=files)


def foveate(
    *,
    trials: int = 100,
    driver: Optional[str] = None,
    calibration: Optional[Path] = None,
    seconds: float = 10.0,
    options: ExperimentArguments = EXPERIMENT,
) -> Report:
    """Show objects, and turn both eyes until the narrow images are centred on them.

    Args:
        trials: Number of objects; the first ten are recorded.
        driver: Driver of a head that looks at a red sphere in place of the twin: module:Name or
            file.py:Name.
        calibration: JSON file that `vergence calibrate` wrote of a recording of the driver.
        seconds: Length of the run of a driver, 1 to 3600 [s].
        options: Common options.
    """
    if driver is not None:
        common = replace(options, geometry="joints", out=None, json=None, live=False, serve=None)
        if common != EXPERIMENT or trials != 100:
            raise VergenceError("With --driver leave out --trials, and the options of the twin.")
        return _fixate(driver, calibration, seconds, options)
    if calibration is not None or seconds != 10.0:
        raise VergenceError("--calibration and --seconds are options of a run with --driver.")
    from vergence.demos.foveate import foveate as run

    return _experiment("foveate", lambda *of: run(*of, trials=trials)[0], options, "depth.png")


def _fixate(
    name: str, calibration: Path | None, seconds: float, options: ExperimentOptions
) -> Report:
    """Let the head of a driver fixate an object, and write the summary."""
    from vergence.live.driver import open_driver
    from vergence.live.fixate import fixate
    from vergence.viewer.gaze import watch_gaze
    from vergence.viewer.layouts import gaze_blueprint
    from vergence.viewer.live import open_feed

    if calibration is None or not 1 <= seconds <= 3600:
        raise VergenceError("A driver needs --calibration FILE, and --seconds from 1 to 3600.")
    out, results = options.out, ("foveate.json", "foveate.rrd")
    check_outputs(options.json, folder=out, names=results, inputs=[calibration])
    summary, recording = (out and out / result for result in results)
    head = vg.load_head(calibration)
    layout = gaze_blueprint("foveate", head, reach_m=1.5, speed=1.0, hand=False)
    with (
        viewing(options) as (viewer, shown),
        closing(open_driver(name)) as driver,
        open_feed("foveate", layout, head, file=recording, viewer=viewer) as feed,
        progress_bars(out) as progress,
    ):
        found = fixate(
            driver,
            head,
            partial(watch_gaze, feed),
            seconds=seconds,
            geometry=options.geometry,
            progress=progress,
        )
    report = _reported("foveate", found, options, shown)
    report.write_json(summary)
    return report


def track(*, seconds: float = 60.0, options: ExperimentArguments = EXPERIMENT) -> Report:
    """Track a moving object, which is hidden once, with both narrow cameras.

    Args:
        seconds: Length of the run, 3 to 3600 [s].
        options: Common options.
    """
    from vergence.demos.track import track as run

    return _experiment("track", lambda *of: run(*of, seconds=seconds), options)


def grasp(*, trials: int = 10, options: ExperimentArguments = EXPERIMENT) -> Report:
    """Grasp objects that are held out to the robot, guided by what the eyes see of the hand.

    Args:
        trials: Number of objects.
        options: Common options.
    """
    from vergence.demos.grasp import grasp as run

    return _experiment("grasp", lambda *of: run(*of, trials=trials)[0], options)


def depth(
    dataset: Positional[Optional[Path]] = None,
    /,
    *,
    out: Path,
    twin: Flag = False,
    calibration: Optional[Path] = None,
    options: TwinArguments = PAPER,
    pairs: int = 20,
    geometry: Geometry = "joints",
    viewer: ViewerArguments = NO_VIEWER,
) -> Report:
    """Compute the depth of every pixel from rectified pairs, of the twin or of a dataset.

    Args:
        dataset: Folder with dataset.json, frames.csv and images; none with --twin.
        out: Folder for depth.rrd, depth.json and report.md.
        twin: Use the twin, with its eyes in divergent motion, and state the error of the depth.
        calibration: JSON file that `vergence calibrate` wrote; the twin can do without.
        options: Options of the twin.
        pairs: Number of pairs; from a dataset, at most this many.
        geometry: Rectify by the joint readings, or by these as corrected by what both eyes see.
        viewer: Options of the viewer.
    """
    if twin == (dataset is not None):
        found = "both" if twin else "neither"
        raise VergenceError(f"Depth is of a dataset or, with --twin, of the twin; found {found}.")
    if options != PAPER and not twin:
        raise VergenceError("Options of the twin are given, and a dataset; choose one of the two.")
    if dataset is not None and calibration is None:
        raise VergenceError(
            "Depth of a dataset needs --calibration FILE, which `vergence calibrate` makes of it."
        )
    if not 1 <= pairs <= 1000:
        raise VergenceError(f"Asked for {pairs} pairs; from 1 to 1000 can be made.")
    from vergence.cli.depth_report import RESULTS, write_depth

    check_outputs(folder=out, names=RESULTS, inputs=[calibration])
    head = vg.load_head(calibration) if calibration else None
    with (
        viewing(viewer) as (opened, shown),
        progress_bars(out) as progress,
        results_folder(out),
    ):
        if dataset is not None and head is not None:
            from vergence.self_calibration.dense_pairs import dataset_depth

            source = nullcontext(dataset_depth(vg.load_dataset(dataset), head, pairs, geometry))
        else:
            from vergence.demos.depth import twin_depth
            from vergence.demos.experiment import Experiment
            from vergence.twin.profile import load_profile

            profile = load_profile(options.profile)
            twin_settings = Experiment(
                profile, options.seed, options.scene, geometry, head=options.head
            )
            source = twin_depth(head, twin_settings, pairs, progress)
        with source as sequence:
            report = write_depth(out, sequence, progress, opened)
    files = f"To view the recording: {invocation('rerun', out / 'depth.rrd')}"
    return replace(report, files=files, shown=shown)


def _experiment(
    name: str,
    run: Callable[[Experiment, Progress], Any],
    options: ExperimentOptions,
    *figures: str,
) -> Report:
    """Run an experiment, and write its summary, recording and figures into its folder."""
    from vergence.demos.experiment import Experiment
    from vergence.twin.profile import load_profile

    profile = load_profile(options.profile)
    results = f"{name}.json", f"{name}.rrd", *figures
    check_outputs(
        options.json, folder=options.out, names=results, inputs=[options.profile, options.head]
    )
    settings = Experiment(
        profile, options.seed, options.scene, options.geometry, options.out, options.head
    )
    with viewing(options) as (viewer, shown), progress_bars(options.out) as progress:
        found = run(replace(settings, viewer=viewer), progress)
    return _reported(name, found, options, shown)


def _reported(name: str, found: Any, options: ExperimentOptions, shown: ExitStack) -> Report:
    """Report a summary, write it to the file that was asked for, and name the recording."""
    report = Report(name, (as_json(found, digits=4).rstrip(),), found, shown=shown)
    report.write_json(options.json)
    if options.out is not None:
        typed = invocation("rerun", options.out / f"{name}.rrd")
        print(f"To view the recording: {typed}", file=sys.stderr)  # the output is JSON
    return report
