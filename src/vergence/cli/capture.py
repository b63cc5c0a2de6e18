"""The command that captures a calibration recording with a head that is there."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import vergence as vg
from vergence.cli.calibration import check_replaceable, save_calibration, void_file
from vergence.cli.options import (
    NO_VIEWER,
    PAPER,
    Flag,
    Optional,
    TwinArguments,
    TwinOptions,
    ViewerArguments,
    check_outputs,
)
from vergence.cli.report import Report
from vergence.cli.terminal import invocation, progress_bars, viewing
from vergence.errors import VergenceError
from vergence.files import finished_files

if TYPE_CHECKING:
    from vergence.data.dataset import Frame
    from vergence.live.capture import CaptureSettings, CaptureState
    from vergence.live.driver import Driver
    from vergence.live.session import Look
    from vergence.viewer.live import Viewer

TELL_S = 3.0
"""Time after which the next step is said again if it has changed [s]."""


def capture(
    *,
    out: Path,
    driver: Optional[str] = None,
    twin: Flag = False,
    folder: Optional[Path] = None,
    goal_mm: float = 3.0,
    at_m: float = 0.5,
    most_views: int = 150,
    calibration: Optional[Path] = None,
    options: TwinArguments = PAPER,
    viewer: ViewerArguments = NO_VIEWER,
) -> Report:
    """Capture a calibration recording: be told where to hold the board, until the head is accurate.

    Args:
        out: Folder of the dataset. One that an interrupted capture has left is continued.
        driver: Driver of the head, such as my_head.py:MyHead (docs/own_driver.md).
        twin: Use the twin, and a simulated person with a board.
        folder: Folder with dataset.json to which another program adds images and lines of
            frames.csv.
        goal_mm: Wanted accuracy of points by the calibration, in its worst direction: standard
            deviation [mm].
        at_m: Distance of these points [m].
        most_views: Number of views after which the capture ends.
        calibration: JSON file of the calibration; default: calibration.json in the folder. A VOID
            one does not replace an earlier file.
        options: Options of the twin.
        viewer: Options of the viewer.
    """
    from vergence.calibration.calibrate import calibrate
    from vergence.cli.calibration_report import calibration_report
    from vergence.data.growing import add_rows, begin_dataset
    from vergence.live.capture import CaptureSettings, begin_capture
    from vergence.live.kept import kept_in
    from vergence.live.session import run_capture

    sources = [driver is not None, twin, folder is not None]
    if sum(sources) != 1:
        raise VergenceError(
            "A capture is of one head: name --driver MODULE:NAME, --twin or --folder DIR; found "
            f"{sum(sources)} of them."
        )
    if replace(options, seed=PAPER.seed) != PAPER and not twin:
        raise VergenceError("Options of the twin are given without --twin.")
    calibration = calibration or out / "calibration.json"
    check_outputs(calibration, void_file(calibration), inputs=[options.head])
    check_replaceable(calibration)
    with viewing(viewer) as (opened, shown), _head(driver, folder, options, out) as (head, follow):
        settings = CaptureSettings(
            head.description,
            head.limits,
            goal_mm / 1e3,
            at_m,
            most_views=most_views,
            seed=options.seed,
        )
        growing = begin_dataset(out, settings.description)
        kept = kept_in(vg.load_dataset(out)) if growing.rows else ()

        def keep(rows: tuple[vg.DatasetRow, ...]) -> None:
            nonlocal growing
            growing = add_rows(growing, *rows)

        state, tell = begin_capture(settings, kept), _teller(settings)
        print("Waiting for the first frame.", file=sys.stderr)
        try:
            with _shown(settings, state, opened) as show:

                def look(state: CaptureState, frame: Frame) -> None:
                    tell(state)
                    show(state, frame)
                    follow(state, frame)

                state = run_capture(head, settings, state, keep, look=look)
        except KeyboardInterrupt:
            finished_files[:] = [out] if growing.rows else []
            print("The same command goes on from here.", file=sys.stderr)
            raise
    moving = len(state.kept) - state.views
    print(
        f"Captured {state.views} views, and {moving} frames of moving eyes: {state.finished}.",
        file=sys.stderr,
    )
    with progress_bars() as progress:
        result = calibrate(vg.load_dataset(out), progress=progress)
    saved = save_calibration(result, calibration)
    again = invocation("vergence", "calibrate", out, "--out", calibration, "--report", "report")
    files = f"{saved} The recording is {out}.\nTo see the images and residuals: {again}"
    return replace(calibration_report(result), files=files, shown=shown)


def _teller(settings: CaptureSettings) -> Callable[[CaptureState], None]:
    """Make the function that prints the status when it has changed."""
    from vergence.live.status import next_step, status

    said: tuple[object, ...] = ()
    step, said_s = "", -math.inf

    def tell(state: CaptureState) -> None:
        nonlocal said, step, said_s
        # A board that moves changes the words of the next step with each frame.
        reached = len(state.kept), state.estimate is None, state.finished, state.sweep is None
        late, now = state.watched.time_s > said_s + TELL_S, next_step(settings, state)
        if reached != said or (late and now != step):
            print(status(settings, state), file=sys.stderr)
            said, step, said_s = reached, now, state.watched.time_s

    return tell


@contextmanager
def _shown(settings: CaptureSettings, state: CaptureState, viewer: Viewer | None) -> Iterator[Look]:
    """Give a `with` block the function that shows a capture in a viewer; None: nothing is shown."""
    if viewer is None:
        yield lambda state, frame: None
        return
    from vergence.viewer.capture import capture_blueprint, capture_log
    from vergence.viewer.live import open_feed

    with open_feed("capture", capture_blueprint(state.head), viewer=viewer) as feed:
        yield capture_log(feed, settings)


@contextmanager
def _head(
    driver: str | None, folder: Path | None, options: TwinOptions, out: Path
) -> Iterator[tuple[Driver, Look]]:
    """Open the head for a `with` block; also yield the function that moves its board."""
    from vergence.data.description import DESCRIPTION
    from vergence.live.driver import open_driver

    if driver is None and folder is None:
        from vergence.demos.simulated_person import TwinBeforePerson
        from vergence.twin.head import Twin
        from vergence.twin.head_model import load_head_model
        from vergence.twin.profile import load_profile

        profile, model = load_profile(options.profile), load_head_model(options.head)
        with Twin(profile, head=model, seed=options.seed, scene=options.scene) as twin:
            person = TwinBeforePerson(twin, options.seed)
            try:
                yield person, person.follow
            finally:
                if (out / DESCRIPTION).exists():
                    person.write_truth(out)
        return
    if folder is not None:
        from vergence.live.folder import FolderHead

        opened: Driver = FolderHead(folder)
    else:
        opened = open_driver(str(driver))
    try:
        yield opened, getattr(opened, "follow", lambda state, frame: None)
    finally:
        opened.close()
