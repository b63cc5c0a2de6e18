"""Commands that predict the accuracy of a head, and how to improve it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

import vergence as vg
from vergence.cli.options import Optional, Points, Positional, check_outputs
from vergence.cli.report import Report
from vergence.cli.terminal import progress_bars
from vergence.files import results_folder


def plan(
    source: Positional[Path],
    /,
    *,
    views: int = 10,
    board: Annotated[
        Optional[tuple[int, int, float]], tyro.conf.arg(metavar="COLUMNS ROWS SQUARE_M")
    ] = None,
    limits_deg: tuple[float, ...] = (20.0,),
    head: Optional[Path] = None,
    distances: tuple[float, ...] = (0.3, 0.6, 1.0),
    seed: int = 0,
    figure: Optional[Path] = None,
    json: Optional[Path] = None,
) -> Report:
    """Say which views of the board to record next, and what accuracy they will bring.

    Args:
        source: JSON file of a calibration, or folder of a dataset, which is calibrated first.
        views: Number of views to plan.
        board: Inner corners in a row and in a column, and side of a square [m]; default: the
            dataset's.
        limits_deg: To either side, one number for all: how far each reading may turn its joint; or
            the largest value of each reading (usually left pan, left tilt, right pan, right tilt).
        head: A head.toml, whose limits of the joints take the place of --limits-deg.
        distances: Distances of the points that are to be accurate, from the middle of the head [m].
        seed: Seed of the candidates, which are random.
        figure: PNG file of the board's places and of the accuracy after each view.
        json: JSON file of the plan.
    """
    import numpy as np

    from vergence.accuracy.plan import head_and_board
    from vergence.accuracy.plan import plan as plan_views
    from vergence.cli.accuracy_reports import plan_report
    from vergence.viewer.plots.accuracy import save_plan

    check_outputs(json, figure=figure, inputs=[source])
    limits_rad = np.radians(limits_deg[0] if len(limits_deg) == 1 else limits_deg)
    if head is not None:
        from vergence.twin.head_model import load_head_model

        of = load_head_model(head)
        readings = of.limits.setpoint_range_rad[len(of.designed.neck) :]
        limits_rad = np.abs(readings).min(axis=1)
    with progress_bars() as progress:
        calibrated, shown = head_and_board(source, board, limits_rad, progress)
        found = plan_views(
            calibrated,
            shown,
            views=views,
            limits_rad=limits_rad,
            distances_m=distances,
            seed=seed,
            progress=progress,
        )
    report = plan_report(found)
    report.write_json(json)
    if figure is not None:
        save_plan(figure, found)
    return report


def design(
    settings: Positional[Optional[Path]] = None,
    /,
    *,
    out: Path = Path("runs/design"),
    accuracy_mm: float = 5.0,
    at_m: float = 0.5,
    baseline_mm: Optional[tuple[float, ...]] = None,
    focal_px: Optional[tuple[float, ...]] = None,
    square_mm: Optional[tuple[float, ...]] = None,
    views: Optional[tuple[float, ...]] = None,
    counts_per_turn: Optional[tuple[float, ...]] = None,
    joint_noise_deg: Optional[tuple[float, ...]] = None,
    pixel_noise_px: Optional[tuple[float, ...]] = None,
    delay_ms: Optional[tuple[float, ...]] = None,
    jobs: int = -1,
) -> Report:
    """Compare designs of a head, and find the cheapest that is as accurate as wanted.

    Args:
        settings: TOML or JSON file of what is swept, of the workspace and of prices; default:
            those that docs/design_and_plan.md lists. The options below take the place of its
            values.
        out: Folder of the results.
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
    """
    options = dict(locals())
    from vergence.accuracy.design_settings import AXES, merged_settings
    from vergence.accuracy.design_sweep import sweep
    from vergence.cli.accuracy_reports import DESIGN_RESULTS, write_design
    from vergence.parallel import process_count

    check_outputs(folder=out, names=DESIGN_RESULTS, inputs=[settings])
    process_count(jobs)
    axes = {name: options[name] for name in AXES if options[name] is not None}
    chosen = merged_settings(settings, axes, at_m=at_m)
    with progress_bars() as progress, results_folder(out):
        swept = sweep(chosen, jobs=jobs, progress=progress)
        return write_design(out, swept, accuracy_m=1e-3 * accuracy_mm, distance_m=at_m)


def budget(
    *,
    calibration: Optional[Path] = None,
    head: Optional[Path] = None,
    profile: Optional[str] = None,
    at: Points = (),
    motion: str = "divergent",
    noise: Optional[float] = None,
    json: Optional[Path] = None,
    figure: Optional[Path] = None,
) -> Report:
    """State what each source of errors adds to the error of a located point.

    Args:
        calibration: JSON file of a head, whose stated accuracy counts; default: the twin as
            designed.
        head: The twin's head, a head.toml as `vergence head` writes it; default: the one of this
            project.
        profile: Error profile of the twin: ideal, paper, noise-only, or a TOML file.
        at: Position of a point [m] from the left eye, x forward, y left, z up; may be repeated.
            Default: 0.5 m and 1 m ahead.
        motion: Motion of the eyes: parallel, divergent, or the folder of a dataset.
        noise: Noise of a pixel coordinate [px]; default: the calibration's, or that of the
            twin's object.
        json: JSON file of all numbers.
        figure: PNG file of the bars.
    """
    import numpy as np

    from vergence.accuracy.budget import motion_budgets, stated_sources
    from vergence.cli.accuracy_reports import budget_report

    check_outputs(json, figure=figure, inputs=[motion, calibration, head, profile])
    points = np.array(at or ((0.5, -0.04, 0.0), (1.0, -0.04, 0.0)))
    # The twin needs OpenGL, and a real head does not.
    if calibration is None:
        from vergence.twin.head_model import load_head_model

        calibrated = load_head_model(head).designed.head
    else:
        calibrated = vg.load_head(calibration)
    if profile is None:
        sources = stated_sources(calibrated, noise)
    else:
        from vergence.twin.calibration_errors import profile_sources
        from vergence.twin.profile import load_profile

        sources = profile_sources(calibrated, load_profile(profile), noise)
    found = motion_budgets(calibrated, points, motion=motion, sources=sources)
    report = budget_report(found)
    report.write_json(json)
    if figure is not None:
        from vergence.viewer.plots.accuracy import save_budget

        save_budget(figure, found.budgets, f"{motion} motion")
    return report
