"""The command line: parses, calls, prints."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from inspect import Parameter, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bars
from rich.table import Table

from vergence import __version__
from vergence.commands.invocation import invocation
from vergence.errors import VergenceError
from vergence.progress import Progress
from vergence.writing import as_json, check_outputs, finished_files, unfinished, write_json

Scene = Literal["room", "sparse", "moving"]
"""As `twin.scene` has it, which cannot be imported before it is known that OpenGL is needed."""

Geometry = Literal["joints", "seen"]
"""As `self_calibration.sequence` has it, which imports numpy."""

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


FILES_NAMED = 10
"""Of those that a stopped command has finished."""


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
        method: Whose positions are plotted: by the joint readings as in the paper, or by the
            geometry that is learned from the same images.
        compare: State the results of all methods side by side.
        floor: Also those of self-calibration that is given the true head, to compare with.
    """
    # Imported here, so that help and wrong arguments do not wait for OpenGL.
    from vergence.paper.reproduce import check
    from vergence.paper.reproduce import reproduce as run
    from vergence.twin.profile import load_profile

    chosen = load_profile(profile)
    check(out, figures=figures, seed=seed, duration_s=duration, rate_hz=rate)
    if (out / "statistics.json").exists():
        print(f"Replacing the results of an earlier run in {out}.")
    _say_if_unfinished(out)
    with _progress() as progress:
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
) -> None:
    """Record a dataset on the twin, with the ground truth beside it in truth.json.

    Args:
        out: Folder, new or empty.
        profile: Error profile: ideal, paper, noise-only, or a TOML file.
        scene: What the head looks at.
        seed: Seed of everything random.
        frames: Number of frames with the eyes at rest.
        lens: Focal length of the wide cameras.
        target: Kind of calibration board.
        moving: Number of frames that follow, at 30 Hz, with moving eyes and the board at rest.
    """
    from vergence.commands.record import record as run
    from vergence.twin.profile import load_profile

    with _progress() as progress:
        images = run(
            out,
            profile=load_profile(profile),
            scene=scene,
            seed=seed,
            frames=frames,
            lens=lens,
            target=target,
            moving=moving,
            progress=progress,
        )
    print(f"Wrote {images} images, dataset.json, frames.csv and truth.json to {out}.")
    print(f"To calibrate: {invocation('vergence', 'calibrate', out, '--out', 'calibration.json')}")


def calibrate(
    dataset: Annotated[Path, tyro.conf.Positional],
    /,
    *,
    out: Path,
    report: Path | None = None,
    method: Literal["bundle", "paper"] = "bundle",
    lens: Literal[
        "auto",
        "none",
        "k1",
        "k1k2",
        "radial-tangential",
        "radial-tangential-k3",
        "rational",
        "fisheye",
    ] = "auto",
    json: Path | None = None,
) -> None:
    """Calibrate a head from a dataset, and state the accuracy.

    Args:
        dataset: Folder with dataset.json, frames.csv and images.
        out: JSON file of the calibration.
        report: Folder for report.md, its pictures and a recording of the dataset.
        method: Bundle adjustment, which starts from the paper's steps, or these steps alone.
        lens: Lens model of all cameras; auto: for each the one that predicts held-out images best
            (for the paper's method radial-tangential, and none for narrow cameras).
        json: JSON file of the accuracy alone.
    """
    # The matrices are small: threads of linear algebra would wait for each other. Before numpy.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from vergence.calibration.calibrate import calibrate as run
    from vergence.commands.calibration_report import figures, write_report
    from vergence.data.dataset import DESCRIPTION, FRAMES
    from vergence.data.reader import load_dataset
    from vergence.geometry.head import save_head

    check_outputs(out, json, folder=report, inputs=[dataset / DESCRIPTION, dataset / FRAMES])
    data = load_dataset(dataset)
    _say_if_unfinished(report)
    with _progress() as progress:
        result = run(data, method=method, lens=lens, progress=progress)
        save_head(result.head, out)
        if json is not None:
            write_json(figures(result), json)
        if report is not None:
            write_report(result, data, report, progress=progress)
    print(f"{result.summary()}\nWrote {out}.")
    if report is not None:
        print(f"To view the images: {invocation('rerun', report / 'dataset.rrd')}")


def self_calibrate(
    dataset: Annotated[Path, tyro.conf.Positional],
    /,
    *,
    calibration: Path,
    out: Path,
    json: Path | None = None,
) -> None:
    """Correct a calibration by what both eyes see of the scene, without a board.

    Args:
        dataset: Folder with dataset.json, frames.csv and images; its moving part is used.
        calibration: JSON file that `vergence calibrate` wrote, of the same head.
        out: JSON file of the learned calibration.
        json: JSON file of what was observed of each parameter.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices, as in calibrate
    from vergence.commands.self_calibration import HEADING, as_plain, said, table
    from vergence.data.dataset import DESCRIPTION, FRAMES
    from vergence.data.reader import load_dataset
    from vergence.geometry.head import load_head, save_head
    from vergence.self_calibration.recorded import self_calibrate_dataset

    read = [dataset / DESCRIPTION, dataset / FRAMES, calibration]
    check_outputs(out, json, inputs=read)
    head, data = load_head(calibration), load_dataset(dataset)
    with _progress() as progress:
        found = self_calibrate_dataset(data, head, progress=progress)
    save_head(found.head, out)
    if json is not None:
        write_json(as_plain(found), json)
    rows = table(found)
    if rows:
        shown = Table(title="What was observed since the calibration")
        for name in HEADING:
            shown.add_column(name, justify="left" if name == HEADING[0] else "right")
        for row in rows:
            shown.add_row(*row)
        Console().print(shown)
    print("\n".join(said(found)))
    print(f"Wrote {out}.")


def plan(
    source: Annotated[Path, tyro.conf.Positional],
    /,
    *,
    views: int = 10,
    board: tuple[int, int, float] | None = None,
    limits_deg: tuple[float, ...] = (20.0,),
    distances: tuple[float, ...] = (0.3, 0.6, 1.0),
    seed: int = 0,
    figure: Path | None = None,
    json: Path | None = None,
) -> None:
    """Say which views of the board to record next, and what accuracy they will bring.

    Args:
        source: JSON file of a calibration, or folder of a dataset, which is calibrated first.
        views: Number of views to plan.
        board: Inner corners in a row and in a column, and side of a square [m]; default: the
            dataset's.
        limits_deg: Largest readings of the joints, to either side: one for all, or one for each
            (usually left pan, left tilt, right pan, right tilt).
        distances: Distances of the points that are to be accurate, from the middle of the head [m].
        seed: Seed of the candidates, which are random.
        figure: PNG file of the board's places and of the accuracy after each view.
        json: JSON file of the plan.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices, as in calibrate
    from vergence.commands.plan import as_text, figures, run
    from vergence.viewer.plots_plan import draw_plan

    check_outputs(figure, json, inputs=[source])
    with _progress() as progress:
        found = run(
            source,
            board=board,
            views=views,
            limits_deg=limits_deg,
            distances_m=distances,
            seed=seed,
            progress=progress,
        )
    print(as_text(found))
    if json is not None:
        write_json(figures(found), json)
    if figure is not None:
        draw_plan(figure, found)


def design(
    settings: Annotated[Path | None, tyro.conf.Positional] = None,
    /,
    *,
    out: Path = Path("runs/design"),
    accuracy_mm: float = 5.0,
    at_m: float = 0.5,
    baseline_mm: tuple[float, ...] | None = None,
    focal_px: tuple[float, ...] | None = None,
    square_mm: tuple[float, ...] | None = None,
    views: tuple[float, ...] | None = None,
    counts_per_turn: tuple[float, ...] | None = None,
    joint_noise_deg: tuple[float, ...] | None = None,
    pixel_noise_px: tuple[float, ...] | None = None,
    delay_ms: tuple[float, ...] | None = None,
    jobs: int = -1,
    cluster: str | None = None,
) -> None:
    """Compare designs of a head, and find the cheapest that is as accurate as wanted.

    Args:
        settings: TOML or JSON file of what is swept, of the workspace and of prices; default:
            those of docs/design_and_plan.md. The options below take the place of its values.
        out: Folder of the results; a run that was stopped goes on from what is there.
        accuracy_mm: Accuracy that is wanted: rms error, in the worst direction and posture.
        at_m: Distance of the points for which it is wanted.
        baseline_mm: Distances of the eyes to try.
        focal_px: Focal lengths to try.
        square_mm: Sides of a square of the calibration board to try.
        views: Numbers of calibration views to try.
        counts_per_turn: Resolutions of the encoders to try; 0: no steps.
        joint_noise_deg: Levels of noise of the joint readings to try.
        pixel_noise_px: Levels of noise of a point in an image to try.
        delay_ms: Unknown delays of joint readings to try.
        jobs: Processes on this machine; -1: one for each core.
        cluster: Address of a Dask scheduler, which then does the work: tcp://HOST:PORT.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one process a core
    from vergence.commands.design import chosen_settings, run, said

    given = {
        "baseline_mm": baseline_mm,
        "focal_px": focal_px,
        "square_mm": square_mm,
        "views": views,
        "counts_per_turn": counts_per_turn,
        "joint_noise_deg": joint_noise_deg,
        "pixel_noise_px": pixel_noise_px,
        "delay_ms": delay_ms,
    }
    check_outputs(folder=out, inputs=[settings] if settings else [])
    swept = chosen_settings(settings, given, accuracy_mm=accuracy_mm, at_m=at_m, jobs=jobs)
    with _progress() as progress:
        found = run(
            swept,
            out,
            accuracy_m=1e-3 * accuracy_mm,
            distance_m=at_m,
            jobs=jobs,
            cluster=cluster,
            progress=progress,
        )
    print("\n".join(said(found)))
    print(f"Wrote report.md, design.json, sweep.npz and two pictures to {out}.")


def evaluate(
    calibration: Annotated[Path, tyro.conf.Positional], /, *, truth: Path, json: Path | None = None
) -> None:
    """Compare a calibration with the ground truth of a dataset from the twin.

    Args:
        calibration: JSON file that `vergence calibrate` wrote.
        truth: truth.json of the dataset.
        json: JSON file of all errors.
    """
    from vergence.commands.evaluate import as_text
    from vergence.commands.evaluate import evaluate as run
    from vergence.commands.truth import load
    from vergence.geometry.head import load_head

    check_outputs(json, inputs=[calibration, truth])
    found = run(load_head(calibration), load(truth))
    if json is not None:
        write_json(found, json)
    print(as_text(found))


def budget(
    *,
    calibration: Path | None = None,
    profile: str | None = None,
    at: Annotated[tuple[tuple[float, float, float], ...], tyro.conf.UseAppendAction] = (),
    motion: str = "divergent",
    noise: float | None = None,
    json: Path | None = None,
    figure: Path | None = None,
) -> None:
    """State what each source of errors adds to the error of a located point.

    Args:
        calibration: JSON file of a head, whose stated accuracy counts; default: the twin as
            designed, with its 2.8 mm lenses.
        profile: Error profile of the twin: ideal, paper, noise-only, or a TOML file.
        at: Position of a point [m] from the left eye, x forward, y left, z up; may be repeated.
            Default: 0.5 m and 1 m ahead.
        motion: Motion of the eyes: parallel, divergent, or the folder of a dataset.
        noise: Noise of a pixel coordinate [px]; default: the calibration's, or that of the
            twin's object.
        json: JSON file of all numbers.
        figure: PNG file of the bars.
    """
    from vergence.commands.budget import HEADING, advice, as_plain, table
    from vergence.commands.budget import run as run_budget
    from vergence.geometry.head import load_head
    from vergence.twin.model import nominal_head
    from vergence.twin.profile import load_profile

    check_outputs(json, figure, inputs=[] if calibration is None else [calibration])
    chosen = None if profile is None else load_profile(profile)
    head = nominal_head("2.8mm") if calibration is None else load_head(calibration)
    found = run_budget(head, points=at or AHEAD, motion=motion, profile=chosen, pixel_std_px=noise)
    if json is not None:
        write_json(as_plain(found), json)
    if figure is not None:
        from vergence.viewer.plots_budget import budget_figure

        budget_figure(figure, found.budgets, f"{motion} motion")
    console = Console()
    for k, own in enumerate(found.budgets):
        x, y, z = own.point_m
        rows = Table(title=f"({x:g}, {y:g}, {z:g}) m, {motion} motion: 1 std [mm]")
        for name in HEADING:
            rows.add_column(name, justify="left" if name == HEADING[0] else "right")
        for row in table(found, k):
            rows.add_row(*row)
        console.print(rows)
        print(advice(found, k))


AHEAD = ((0.5, -0.04, 0.0), (1.0, -0.04, 0.0))
"""Points [m] in front of the twin's eyes."""


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
        format: Format; ros writes a folder, the others a file.
        out: File or folder to write.
    """
    from vergence.geometry.head import load_head
    from vergence.interchange.formats import export_head

    check_outputs(None if format == "ros" else out, inputs=[calibration])
    export_head(load_head(calibration), out, format)
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
        path: File; for ros a folder of files.
        format: opencv has the whole head, kalibr the cameras and their poses, ros the cameras only.
        out: JSON file of the calibration.
        start: Calibration that supplies what kalibr and ros files do not contain.
    """
    from vergence.geometry.head import load_head, save_head
    from vergence.interchange.formats import import_head

    check_outputs(out, inputs=[path])
    template = None if start is None else load_head(start)
    save_head(import_head(path, format, template=template), out)
    print(f"Wrote {out}.")


@dataclass(frozen=True)
class Experiment:
    """Options that foveate, track and grasp have in common."""

    seed: int = 0
    """Seed of everything random."""
    profile: str = "ideal"
    """Error profile: ideal, paper, noise-only, or a TOML file."""
    scene: Scene = "room"
    """What the head looks at."""
    geometry: Geometry = "joints"
    """What tells how the eyes stand when an object is located: joints, or these as corrected by
    what both eyes see."""
    out: Path | None = None
    """Folder for the results of each trial, and for a recording of the run."""
    json: Path | None = None
    """JSON file of the summary."""


Options = Annotated[Experiment, tyro.conf.arg(name="")]
DEFAULT = Experiment()


def foveate(*, trials: int = 100, options: Options = DEFAULT) -> None:
    """Show objects, and turn both eyes until the narrow images are centred on them.

    Args:
        trials: Number of objects; the first ten are recorded.
        options: Common options.
    """
    from vergence.demos.foveate import foveate as run

    _experiment("foveate", lambda **common: run(trials=trials, **common)[0], options)


def grasp(*, trials: int = 10, options: Options = DEFAULT) -> None:
    """Grasp objects that are held out to the robot, guided by what the eyes see of the hand.

    Args:
        trials: Number of objects.
        options: Common options.
    """
    from vergence.demos.grasp import grasp as run

    _experiment("grasp", lambda **common: run(trials=trials, **common)[0], options)


def track(*, seconds: float = 60.0, options: Options = DEFAULT) -> None:
    """Track a moving object, which is hidden once, with both narrow cameras.

    Args:
        seconds: Length of the run [s].
        options: Common options.
    """
    from vergence.demos.track import track as run

    _experiment("track", lambda **common: run(seconds=seconds, **common), options)


def depth(
    dataset: Annotated[Path | None, tyro.conf.Positional] = None,
    /,
    *,
    out: Path,
    twin: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    calibration: Path | None = None,
    profile: str = "paper",
    scene: Scene = "room",
    seed: int = 0,
    pairs: int = 20,
    geometry: Geometry = "joints",
) -> None:
    """Compute the depth of every pixel from rectified pairs, of the twin or of a dataset.

    Args:
        dataset: Folder with dataset.json, frames.csv and images; none with --twin.
        out: Folder for depth.rrd, depth.json and report.md.
        twin: Use the twin, with its eyes in divergent motion, and state the error of the depth.
        calibration: JSON file that `vergence calibrate` wrote; the twin can do without.
        profile: Error profile of the twin: ideal, paper, noise-only, or a TOML file.
        scene: Scene that the twin looks at.
        seed: Seed of everything random on the twin.
        pairs: Number of pairs; of a dataset at most so many.
        geometry: What tells how the eyes stand: joints, or these as corrected by what both eyes see
            of the scene.
    """
    if twin == (dataset is not None):
        found = "both" if twin else "neither"
        raise VergenceError(f"Depth is of a dataset or, with --twin, of the twin; found {found}.")
    from vergence.demos.depth import as_markdown
    from vergence.demos.depth import depth as run
    from vergence.twin.profile import load_profile

    _say_if_unfinished(out)
    with _progress() as progress:
        done = run(
            out,
            dataset=dataset,
            calibration=calibration,
            profile=load_profile(profile),
            scene=scene,
            seed=seed,
            pairs=pairs,
            geometry=geometry,
            progress=progress,
        )
    print(as_markdown(done), end="")
    print(f"To view the recording: {invocation('rerun', out / 'depth.rrd')}")


def _experiment(name: str, run: Callable[..., DataclassInstance], options: Experiment) -> None:
    """Run an experiment, print and write its summary, and say how to view its recording."""
    from vergence.twin.profile import load_profile

    profile = load_profile(options.profile)
    check_outputs(options.json, folder=options.out)
    _say_if_unfinished(options.out)
    with _progress() as progress:
        found = run(
            seed=options.seed,
            profile=profile,
            scene=options.scene,
            geometry=options.geometry,
            out=options.out,
            progress=progress,
        )
    if options.json is not None:
        write_json(found, options.json)
    print(as_json(found), end="")
    if options.out is not None:
        typed = invocation("rerun", options.out / f"{name}.rrd")
        print(f"To view the recording: {typed}", file=sys.stderr)


def _say_if_unfinished(folder: Path | None) -> None:
    if folder is not None and unfinished(folder):
        print(
            f"An earlier run into {folder} was stopped before its end: until this one has ended, "
            "files there may be of different runs.",
            file=sys.stderr,
        )


@contextmanager
def _progress() -> Iterator[Progress]:
    """Show each task as a bar on standard error."""
    columns = TextColumn("{task.description:<28}"), BarColumn(), MofNCompleteColumn()
    bars, tasks = Bars(*columns, TimeElapsedColumn(), console=Console(stderr=True)), {}

    def show(task: str, done: int, total: int) -> None:
        bars.start()  # not earlier: refused arguments have no bar
        if task not in tasks:
            tasks[task] = bars.add_task(task, total=total)
        bars.update(tasks[task], completed=done, total=total)

    try:
        yield show
    finally:
        if tasks:
            bars.stop()


COMMANDS: dict[str, Callable[..., None]] = {
    "reproduce": reproduce,
    "record": record,
    "calibrate": calibrate,
    "self-calibrate": self_calibrate,
    "plan": plan,
    "design": design,
    "evaluate": evaluate,
    "budget": budget,
    "export": export,
    "import": import_,
    "foveate": foveate,
    "track": track,
    "grasp": grasp,
    "depth": depth,
}


def _check(arguments: list[str]) -> None:
    """Refuse an unknown command or option in one sentence."""
    if not arguments or arguments[0] in ("-h", "--help"):
        return
    name = arguments[0]
    if name not in COMMANDS:
        raise VergenceError(
            f"There is no command {name!r}; there are {', '.join(COMMANDS)}. "
            f"See {invocation('vergence', '--help')}."
        )
    known = _options(COMMANDS[name])
    for argument in arguments[1:]:
        option = argument.partition("=")[0].replace("_", "-")
        if option.startswith("--") and option not in (*known, "--help"):
            raise VergenceError(
                f"{name} has no option {argument!r}; it has {', '.join(known)}. "
                f"See {invocation('vergence', name, '--help')}."
            )


def _options(command: Callable[..., None]) -> list[str]:
    """Return the options of a command, with those that experiments have in common."""
    parameters = signature(command).parameters.values()
    names = [each.name for each in parameters if each.kind is Parameter.KEYWORD_ONLY]
    if names[-1] == "options":
        names[-1:] = [field.name for field in fields(Experiment)]
    return [f"--{name.replace('_', '-')}" for name in names]


def main() -> None:
    """Run the command line; a mistake of the user ends in one sentence and exit code 2."""
    if sys.argv[1:] == ["--version"]:
        print(f"vergence {__version__}")
        return
    try:
        signal.signal(signal.SIGINT, _stop)
        signal.signal(signal.SIGTERM, _stop)
        _check(sys.argv[1:])
        tyro.extras.subcommand_cli_from_dict(
            COMMANDS,
            prog=invocation("vergence"),
            description="Active 3-D vision: calibration, stereo and gaze control, and a twin.",
        )
    except VergenceError as error:
        print(f"vergence: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except KeyboardInterrupt as stop:
        done = finished_files()
        files = " ".join(map(str, done[-FILES_NAMED:]))
        files += f" and {len(done) - FILES_NAMED} more" if len(done) > FILES_NAMED else ""
        kept = f"finished before: {files}" if files else "nothing was written"
        print(f"vergence: stopped; {kept}.", file=sys.stderr)
        raise SystemExit(128 + (stop.args[0] if stop.args else signal.SIGINT)) from None


def _stop(number: int, frame: object) -> None:
    """End as Ctrl-C does."""
    raise KeyboardInterrupt(number)


if __name__ == "__main__":
    main()
