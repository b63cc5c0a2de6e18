"""Reproduce the paper: build the twin, calibrate it, replay the figures, write the results."""

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
from vergence.paper.figures import FIGURES, Figure, Lens
from vergence.paper.plots import save_figures
from vergence.paper.recording import figure_recording, log_results
from vergence.paper.replay import Replay, as_plain, replay, sample_times, show_method, summaries
from vergence.paper.report import Reproduction, figure_report, report
from vergence.parallel import run_tasks
from vergence.progress import Progress, silent
from vergence.self_calibration.calibrator import VisualGeometry
from vergence.self_calibration.filter import learned_head
from vergence.twin.appearance import visual_geoms
from vergence.twin.calibration_errors import inject_calibration_error
from vergence.twin.calibration_sequence import paper_calibration
from vergence.twin.head import Twin
from vergence.twin.profile import ErrorProfile
from vergence.twin.scene import Scene
from vergence.twin.simulated_robot import learn_by_looking
from vergence.viewer.recording import log_frame, log_report
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
SAMPLES_WITH_IMAGES = 160
"""Approximate number of samples of a figure with images in the recording, to keep it small."""


@dataclass(frozen=True)
class ReproductionSettings:
    """Settings of `reproduce`.

    Raises VergenceError if they cannot be met.
    """

    out: Path
    """Folder of the results; it is made if it does not exist."""
    figures: Sequence[int]
    """Numbers of the paper's figures."""
    profile: ErrorProfile
    """Error profile of the twin."""
    seed: int = 0
    """Seed of everything random."""
    scene: Scene = "room"
    """What the head looks at."""
    duration_s: float | None = None
    """Length of each replay; None: its full combined period, at least 60 s."""
    rate_hz: float | None = None
    """Samples per second; None: SAMPLES per figure."""
    method: ReplayMethod = "paper"
    """Method whose results are plotted and stand under `figures`: the paper's, or the geometry that
    is learned from the same images."""
    compare: bool = False
    """Whether to state the results of the other methods."""
    floor: bool = False
    """Whether to state those of self-calibration that is given the true head, for evaluation."""

    def __post_init__(self) -> None:
        unknown = [number for number in self.figures if number not in FIGURES]
        if unknown or not self.figures:
            asked = f"figure {unknown[0]}" if unknown else "no figure"
            raise VergenceError(f"Asked for {asked}; the paper's experiments are figures 6 to 11.")
        check_seed(self.seed)
        for name, unit, value, most in (
            ("duration", "s", self.duration_s, 3600),
            ("rate", "Hz", self.rate_hz, 200),
        ):
            if value is not None and not 0 < value <= most:
                raise VergenceError(
                    f"The {name} must be above 0 and at most {most} {unit}, found {value}."
                )
        for figure in self.chosen_figures:
            times = sample_times(figure, self.duration_s, self.rate_hz)
            if len(times) < 2 or (np.diff(times) <= 0).any():
                raise VergenceError(
                    f"A duration of {self.duration_s} s at {self.rate_hz or 'the default rate'} "
                    "gives samples less than 1 ms apart, or fewer than two; ask for a longer or "
                    "slower run."
                )

    @property
    def chosen_figures(self) -> list[Figure]:
        """The figures in their order, each once."""
        return [FIGURES[number] for number in sorted(set(self.figures))]

    def twin(self, lens: Lens) -> Twin:
        """Build the twin with wide cameras of a lens."""
        return Twin(self.profile, seed=self.seed, lens=lens, scene=self.scene)


def reproduce(
    settings: ReproductionSettings, *, jobs: int = 1, progress: Progress = silent
) -> Reproduction:
    """Replay figures and write recordings, plots, report and statistics into a folder.

    Results are written after each figure, so that an interrupted run loses unfinished ones only.
    The number of jobs does not change them.

    Args:
        settings: what is replayed, and how.
        jobs: processes, as of `parallel.run_tasks`; -1: one for each core.
        progress: is called after each view of a calibration and each sample of a figure.

    Raises:
        VergenceError: a file cannot be written.
    """
    done = Reproduction(settings.profile, settings.seed, {}, {}, {})
    figures = settings.chosen_figures
    learned: dict[Lens, VisualGeometry | None] = {}

    def calibrated(
        found: tuple[Lens, SequentialCalibration, HeadCalibration, VisualGeometry | None],
    ) -> None:
        lens, done.calibrations[lens], done.heads[lens], learned[lens] = found

    def replayed(found: Replay) -> None:
        done.replays[found.figure.number] = found
        _write(settings.out, done)

    with results_folder(settings.out):
        try:
            lenses: list[Lens] = list(dict.fromkeys(each.lens for each in figures))
            tasks = [partial(_prepare, settings, lens) for lens in lenses]
            run_tasks(tasks, calibrated, jobs=jobs, progress=progress)
            replays = [
                partial(_replay, settings, done.heads[each.lens], learned[each.lens], each)
                for each in figures
            ]
            run_tasks(replays, replayed, jobs=jobs, progress=progress)
        finally:
            if done.replays:
                save_figures(settings.out / "figures.png", list(done.replays.values()))
    return done


def _prepare(
    settings: ReproductionSettings, lens: Lens, progress: Progress
) -> tuple[Lens, SequentialCalibration, HeadCalibration, VisualGeometry | None]:
    """Calibrate the head with wide cameras of a lens as the paper does, and write the result.

    Returns the head as the replays use it, and what it learned in looking around, with which each
    figure begins; None: there is no self-calibration.
    """
    task = f"calibrating, {lens} lens"
    with settings.twin(lens) as twin:
        found = paper_calibration(
            twin, settings.seed, progress=lambda _, done, total: progress(task, done, total)
        )
        head = inject_calibration_error(found.head, settings.profile.by_hand)
        learning = None
        if settings.compare or settings.floor or settings.method != "paper":
            learning = learn_by_looking(
                twin,
                before_looking(head),
                run=100,  # figures have their own
                progress=lambda task, *done: progress(f"{task}, {lens} lens", *done),
            )
    save_head(found.head, settings.out / f"calibration-{lens}.json")
    return lens, found, head, learning


def _replay(
    settings: ReproductionSettings,
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
    """Replay one figure as `replay` does, and record it."""
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
        result = show_method(result, method)
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
