"""Take an object from somebody's hand (the paper's Fig. 12).

Somebody brings an object from afar and holds it out, not quite still. The eyes stay on it, and the
hand of `experiments.hand` is sent by `vergence.reach`, from frames, readings and its own encoders.
The truth is asked only for where it closed, and for how wrong the eyes were at which distance.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.demos.depth_error_by_range import Distance, Sight, by_distance, sight
from vergence.demos.recording import recorded
from vergence.errors import VergenceError
from vergence.files import write_whole
from vergence.gaze.commands import HEAD_JOINTS
from vergence.geometry.head import T_head_base
from vergence.geometry.se3 import inverse, transform
from vergence.reach.controller import Phase, Settings, State, start
from vergence.reach.controller import grasp as run_loop
from vergence.twin.hand import HeadWithHand, TwinHand, roughly_mounted
from vergence.twin.head import Twin
from vergence.twin.profile import ErrorProfile
from vergence.twin.simulated_robot import calibrated

WITHIN_M = 0.010
"""Of the object's centre, in which the hand is to close."""
FAR_M, NEAR_M = (1.0, 1.3), (0.38, 0.55)
"""From the head, where the object comes from and where it is held out."""
FAR_RAD, NEAR_RAD = 0.25, 0.20
"""Farthest from straight ahead, sideways and in height."""
BROUGHT_M_S = 0.19
"""In the mean; 0.3 m/s at the fastest."""
SWAY_M, SWAY_HZ = 0.012, (0.25, 0.5)
"""Of the hand that holds the object, along each axis."""
LONGEST_S = 12.0
MOST_TRIALS = 10_000
RECORDED = 3
"""The trials that are recorded: more of the same would only make the file large."""


@dataclass(frozen=True, eq=False)
class Trial:
    """One object that was held out."""

    phase: Phase
    """At the end."""
    seconds: float
    miss_m: float
    """From the centre of the closed hand to the object's; infinity: it did not close."""
    unaided_m: float
    """The same, had the hand gone by its encoders to where the eyes saw the object."""
    sights: tuple[Sight, ...]
    """How wrong the eyes were, frame by frame, until the fingers began to close."""


@dataclass(frozen=True)
class Summary:
    """What the trials came to; written as JSON."""

    trials: int
    held: int
    """In which the hand closed, by its own decision."""
    within: float
    """Share of all trials in which it closed within WITHIN_M of the object's centre."""
    median_mm: float | None
    """Of the distances from the object's centre, of the trials in which it closed."""
    p95_mm: float | None
    worst_mm: float | None
    unaided_median_mm: float | None
    """Of the distances, had the hand not been seen, at the same moments."""
    seconds_p95: float
    by_distance: tuple[Distance, ...]


def held_out(seed: int, run: int) -> Callable[[float], Array]:
    """Return a random path of a hand-held object: where it is (3,) [m] in frame head, at a time."""
    rng = np.random.default_rng([seed, 9, run])
    far, near = (
        rng.uniform(*depth) * np.array([1.0, *np.tan(rng.uniform(-widest, widest, 2))])
        for depth, widest in ((FAR_M, FAR_RAD), (NEAR_M, NEAR_RAD))
    )
    takes_s = float(np.linalg.norm(far - near)) / BROUGHT_M_S
    turn, phase = 2 * np.pi * rng.uniform(*SWAY_HZ, 3), rng.uniform(0, 2 * np.pi, 3)

    def path(time_s: float) -> Array:
        done = (1 - np.cos(np.pi * min(time_s / takes_s, 1.0))) / 2
        return far + done * (near - far) + SWAY_M * np.sin(turn * time_s + phase)

    return path


def run_trial(
    twin: Twin,
    settings: Settings,
    run: int,
    path_head: Callable[[float], Array | None],
    T_body_arm: Array,
    *,
    longest_s: float = LONGEST_S,
    watch: Callable[[State, Frame | None], None] = lambda state, frame: None,
) -> Trial:
    """Hold out one object, until the hand has closed or time is up.

    Args:
        twin: the head.
        settings: of the controller.
        run: number of the trial, for the noise.
        path_head: where the object is (3,) [m] in frame head; None: it is hidden.
        T_body_arm: (4, 4) of the arm against where it is believed to be.
        longest_s: when time is up.
        watch: is shown every state and its frame.
    """
    T_lbase_head = inverse(T_head_base(twin.truth, "left"))

    def path(time_s: float) -> Array | None:
        where = path_head(time_s)
        return None if where is None else transform(T_lbase_head, where)

    head = HeadWithHand(twin, run, path, limits=settings.gaze.limits)
    head.hand = hand = TwinHand(twin, settings.home, T_body_arm)
    sights: list[Sight] = []

    def keep(state: State, frame: Frame | None) -> None:
        seen = None if frame is None else sight(twin, settings.gaze, state.gaze, frame)
        # Fingers that close hide the object's edges: that says nothing of the distance.
        if seen is not None and state.phase not in (Phase.CLOSE, Phase.HELD):
            sights.append(seen)
        watch(state, frame)

    state = start(settings, np.zeros(len(HEAD_JOINTS)), hand.read(), head.now_s())
    state = run_loop(head, hand, settings, state, longest_s, watch=keep)
    miss = unaided = np.inf
    if state.phase is Phase.HELD:
        miss = float(np.linalg.norm(twin.true_hand()[:3, 3] - twin.true_object()))
        if state.object is not None:
            unaided = float(np.linalg.norm(hand.true_point(state.object) - twin.true_object()))
    return Trial(state.phase, head.now_s(), miss, unaided, tuple(sights))


def summary(trials: list[Trial]) -> Summary:
    """Return what the trials came to."""
    miss = np.array([trial.miss_m for trial in trials])
    closed = np.sort(miss[np.isfinite(miss)]) * 1e3
    unaided = [trial.unaided_m for trial in trials if np.isfinite(trial.unaided_m)]
    seconds = [trial.seconds for trial in trials]
    some = len(closed) > 0
    return Summary(
        trials=len(trials),
        held=len(closed),
        within=float(np.mean(miss <= WITHIN_M)),
        median_mm=float(np.median(closed)) if some else None,
        p95_mm=float(np.quantile(closed, 0.95, method="higher")) if some else None,
        worst_mm=float(closed[-1]) if some else None,
        unaided_median_mm=float(np.median(unaided)) * 1e3 if unaided else None,
        seconds_p95=float(np.quantile(seconds, 0.95, method="higher")),
        by_distance=by_distance([trial.sights for trial in trials]),
    )


def grasp(
    *,
    trials: int = 10,
    seed: int = 0,
    profile: ErrorProfile,
    out: Path | None = None,
    watch: Callable[[State, Frame | None], None] = lambda state, frame: None,
    done: Callable[[], None] = lambda: None,
) -> tuple[Summary, list[Trial]]:
    """Calibrate the twin, and hold out objects to it.

    Args:
        trials: how many; each has its own path, and its own place of the arm.
        seed: of everything random.
        profile: imperfections of the head.
        out: folder for grasp.json, and grasp.rrd of the first trials; None: nothing is written.
        watch: is shown every state and its frame.
        done: called after each trial.

    Raises:
        VergenceError: an argument cannot be met, or the folder cannot be written.
    """
    if not 1 <= trials <= MOST_TRIALS:
        raise VergenceError(f"Asked for {trials} trials; from 1 to {MOST_TRIALS} can be made.")
    if seed < 0:
        raise VergenceError(f"The seed must be a whole number from 0, found {seed}.")
    made = []
    with Twin(profile, seed=seed) as twin, ExitStack() as stack:
        settings = Settings(gaze=calibrated(twin, seed))
        shown, report, title = [watch], [], f"grasp, profile {profile.name}, seed {seed}"
        if out is not None:
            record, report = stack.enter_context(
                recorded(
                    out / "grasp.rrd",
                    twin,
                    settings.gaze,
                    title=title,
                    reach_m=FAR_M[0],
                    speed=0.5,
                    hand=True,
                )
            )

            def recording(state: State, frame: Frame | None) -> None:
                record(state.gaze, frame, lanes={"hand": state.phase.value}, hand=state.hand)

            shown.append(recording)

        def show(state: State, frame: Frame | None) -> None:
            for look in shown:
                look(state, frame)

        for run in range(1, trials + 1):
            path, T_body_arm = held_out(seed, run), roughly_mounted(seed, run)
            made.append(run_trial(twin, settings, run, path, T_body_arm, watch=show))
            if run == RECORDED:
                shown[1:] = []
            done()
        found = summary(made)
        report += [f"# {title}", "", *as_markdown(found)]
    if out is not None:
        write_whole(out / "grasp.json", json.dumps(asdict(found), indent=1) + "\n")
    return found, made


def as_markdown(found: Summary) -> list[str]:
    """Return the lines of a report."""
    lines = [
        f"The hand closed within {1e3 * WITHIN_M:.0f} mm of the object's centre in "
        f"{found.within:.0%} of {found.trials} trials.",
        "",
    ]
    if found.median_mm is not None and found.unaided_median_mm is not None:
        lines += [
            f"- distance from the centre: {found.median_mm:.1f} mm in the median, "
            f"{found.worst_mm:.1f} mm at worst",
            f"- unseen, by its encoders alone: {found.unaided_median_mm:.0f} mm",
        ]
    lines += ["", "| distance | depth error, rms | its scatter | Eq. 20 |", "|---|---|---|---|"]
    return lines + [
        f"| {d.from_m:.2f}-{d.to_m:.2f} m | {d.depth_rms_mm:.3g} mm | "
        f"{d.depth_scatter_mm:.3g} mm | {d.eq20_mm:.3g} mm |"
        for d in found.by_distance
    ]
