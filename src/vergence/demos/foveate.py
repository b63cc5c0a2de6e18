"""Foveate objects that appear: turn the eyes until both narrow images are centred (Sec. III).

The twin is calibrated by the paper's method. In each trial the eyes start straight ahead, an object
appears, and the gaze controller turns the eyes to it, from frames alone. The truth is used to
measure the remaining error only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.demos.experiment import (
    Experiment,
    calibrated_twin,
    check_trials,
    initial_geometry,
    p95,
    recorded,
)
from vergence.errors import VergenceError
from vergence.gaze.controller import run_gaze
from vergence.gaze.state import GazePhase, GazeSettings, GazeState, initial_gaze_state
from vergence.progress import Progress, silent
from vergence.self_calibration.calibrator import VisualGeometry
from vergence.twin.head import Twin
from vergence.twin.simulated_robot import (
    FRAME_S,
    SimulatedHead,
    foveal_errors,
    reachable,
    unoccluded,
)
from vergence.viewer.plots.accuracy import draw_foveation
from vergence.viewer.plots.canvas import save

WITHIN_S = 0.5
"""Length of a trial [s]: a saccade takes 60 ms."""
DEPTH_M = (0.3, 1.5)
"""Range of depths of an object [m]."""
SETTLED_PX = 8.0
"""Error below which both eyes must stay until the end to be settled [px]."""


@dataclass(frozen=True)
class Summary:
    """Statistics of the trials; written as JSON."""

    trials: int
    median_px: float
    """Median over trials of the final error of the worse eye."""
    p95_px: float
    """95 % quantile of this error."""
    settle_s_p95: float | None
    """95 % quantile of the time until both eyes stay within SETTLED_PX; None: more than 5 % of the
    trials do not settle."""
    lost: int
    """Number of trials that end without the object in both narrow images."""


@dataclass(frozen=True, eq=False)
class Trial:
    """One object that appeared."""

    time_s: Array
    """(N,) times of the frames since it appeared."""
    errors_px: Array
    """(N, 2) true distance of the object from the centres of the left and right narrow image."""
    lost: bool
    """Whether one of the narrow images did not show the object at the end."""
    geometry: VisualGeometry | None = None
    """What was learned until then."""

    @property
    def final_px(self) -> float:
        """Error of the worse eye at the end."""
        return float(self.errors_px[-1].max())

    @property
    def settle_s(self) -> float:
        """Time from which both eyes stay within SETTLED_PX; infinite if they do not."""
        outside = np.flatnonzero(~(self.errors_px.max(axis=1) <= SETTLED_PX))
        first = 0 if not len(outside) else outside[-1] + 1
        return float(self.time_s[first]) if first < len(self.time_s) else np.inf


def targets(
    trials: int,
    seed: int,
    *,
    free: Callable[[Array], np.ndarray] = lambda places: np.ones(len(places), bool),
) -> Array:
    """Draw the positions (trials, 3) [m] at which objects appear, in frame head.

    Pan, tilt and depth are uniform. `free` tests (N,) whether positions (N, 3) are unoccluded;
    others are drawn again.
    """
    rng = np.random.default_rng([seed, 5])

    def draw(count: int) -> Array:
        widest = np.radians(20)  # within the eyes' ranges
        pan, tilt = rng.uniform(-widest, widest, (2, count))
        depth = rng.uniform(*DEPTH_M, count)
        return depth[:, None] * np.stack([np.ones(count), np.tan(pan), -np.tan(tilt)], axis=-1)

    where = draw(trials)
    for _ in range(100):
        if (good := free(where)).all():
            return where
        where[~good] = draw(int((~good).sum()))
    raise VergenceError("This head reaches too few places in front of it; see its limits.")


def run_trial(
    twin: Twin,
    settings: GazeSettings,
    run: int,
    target_head: Array,
    *,
    geometry: VisualGeometry | None = None,
    watch: Callable[[GazeState, Frame | None], None] = lambda state, frame: None,
) -> Trial:
    """Run the gaze controller for WITHIN_S on an object that appears.

    The number of the run is the seed of the noise. The object's position (3,) [m] is in frame head.
    The geometry is that of an earlier trial. `watch` gets each state and its frame.
    """
    head = SimulatedHead(twin, run, lambda _: target_head, all_cameras_every=1)
    at_rest = np.zeros(len(settings.joints))
    state = initial_gaze_state(settings, at_rest, head.now_s(), geometry=geometry)
    times: list[float] = []
    errors: list[Array] = []

    def keep(state: GazeState, frame: Frame | None) -> None:
        if frame is not None:
            times.append(frame.time_s)
            errors.append(foveal_errors(twin, settings))
        watch(state, frame)

    state = run_gaze(head, settings, state, WITHIN_S - FRAME_S, watch=keep)
    in_view = [state.detections.get(name) is not None for name in settings.narrow]
    lost = state.phase is GazePhase.LOST or not all(in_view)
    return Trial(np.array(times), np.array(errors), lost, state.geometry)


def summary(trials: list[Trial]) -> Summary:
    """Compute the statistics of trials."""
    final = [trial.final_px for trial in trials]
    slow = p95([trial.settle_s for trial in trials])
    return Summary(
        trials=len(trials),
        median_px=float(np.median(final)),
        p95_px=p95(final),
        settle_s_p95=slow if np.isfinite(slow) else None,
        lost=sum(trial.lost for trial in trials),
    )


def foveate(
    experiment: Experiment, progress: Progress = silent, *, trials: int = 100
) -> tuple[Summary, list[Trial]]:
    """Calibrate the twin and run a trial for each of a number of objects.

    The folder gets foveate.json, depth.png, and the recording foveate.rrd of the first ten
    trials. Raises VergenceError if an argument is out of range, or a file cannot be written.
    """
    check_trials(trials)
    with (
        calibrated_twin(experiment, progress) as (twin, settings),
        recorded(experiment, "foveate", twin, settings, reach_m=DEPTH_M[1], speed=0.25) as (
            watch,
            finish,
        ),
    ):
        if experiment.out is not None:
            save(draw_foveation(settings.calibration), experiment.out / "depth.png")
        radius_m = 0.02  # of the object

        def free(places: Array) -> np.ndarray:
            return unoccluded(twin, places, margin_m=radius_m) & reachable(twin, settings, places)

        where = targets(trials, experiment.seed, free=free)

        def record(state: GazeState, frame: Frame | None) -> None:
            if len(made) < 10 or experiment.viewer:  # files stay small
                watch(state, frame, {"object": f"{len(made) + 1}"}, None)

        made: list[Trial] = []
        known = initial_geometry(twin, settings)
        for number, target in enumerate(where, start=1):
            progress("foveate, trials", number - 1, trials)
            made.append(run_trial(twin, settings, number, target, geometry=known, watch=record))
            known = made[-1].geometry
        progress("foveate, trials", trials, trials)
        found = summary(made)
        finish(found)
    return found, made
