"""What the demos share: checked arguments, a calibrated twin, its recording, and the summary."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from vergence.demos.recording import Watch, recorded
from vergence.errors import VergenceError
from vergence.files import write_whole
from vergence.gaze.state import GazeSettings
from vergence.twin.head import Twin
from vergence.twin.profile import ErrorProfile
from vergence.twin.simulated_robot import calibrate_twin

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

MOST_TRIALS = 10_000


def check_trials(trials: int) -> None:
    """Raise a VergenceError unless a number of trials can be made."""
    if not 1 <= trials <= MOST_TRIALS:
        raise VergenceError(f"Asked for {trials} trials; from 1 to {MOST_TRIALS} can be made.")


@contextmanager
def calibrated_twin(
    name: str,
    profile: ErrorProfile,
    seed: int,
    out: Path | None,
    *,
    reach_m: float,
    speed: float = 1.0,
    hand: bool = False,
) -> Iterator[tuple[Twin, GazeSettings, Watch, list[str]]]:
    """Build and calibrate a twin, and record it in a `with` block.

    Args:
        name: of the demo.
        profile: imperfections of the head.
        seed: of everything random.
        out: folder for the recording, `name`.rrd; None: nothing is recorded.
        reach_m: greatest distance of objects [m], for the 3-D view.
        speed: of the playback, in recorded seconds a second.
        hand: whether the demo has a hand.

    Yields:
        The twin; the settings of its gaze controller; the function to call with every state that is
        to be recorded; and a list for the lines of the recording's report, in Markdown.

    Raises:
        VergenceError: the seed is negative, or the recording cannot be written.
    """
    if seed < 0:
        raise VergenceError(f"The seed must be a whole number from 0, found {seed}.")
    with Twin(profile, seed=seed) as twin:
        settings = calibrate_twin(twin, seed)
        if out is None:
            yield twin, settings, lambda state, frame, /, **_: None, []
            return
        title = f"{name}, profile {profile.name}, seed {seed}"
        with recorded(
            out / f"{name}.rrd",
            twin,
            settings,
            title=title,
            reach_m=reach_m,
            speed=speed,
            hand=hand,
        ) as (watch, report):
            report += [f"# {title}", ""]
            yield twin, settings, watch, report


def write_summary(out: Path | None, name: str, summary: DataclassInstance) -> None:
    """Write a demo's summary to `name`.json in a folder; None: nothing is written.

    Raises:
        VergenceError: the file cannot be written.
    """
    if out is not None:
        write_whole(out / f"{name}.json", json.dumps(asdict(summary), indent=1) + "\n")
