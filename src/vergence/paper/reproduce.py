"""The main job: build the head, calibrate it, replay the figures, write what came out."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from vergence.arrays import Array
from vergence.calibration.sequential.sequential import PaperCalibration, calibrate
from vergence.errors import VergenceError
from vergence.files import write_whole
from vergence.geometry.head import HeadCalibration, save
from vergence.paper.figures import FIGURES, Figure
from vergence.paper.plots import paper_figures
from vergence.paper.recording import figure_recording, log_report, log_series, log_statistics
from vergence.paper.replay import Replay, Sample, replay, sample_times
from vergence.paper.report import figure_report, report
from vergence.twin.appearance import visual_geoms
from vergence.twin.calibration_errors import written_by_hand
from vergence.twin.calibration_sequence import look, plan
from vergence.twin.head import Twin
from vergence.twin.model import FOCAL_MM
from vergence.twin.profile import ErrorProfile
from vergence.viewer.frame import log_frame

_PICTURES = 160
"""Samples of a figure whose pictures go into the recording; more make it large, not clearer."""


@dataclass(frozen=True, eq=False)
class Reproduction:
    """All that a run found, so far."""

    profile: ErrorProfile
    seed: int
    calibrations: dict[str, PaperCalibration]
    """By lens, as they were made."""
    heads: dict[str, HeadCalibration]
    """By lens, as they are used: with the errors that the profile writes in by hand."""
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
    done = Reproduction(profile, seed, {}, {}, {})
    with _progress() as progress:
        try:
            for lens in FOCAL_MM:
                through_it = [figure for figure in chosen if figure.lens == lens]
                if not through_it:
                    continue
                with Twin(profile, seed=seed, lens=lens) as twin:
                    found = _calibrate(twin, lens, seed, out, progress)
                    done.calibrations[lens] = found
                    done.heads[lens] = written_by_hand(found.head, profile.by_hand, lens)
                    for figure in through_it:
                        times = sample_times(figure, duration_s, rate_hz)
                        label = f"figure {figure.number}, {figure.motion}"
                        task = progress.add_task(label, total=len(times))
                        done.replays[figure.number] = record_replay(
                            twin,
                            done.heads[lens],
                            figure,
                            times,
                            out / f"fig{figure.number:02d}.rrd",
                            profile=profile,
                            done=partial(progress.advance, task),
                        )
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
    for name, unit, value, most in (
        ("duration", "s", duration_s, 3600),
        ("rate", "Hz", rate_hz, 200),
    ):
        if value is not None and not 0 < value <= most:
            raise VergenceError(
                f"The {name} must be above 0 and at most {most} {unit}, found {value}."
            )
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


def _calibrate(twin: Twin, lens: str, seed: int, out: Path, progress: Progress) -> PaperCalibration:
    shots = plan(twin.nominal, seed)
    task = progress.add_task(f"calibrating, {lens} lens", total=len(shots))
    views = look(twin, shots, done=lambda: progress.advance(task))
    found = calibrate(views, wide_lens=twin.profile.calibration.wide_lens, neck=twin.nominal.neck)
    save(found.head, out / f"calibration-{lens}.json")
    return found


def record_replay(
    twin: Twin,
    believed: HeadCalibration,
    figure: Figure,
    times_s: Array,
    path: Path,
    *,
    profile: ErrorProfile,
    done: Callable[[], None] = lambda: None,
) -> Replay:
    """Replay one figure on rendered images, and record it.

    Args:
        twin: the head, with the figure's lens.
        believed: the calibration that is used.
        figure: which one.
        times_s: (N,) of the samples.
        path: of the recording.
        profile: for the report in the recording.
        done: called after each sample.
    """
    every = picture_interval(times_s)
    with figure_recording(path, figure, believed, visual_geoms(twin.model)) as rec:

        def watch(sample: Sample) -> None:
            log_frame(
                rec,
                time_s=sample.time_s,
                index=sample.index,
                frame=sample.frame if sample.index % every == 0 else None,
                body_poses=sample.body_poses,
                detected=sample.detected,
                truth=sample.truth,
            )

        result = replay(
            twin, believed, figure, times_s, watch=watch, pictures_every=every, done=done
        )
        log_series(
            rec,
            figure=figure,
            head=believed,
            time_s=times_s,
            points=result.located.points,
            object_m=result.object_m,
            eye_angles=result.observations.eye_angles,
            statistics=result.statistics,
            T_world_lbase=twin.T_world_lbase(),
        )
        log_statistics(rec, figure=figure, object_m=result.object_m, statistics=result.statistics)
        log_report(rec, figure_report(result, profile, believed))
    return result


def picture_interval(times_s: Array) -> int:
    """Return of how many samples one is recorded with its pictures."""
    return max(1, len(times_s) // _PICTURES)


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
    write_whole(
        out / "report.md",
        report(done.replays, done.calibrations, done.heads, done.profile, done.seed),
    )
