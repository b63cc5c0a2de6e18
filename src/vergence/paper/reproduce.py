"""Reproduce the paper: build the head, calibrate it, replay the figures, write the results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from vergence.arrays import Array
from vergence.calibration.initial import SequentialCalibration
from vergence.data.dataset import Frame
from vergence.errors import VergenceError, check_seed
from vergence.files import REPORT, results_folder, write_json, write_whole
from vergence.geometry.head import HeadCalibration, save_head
from vergence.paper.comparison import LEARNED, PAPER, Comparison, before_looking, comparison
from vergence.paper.figures import FIGURES, Figure
from vergence.paper.plots import save_figures
from vergence.paper.recording import figure_recording, log_results
from vergence.paper.replay import Replay, as_plain, chosen, replay, sample_times, summaries
from vergence.paper.report import Reproduction, figure_report, report
from vergence.parallel import process_count, run_tasks
from vergence.progress import Progress, silent
from vergence.self_calibration.calibrator import VisualGeometry
from vergence.self_calibration.filter import learned_head
from vergence.twin.appearance import visual_geoms
from vergence.twin.calibration_errors import inject_calibration_error
from vergence.twin.calibration_sequence import paper_calibration
from vergence.twin.head import Twin
from vergence.twin.looking_around import learn_by_looking
from vergence.twin.profile import ErrorProfile, Lens
from vergence.twin.scene.room import Scene
from vergence.viewer.frame import log_frame
from vergence.viewer.opening import log_report
from vergence.viewer.seen import log_learned, log_matches

ReplayMethod = Literal["paper", "self-calibrated"]
RESULTS = (
    "figures.png",
    "statistics.json",
    REPORT,
    *(f"fig{number:02d}.rrd" for number in FIGURES),
    *sorted({f"calibration-{figure.lens}.json" for figure in FIGURES.values()}),
)
"""Files in the folder of the results, besides learned heads."""
_LOOKING = 100
"""Number of the run in which the learned head first looks around; those of figures are theirs."""
SAMPLES_WITH_IMAGES = 160
"""About how many samples of a figure have their images in the recording, which keeps it small."""


@dataclass(frozen=True)
class _Settings:
    """What is replayed, and how; see `reproduce`."""

    out: Path
    profile: ErrorProfile
    seed: int
    scene: Scene
    duration_s: float | None
    rate_hz: float | None
    method: ReplayMethod
    compare: bool
    floor: bool

    @property
    def learns(self) -> bool:
        """Whether there is self-calibration."""
        return self.compare or self.floor or self.method != "paper"

    def twin(self, lens: Lens) -> Twin:
        """Return the twin with wide cameras of a lens."""
        return Twin(self.profile, seed=self.seed, lens=lens, scene=self.scene)


def reproduce(
    out: Path,
    *,
    figures: Sequence[int],
    profile: ErrorProfile,
    seed: int,
    scene: Scene = "room",
    duration_s: float | None = None,
    rate_hz: float | None = None,
    method: ReplayMethod = "paper",
    compare: bool = False,
    floor: bool = False,
    jobs: int = 1,
    progress: Progress = silent,
) -> Reproduction:
    """Replay figures and write recordings, plots, report and statistics into a folder.

    Results are written after each figure, so that an interrupted run loses only unfinished ones.
    The number of jobs does not change them.

    Args:
        out: folder of the results; made if it is not there.
        figures: numbers of the paper's figures.
        profile: the error profile of the twin.
        seed: of everything random.
        scene: what the head looks at.
        duration_s: length of each replay; None: its full combined period, at least 60 s.
        rate_hz: samples per second; None: 640 samples per figure.
        method: whose results are plotted and stand under `figures`: the paper's, or those of
            the geometry that is learned from the same images.
        compare: also state the results of the other methods.
        floor: also those of self-calibration that is given the true head, for evaluation.
        jobs: processes, as of `parallel.run_tasks`; -1: one for each core.
        progress: is called after each view of a calibration and each sample of a figure.

    Raises:
        VergenceError: an argument cannot be met, or the folder cannot be written.
    """
    wanted = check(figures=figures, seed=seed, duration_s=duration_s, rate_hz=rate_hz, jobs=jobs)
    settings = _Settings(
        out, profile, seed, scene, duration_s, rate_hz, method, compare=compare, floor=floor
    )
    done = Reproduction(profile, seed, {}, {}, {})
    with results_folder(out):
        try:
            _replay_all(settings, wanted, done, jobs, progress)
        finally:
            if done.replays:
                save_figures(out / "figures.png", list(done.replays.values()))
    return done


def _replay_all(
    settings: _Settings,
    figures: Sequence[Figure],
    done: Reproduction,
    jobs: int,
    progress: Progress,
) -> None:
    """Replay figures, and add each to what is done when its files are written."""
    lenses: list[Lens] = list(dict.fromkeys(figure.lens for figure in figures))
    prepared: dict[Lens, tuple[HeadCalibration, VisualGeometry | None]] = {}

    def calibrated(
        found: tuple[Lens, SequentialCalibration, HeadCalibration, VisualGeometry | None],
    ) -> None:
        lens, done.calibrations[lens], done.heads[lens], learning = found
        prepared[lens] = done.heads[lens], learning

    def replayed(found: Replay) -> None:
        done.replays[found.figure.number] = found
        _write(settings.out, done)

    tasks = [partial(_prepare, settings, lens) for lens in lenses]
    run_tasks(tasks, calibrated, jobs=jobs, progress=progress)
    replays = [partial(_replay, settings, *prepared[each.lens], each) for each in figures]
    run_tasks(replays, replayed, jobs=jobs, progress=progress)


def _prepare(
    settings: _Settings, lens: Lens, progress: Progress
) -> tuple[Lens, SequentialCalibration, HeadCalibration, VisualGeometry | None]:
    """Calibrate the head with wide cameras of a lens, as the paper does, and write the result.

    The head is returned as the replays use it, with what its eyes have learned in looking around,
    with which every figure begins; None: there is no self-calibration.
    """
    task = f"calibrating, {lens} lens"
    with settings.twin(lens) as twin:
        found = paper_calibration(
            twin, settings.seed, progress=lambda _, done, total: progress(task, done, total)
        )
        head = inject_calibration_error(found.head, settings.profile.by_hand, lens)
        learning = None
        if settings.learns:
            learning = learn_by_looking(
                twin,
                before_looking(head),
                run=_LOOKING,
                progress=lambda task, *done: progress(f"{task}, {lens} lens", *done),
            )
    save_head(found.head, settings.out / f"calibration-{lens}.json")
    return lens, found, head, learning


def _replay(
    settings: _Settings,
    head: HeadCalibration,
    learning: VisualGeometry | None,
    figure: Figure,
    progress: Progress,
) -> Replay:
    """Replay a figure and record it."""
    with settings.twin(figure.lens) as twin:
        compared = None
        if learning is not None:
            compared = comparison(head, twin, learning, floor=settings.floor)
        done = record_replay(
            twin,
            head,
            figure,
            sample_times(figure, settings.duration_s, settings.rate_hz),
            settings.out / f"fig{figure.number:02d}.rrd",
            method=PAPER if settings.method == "paper" else LEARNED,
            compared=compared,
            progress=progress,
        )
    if compared is not None:
        learned = learned_head(compared.learning.state)
        save_head(learned, settings.out / f"fig{figure.number:02d}-learned.json")
    return done


def check(
    *,
    figures: Sequence[int],
    seed: int,
    duration_s: float | None = None,
    rate_hz: float | None = None,
    jobs: int = 1,
) -> list[Figure]:
    """Check the arguments of `reproduce` before any work is done, and return the figures.

    VergenceError if an argument cannot be met.
    """
    unknown = [number for number in figures if number not in FIGURES]
    if unknown or not figures:
        asked = f"figure {unknown[0]}" if unknown else "no figure"
        raise VergenceError(f"Asked for {asked}; the paper's experiments are figures 6 to 11.")
    check_seed(seed)
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
    process_count(jobs)
    return chosen


def record_replay(
    twin: Twin,
    calibration: HeadCalibration,
    figure: Figure,
    times_s: Array,
    path: Path,
    *,
    method: str = PAPER,
    compared: Comparison | None = None,
    progress: Progress = silent,
) -> Replay:
    """Replay one figure on rendered images, as `replay` does, and record it."""
    beside = known = None
    if compared is not None:
        beside, known = LEARNED if method == PAPER else PAPER, compared.learning.state
    geoms = visual_geoms(twin.model)
    with figure_recording(path, figure, calibration, geoms, beside=beside, known=known) as rec:

        def observe(*, frame: Frame | None, **sample: Any) -> None:
            log_frame(rec, calibration, frame=frame, **sample)
            if compared is None or frame is None:
                return
            now = compared.learning
            log_learned(rec, calibration, now.state)
            if now.latest is not None:
                log_matches(rec, calibration, now.latest)

        result = replay(
            twin,
            calibration,
            figure,
            times_s,
            observer=observe,
            image_every=max(1, len(times_s) // SAMPLES_WITH_IMAGES),
            compared=compared,
            progress=progress,
        )
        result = chosen(result, method)
        log_results(rec, result, calibration, twin.T_world_lbase(), beside=beside)
        log_report(rec, figure_report(result, twin.profile, calibration))
    return result


def _write(out: Path, done: Reproduction) -> None:
    """Write statistics.json and report.md of the figures so far."""
    results: dict[str, Any] = {
        "profile": done.profile.name,
        "fitted_parameters": len(done.profile.fitted),
        "seed": done.seed,
        "figures": {
            str(number): as_plain(each.figure, each.statistics)
            for number, each in sorted(done.replays.items())
        },
    }
    by_figure = {str(n): summaries(done.replays[n]) for n in sorted(done.replays)}
    methods = dict.fromkeys(method for each in by_figure.values() for method in each)
    if methods:
        results["methods"] = {
            method: {"figures": {n: each[method] for n, each in by_figure.items()}}
            for method in methods
        }
    write_json(results, out / "statistics.json")
    write_whole(out / REPORT, report(done))
