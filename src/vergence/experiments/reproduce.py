"""The main job: build the head, calibrate it, replay the figures, write what came out."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from vergence import recording
from vergence.arrays import Array
from vergence.calibration.pipeline import PaperCalibration, calibrate
from vergence.errors import VergenceError
from vergence.experiments.paper import FIGURES, Figure
from vergence.experiments.replay import Replay, Sample, replay, sample_times, written_by_hand
from vergence.experiments.report import figure_report, report
from vergence.experiments.sequence import look, plan
from vergence.head import save, write_whole
from vergence.plots import paper_figures
from vergence.twin.appearance import visual_geoms
from vergence.twin.head import Twin
from vergence.twin.profile import ErrorProfile

_PICTURES = 160
"""Samples of a figure whose pictures go into the recording; more make it large, not clearer."""


@dataclass(frozen=True, eq=False)
class Reproduction:
    """All that a run found, so far."""

    profile: ErrorProfile
    seed: int
    calibrations: dict[str, PaperCalibration]
    """By lens."""
    replays: dict[int, Replay]
    """By figure."""


def reproduce(
    out: Path,
    *,
    figures: Sequence[int],
    profile: ErrorProfile,
    seed: int,
    duration_s: float | None = None,
    rate_hz: float | None = None,
) -> Reproduction:
    """Replay figures and write recordings, plots, report and statistics into a folder.

    What is finished is on disk at once, so that an interrupted run loses only its last figure.

    Raises:
        VergenceError: an argument cannot be met, or the folder cannot be written.
    """
    chosen = _checked(figures, seed, duration_s, rate_hz)
    _writable(out)
    done = Reproduction(profile, seed, {}, {})
    with _progress() as progress:
        try:
            for lens in sorted({figure.lens for figure in chosen}):
                with Twin(profile, seed=seed, lens=lens) as twin:
                    done.calibrations[lens] = _calibrate(twin, lens, seed, out, progress)
                    for figure in chosen:
                        if figure.lens == lens:
                            times = sample_times(figure, duration_s, rate_hz)
                            _replay(twin, done, figure, times, out, progress)
                            _write(out, done)
        finally:
            if done.replays:
                paper_figures(out / "figures.png", list(done.replays.values()))
    return done


def _checked(
    figures: Sequence[int], seed: int, duration_s: float | None, rate_hz: float | None
) -> list[Figure]:
    unknown = [number for number in figures if number not in FIGURES]
    if unknown or not figures:
        asked = f"figure {unknown[0]}" if unknown else "no figure"
        raise VergenceError(f"Asked for {asked}; the paper's experiments are figures 6 to 11.")
    if seed < 0:
        raise VergenceError(f"The seed must be a whole number from 0, found {seed}.")
    for name, unit, value, most in (("duration", "s", duration_s, 3600), ("rate", "Hz", rate_hz, 200)):
        if value is not None and not 0 < value <= most:
            raise VergenceError(f"The {name} must be above 0 and at most {most} {unit}, found {value}.")
    chosen = [FIGURES[number] for number in sorted(set(figures))]
    for figure in chosen:
        times = sample_times(figure, duration_s, rate_hz)
        if len(times) < 2 or (np.diff(times) <= 0).any():
            raise VergenceError(
                f"A duration of {duration_s} s at {rate_hz or 'the default rate'} gives samples "
                "less than 1 ms apart, or fewer than two; ask for a longer or slower run."
            )
    return chosen


def _writable(out: Path) -> None:
    """Find out before the work, not after it, whether the results can be written."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        raise VergenceError(f"Cannot write into the folder {out}: {error.strerror}.") from error


def _progress() -> Progress:
    return Progress(
        TextColumn("{task.description:<28}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )


def _calibrate(
    twin: Twin, lens: str, seed: int, out: Path, progress: Progress
) -> PaperCalibration:
    shots = plan(twin.nominal, seed)
    task = progress.add_task(f"calibrating, {lens} lens", total=len(shots))
    views = look(twin, shots, done=lambda: progress.advance(task))
    found = calibrate(views, wide_lens=twin.profile.calibration.wide_lens, neck=twin.nominal.neck)
    save(found.head, out / f"calibration-{lens}.json")
    return found


def _replay(
    twin: Twin, done: Reproduction, figure: Figure, times: Array, out: Path, progress: Progress
) -> None:
    believed = written_by_hand(
        done.calibrations[figure.lens].head, done.profile.by_hand, figure.lens
    )
    task = progress.add_task(f"figure {figure.number}, {figure.motion}", total=len(times))
    path = out / f"fig{figure.number:02d}.rrd"
    with recording.figure_recording(path, figure, believed, visual_geoms(twin.model)) as rec:

        def watch(sample: Sample) -> None:
            recording.log_frame(
                rec,
                time_s=sample.time_s,
                index=sample.index,
                frame=sample.frame,
                body_poses=sample.body_poses,
                detected=sample.detected,
                truth=sample.truth,
            )

        result = replay(
            twin,
            believed,
            figure,
            times,
            watch=watch,
            watch_every=max(1, len(times) // _PICTURES),
            done=lambda: progress.advance(task),
        )
        recording.log_series(
            rec,
            time_s=times,
            points=result.located.points,
            object_m=result.object_m,
            eye_angles=result.observations.eye_angles,
            statistics=result.statistics,
            T_world_lbase=twin.T_world_lbase(),
        )
        recording.log_report(rec, figure_report(result, done.profile, believed))
    done.replays[figure.number] = result


def _write(out: Path, done: Reproduction) -> None:
    figures = {
        str(number): {
            "paper_mean_m": list(result.figure.mean_m),
            "paper_std_m": list(result.figure.std_m),
            "object_m": result.object_m.tolist(),
            "mean_m": result.statistics.mean_m.tolist(),
            "std_m": result.statistics.std_m.tolist(),
            "samples": result.statistics.samples,
            "dropped": result.statistics.dropped,
        }
        for number, result in sorted(done.replays.items())
    }
    summary = {
        "profile": done.profile.name,
        "fitted_parameters": len(done.profile.fitted),
        "seed": done.seed,
        "figures": figures,
    }
    write_whole(out / "statistics.json", json.dumps(summary, indent=1) + "\n")
    write_whole(out / "report.md", report(done.replays, done.calibrations, done.profile, done.seed))
