"""Turn the eyes to objects that appear, until they are in the middle of both foveas (Sec. III).

The twin is calibrated by the paper's method; then an object appears somewhere, the eyes look
straight ahead, and the controller of `vergence.gaze` does the rest from frames alone. The truth
is asked only for how far off the object ended.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.demos.recording import recorded
from vergence.errors import VergenceError
from vergence.files import write_whole
from vergence.gaze.commands import HEAD_JOINTS
from vergence.gaze.controller import NARROW, Phase, Settings, State, look, start
from vergence.geometry.head import T_head_base
from vergence.geometry.se3 import inverse, transform
from vergence.twin.head import Twin
from vergence.twin.occlusion import in_sight
from vergence.twin.profile import ErrorProfile
from vergence.twin.simulated_robot import FRAME_S, Delivery, TwinHead, calibrated, foveal_errors
from vergence.viewer.plots_depth import depth

WITHIN_S = 0.5
DIRECTION_RAD = float(np.radians(20))
DEPTH_M = (0.3, 1.5)
OBJECT_M = 0.02
"""Radius of what appears."""
SETTLED_PX = 8.0
"""Within which both eyes must stay to the end to count as settled."""
MOST_TRIALS = 10_000
PLAYBACK = 0.25
"""Recorded seconds a second: a saccade is over in 60 ms."""
RECORDED = 10
"""Trials that are recorded: more make the recording large, not clearer."""


@dataclass(frozen=True)
class Summary:
    """What the trials came to; written as JSON."""

    trials: int
    median_px: float
    """Of the distances at the end: of the trials, the worse eye of each."""
    p95_px: float
    settle_s_p95: float | None
    """From the appearance until both eyes stay within SETTLED_PX; none: too many never do."""
    lost: int
    """Trials at whose end the object was not found in both narrow images."""


@dataclass(frozen=True, eq=False)
class Trial:
    """One object that appeared."""

    target_head: Array
    """(3,) where it is [m], in frame head."""
    time_s: Array
    """(N,) of the frames, since it appeared."""
    errors_px: Array
    """(N, 2) how far it truly was from the centres of the left and the right narrow image."""
    phases: tuple[str, ...]
    """(N,) what the controller said it was doing, once it had the frame."""
    lost: bool

    @property
    def final_px(self) -> float:
        """The worse eye's distance at the end."""
        return float(self.errors_px[-1].max())

    @property
    def settle_s(self) -> float:
        """When both eyes were there to stay; infinity: not until the end."""
        outside = np.flatnonzero(~(self.errors_px.max(axis=1) <= SETTLED_PX))
        first = 0 if not len(outside) else outside[-1] + 1
        return float(self.time_s[first]) if first < len(self.time_s) else np.inf


def targets(
    trials: int,
    seed: int,
    *,
    free: Callable[[Array], np.ndarray] = lambda places: np.ones(len(places), bool),
) -> Array:
    """Return where the objects appear (trials, 3) [m], in frame head.

    Directions are spread evenly over +-20 degrees of pan and of tilt, depths evenly over theirs.

    Args:
        trials: how many.
        seed: of the places.
        free: tells of places (N, 3) whether an object can be seen there (N,); where not, another
            place is drawn.
    """
    rng = np.random.default_rng([seed, 5])

    def draw(count: int) -> Array:
        pan, tilt = rng.uniform(-DIRECTION_RAD, DIRECTION_RAD, (2, count))
        depth = rng.uniform(*DEPTH_M, count)
        return depth[:, None] * np.stack([np.ones(count), np.tan(pan), -np.tan(tilt)], axis=-1)

    where = draw(trials)
    while not (good := free(where)).all():
        where[~good] = draw(int((~good).sum()))
    return where


def run_trial(
    twin: Twin,
    settings: Settings,
    run: int,
    target_head: Array,
    *,
    watch: Callable[[State, Frame | None], None] = lambda state, frame: None,
) -> Trial:
    """Let one object appear, and look at it for half a second.

    Args:
        twin: the head.
        settings: of the controller.
        run: number of the trial, for the noise.
        target_head: (3,) where the object is [m].
        watch: is shown every state and its frame.
    """
    T_lbase_head = inverse(T_head_base(twin.truth, "left"))
    target = transform(T_lbase_head, target_head)
    delivery = Delivery(all_every=1)  # a trial is short: look at all of it
    head = TwinHead(twin, run, lambda _: target, limits=settings.limits, delivery=delivery)
    state = start(settings, np.zeros(len(HEAD_JOINTS)), head.now_s())
    times: list[float] = []
    errors: list[Array] = []
    phases: list[str] = []

    def keep(state: State, frame: Frame | None) -> None:
        if frame is not None:
            times.append(frame.time_s)
            errors.append(foveal_errors(twin, settings.calibration))
            phases.append(state.phase.value)
        watch(state, frame)

    state = look(head, settings, state, WITHIN_S - FRAME_S, watch=keep)
    in_view = [np.isfinite(state.pixels.get(name, np.array(np.nan))).all() for name in NARROW]
    lost = state.phase is Phase.LOST or not all(in_view)
    return Trial(target_head, np.array(times), np.array(errors), tuple(phases), lost)


def summary(trials: list[Trial]) -> Summary:
    """Return what the trials came to."""
    final = np.array([trial.final_px for trial in trials])
    settled = np.array([trial.settle_s for trial in trials])
    slow = float(np.quantile(settled, 0.95, method="higher"))
    return Summary(
        trials=len(trials),
        median_px=float(np.median(final)),
        p95_px=float(np.quantile(final, 0.95, method="higher")),
        settle_s_p95=slow if np.isfinite(slow) else None,
        lost=sum(trial.lost for trial in trials),
    )


def foveate(
    *,
    trials: int = 100,
    seed: int = 0,
    profile: ErrorProfile,
    out: Path | None = None,
    done: Callable[[], None] = lambda: None,
) -> tuple[Summary, list[Trial]]:
    """Calibrate the twin and let objects appear.

    Args:
        trials: how many.
        seed: of everything random.
        profile: imperfections of the head.
        out: folder for foveate.json and foveate.rrd, which shows the first RECORDED trials one
            after the other, and depth.png; None: nothing is written.
        done: called after each trial.

    Raises:
        VergenceError: an argument cannot be met, or the folder cannot be written.
    """
    if not 1 <= trials <= MOST_TRIALS:
        raise VergenceError(f"Asked for {trials} trials; from 1 to {MOST_TRIALS} can be made.")
    if seed < 0:
        raise VergenceError(f"The seed must be a whole number from 0, found {seed}.")
    made = []
    with Twin(profile, seed=seed) as twin:
        settings = calibrated(twin, seed)
        T_lbase_head = inverse(T_head_base(twin.truth, "left"))

        def free(places: Array) -> np.ndarray:  # there is furniture in the room
            return in_sight(twin, transform(T_lbase_head, places), margin_m=OBJECT_M)

        where = targets(trials, seed, free=free)
        if out is not None:
            depth(out / "depth.png", settings.calibration)
            title = f"foveate, profile {profile.name}, seed {seed}"
            with recorded(
                out / "foveate.rrd",
                twin,
                settings,
                title=title,
                reach_m=DEPTH_M[1],
                speed=PLAYBACK,
            ) as (record, report):
                for run, target in enumerate(where[:RECORDED]):
                    watch = partial(record, lanes={"object": f"{run + 1}"})
                    made.append(run_trial(twin, settings, run + 1, target, watch=watch))
                    done()
                report += [f"# {title}", "", *as_markdown(made)]
        for run, target in enumerate(where[len(made) :], start=len(made)):
            made.append(run_trial(twin, settings, run + 1, target))
            done()
    found = summary(made)
    if out is not None:
        write_whole(out / "foveate.json", json.dumps(asdict(found), indent=1) + "\n")
    return found, made


def as_markdown(trials: list[Trial]) -> list[str]:
    """Return the lines of a report on a few trials."""
    rows = [
        f"| {number} | {np.linalg.norm(trial.target_head):.2f} | {trial.errors_px[0].max():.0f} "
        f"| {trial.final_px:.2f} | {trial.settle_s:.2f} |"
        for number, trial in enumerate(trials, start=1)
    ]
    return [
        f"The first {len(trials)} objects, each looked at for {WITHIN_S} s.",
        "",
        "| object | distance [m] | off at first [px] | at last [px] | within 8 px after [s] |",
        "|---|---|---|---|---|",
        *rows,
    ]
