"""Grasp an object that a person holds out (the paper's Fig. 12).

The object is brought from a distance and held out, swaying a little. The eyes keep it on both
foveas, and the reach controller moves the simulated hand, by frames, readings and the hand's
encoders. The truth is used to measure where the hand closed, and the eyes' depth errors by range.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.demos.depth_error_by_range import DepthSample, RangeBin, bin_by_range, depth_sample
from vergence.demos.experiment import (
    Experiment,
    calibrated_twin,
    check_trials,
    initial_geometry,
    p95,
    recorded,
)
from vergence.gaze.reaching import (
    ReachPhase,
    ReachSettings,
    ReachState,
    initial_reach_state,
    run_reach,
)
from vergence.progress import Progress, silent
from vergence.self_calibration.calibrator import VisualGeometry
from vergence.twin.hand import SimulatedHand, arm_mounting_error
from vergence.twin.head import Twin
from vergence.twin.simulated_robot import SimulatedHead

WITHIN_M = 0.010
"""Distance from the object's centre within which the hand should close [m]: half its radius."""
FAR_M, NEAR_M = (1.0, 1.3), (0.38, 0.55)
"""Distances from the head at which the object comes into view and is held out [m]."""
LONGEST_S = 12.0
"""Maximum length of a trial [s]."""


@dataclass(frozen=True, eq=False)
class Trial:
    """One object that was held out."""

    phase: ReachPhase
    """Phase at the end."""
    seconds: float
    """Length of the trial."""
    miss_m: float
    """Distance of the closed hand's centre from the object's; infinite if it did not close."""
    unaided_m: float
    """The same for a hand that moves by its encoders to where the eyes see the object."""
    samples: tuple[DepthSample, ...]
    """Depth errors of the eyes, frame by frame until the fingers start to close."""
    geometry: VisualGeometry | None = None
    """What was learned until the end."""


@dataclass(frozen=True)
class Summary:
    """Statistics of the trials; written as JSON."""

    trials: int
    held: int
    """Number of trials in which the hand closed by its own decision."""
    within: float
    """Share of all trials in which it closed within WITHIN_M of the object's centre."""
    median_mm: float | None
    """Median distance from the object's centre, over the trials in which it closed."""
    p95_mm: float | None
    """95 % quantile of this distance."""
    worst_mm: float | None
    """Maximum of these distances."""
    unaided_median_mm: float | None
    """Median distance of a hand that moves by its encoders alone, at the same moments."""
    seconds_p95: float
    """95 % quantile of the lengths of all trials."""
    by_distance: tuple[RangeBin, ...]
    """Depth errors of the eyes."""


def hand_held(seed: int, run: int) -> Callable[[float], Array]:
    """Draw the path of a held object by seed and run: (3,) [m] in frame head by time [s]."""
    rng = np.random.default_rng([seed, 9, run])
    far, near = (
        rng.uniform(*depth) * np.array([1.0, *np.tan(rng.uniform(-widest, widest, 2))])
        for depth, widest in ((FAR_M, 0.25), (NEAR_M, 0.20))  # [rad], pan and tilt
    )
    takes_s = float(np.linalg.norm(far - near)) / 0.19  # [m/s], in the mean; 0.3 at most
    turn, phase = 2 * np.pi * rng.uniform(0.25, 0.5, 3), rng.uniform(0, 2 * np.pi, 3)

    def path(time_s: float) -> Array:
        done = (1 - np.cos(np.pi * min(time_s / takes_s, 1.0))) / 2
        sway_m = 0.012 * np.sin(turn * time_s + phase)
        return far + done * (near - far) + sway_m

    return path


def run_trial(
    twin: Twin,
    settings: ReachSettings,
    run: int,
    path_head: Callable[[float], Array],
    T_body_arm: Array,
    *,
    geometry: VisualGeometry | None = None,
    watch: Callable[[ReachState, Frame | None], None] = lambda state, frame: None,
) -> Trial:
    """Hold out one object until the hand has closed or the time is over.

    The number of the run is the seed of the noise. The object's path is its position (3,) [m] in
    frame head by time [s]; T_body_arm is the true pose (4, 4) of the arm relative to its assumed
    one. The geometry is that of an earlier trial. `watch` gets each state and its frame.
    """
    head = SimulatedHead(twin, run, path_head)
    head.hand = hand = SimulatedHand(twin, settings.home, T_body_arm)
    samples: list[DepthSample] = []

    def keep(state: ReachState, frame: Frame | None) -> None:
        sample = None if frame is None else depth_sample(twin, settings.gaze, state.gaze, frame)
        # Closing fingers hide the object's edges, an error that does not depend on distance.
        if sample is not None and state.phase not in (ReachPhase.CLOSE, ReachPhase.HELD):
            samples.append(sample)
        watch(state, frame)

    at_rest = np.zeros(len(settings.gaze.joints))
    state = initial_reach_state(settings, at_rest, hand.read(), head.now_s(), geometry=geometry)
    state = run_reach(head, hand, settings, state, LONGEST_S, watch=keep)
    miss = unaided = np.inf
    if state.phase is ReachPhase.HELD:
        where = twin.true_object()
        miss = float(np.linalg.norm(twin.true_hand()[:3, 3] - where))
        if state.object is not None:
            unaided = float(np.linalg.norm(hand.true_point(state.object) - where))
    learned = state.gaze.geometry
    return Trial(state.phase, head.now_s(), miss, unaided, tuple(samples), learned)


def summary(trials: list[Trial]) -> Summary:
    """Compute the statistics of trials."""
    miss = np.array([trial.miss_m for trial in trials])
    closed = np.sort(miss[np.isfinite(miss)]) * 1e3
    unaided = [trial.unaided_m for trial in trials if np.isfinite(trial.unaided_m)]
    some = len(closed) > 0
    return Summary(
        trials=len(trials),
        held=len(closed),
        within=float(np.mean(miss <= WITHIN_M)),
        median_mm=float(np.median(closed)) if some else None,
        p95_mm=p95(closed) if some else None,
        worst_mm=float(closed[-1]) if some else None,
        unaided_median_mm=float(np.median(unaided)) * 1e3 if unaided else None,
        seconds_p95=p95([trial.seconds for trial in trials]),
        by_distance=bin_by_range([trial.samples for trial in trials]),
    )


def grasp(
    experiment: Experiment, progress: Progress = silent, *, trials: int = 10
) -> tuple[Summary, list[Trial]]:
    """Calibrate the twin, and hold out objects to it, each with a mounting error of the arm.

    The folder gets grasp.json, and the recording grasp.rrd of the first three trials. Raises
    VergenceError if an argument is out of range, or a file cannot be written.
    """
    check_trials(trials)
    seed = experiment.seed
    with (
        calibrated_twin(experiment, progress) as (twin, gaze),
        recorded(experiment, "grasp", twin, gaze, reach_m=FAR_M[0], speed=0.5, hand=True) as (
            watch,
            finish,
        ),
    ):
        settings = ReachSettings(gaze=gaze)

        def record(state: ReachState, frame: Frame | None) -> None:
            if len(made) < 3 or experiment.viewer:  # files stay small
                watch(state.gaze, frame, {"hand": state.phase.value}, state.hand)

        made: list[Trial] = []
        known = initial_geometry(twin, gaze)
        for number in range(1, trials + 1):
            progress("grasp, trials", number - 1, trials)
            arguments = hand_held(seed, number), arm_mounting_error(seed, number)
            made.append(run_trial(twin, settings, number, *arguments, geometry=known, watch=record))
            known = made[-1].geometry
        progress("grasp, trials", trials, trials)
        found = summary(made)
        finish(found)
    return found, made
