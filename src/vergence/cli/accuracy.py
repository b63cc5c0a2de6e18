"""Commands that predict the accuracy of a head, and what to do for a better one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from vergence.cli.numbers import Board
from vergence.cli.progress import progress_bars
from vergence.cli.tables import print_table
from vergence.writable import check_outputs
from vergence.writing import write_json


def plan(
    source: Annotated[Path, tyro.conf.Positional],
    /,
    *,
    views: int = 10,
    board: Board = None,
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
        limits_deg: To either side, one number for all: how far each reading may turn its joint; or
            the largest value of each reading (usually left pan, left tilt, right pan, right tilt).
        distances: Distances of the points that are to be accurate, from the middle of the head [m].
        seed: Seed of the candidates, which are random.
        figure: PNG file of the board's places and of the accuracy after each view.
        json: JSON file of the plan.
    """
    from vergence.commands.plan import as_plain, as_text, run
    from vergence.data.description import DESCRIPTION, FRAMES
    from vergence.viewer.plots.plan import save_plan

    check_outputs(json, figure=figure, inputs=[source, source / DESCRIPTION, source / FRAMES])
    with progress_bars() as progress:
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
        write_json(as_plain(found), json)
    if figure is not None:
        save_plan(figure, found)


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
            those that docs/design_and_plan.md lists. The options below take the place of its
            values.
        out: Folder of the results; a run that was stopped goes on from what is there.
        accuracy_mm: Accuracy that is wanted: rms error, in the worst direction and posture.
        at_m: Distance of the points for which it is wanted.
        baseline_mm: Distances between the eyes to try.
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
    from vergence.commands.design import RESULTS, TITLE, chosen_settings, run, sentences

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
    check_outputs(folder=out, names=RESULTS, title=TITLE, inputs=[settings] if settings else [])
    swept = chosen_settings(settings, given, accuracy_mm=accuracy_mm, at_m=at_m, jobs=jobs)
    with progress_bars() as progress:
        found = run(
            swept,
            out,
            accuracy_m=1e-3 * accuracy_mm,
            distance_m=at_m,
            jobs=jobs,
            cluster=cluster,
            progress=progress,
        )
    print("\n".join(sentences(found)))
    print(f"Wrote report.md, design.json, sweep.npz and two pictures to {out}.")


AHEAD = ((0.5, -0.04, 0.0), (1.0, -0.04, 0.0))
"""Points [m] in front of the twin's eyes."""


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
    from vergence.data.description import DESCRIPTION, FRAMES
    from vergence.geometry.head import load_head

    read = [Path(motion) / DESCRIPTION, Path(motion) / FRAMES]
    read += [calibration] if calibration else []
    read += [Path(profile)] if profile else []
    check_outputs(json, figure=figure, inputs=read)
    # The twin, and with it OpenGL, only where it is asked for.
    chosen = None
    if profile is not None:
        from vergence.twin.profile import load_profile

        chosen = load_profile(profile)
    if calibration is None:
        from vergence.twin.model import nominal_head

        head = nominal_head("2.8mm")
    else:
        head = load_head(calibration)
    found = run_budget(head, points=at or AHEAD, motion=motion, profile=chosen, pixel_std_px=noise)
    if json is not None:
        write_json(as_plain(found), json)
    if figure is not None:
        from vergence.viewer.plots.budget import save_budget

        save_budget(figure, found.budgets, f"{motion} motion")
    for k, own in enumerate(found.budgets):
        x, y, z = own.point_m
        title = f"({x:g}, {y:g}, {z:g}) m, {motion} motion: 1 std [mm]"
        print_table(title, HEADING, table(found, k))
        print(advice(found, k))
