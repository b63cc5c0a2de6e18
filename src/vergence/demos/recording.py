"""Record a gaze controller on the twin: its states and the truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.gaze.commands import EYE_READINGS
from vergence.gaze.state import GazeSettings, GazeState
from vergence.geometry.head import T_body_base
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import inverse, transform
from vergence.twin.appearance import visual_geoms
from vergence.twin.head import Twin
from vergence.twin.simulated_robot import FRAME_S, foveal_errors
from vergence.viewer.gaze import Moment, log_gaze_frame, log_gaze_series, log_gaze_styles, moment
from vergence.viewer.layouts import gaze_blueprint
from vergence.viewer.recording import Recording, log_report, recording_file
from vergence.viewer.seen import log_seen_styles

SERIES = 1000
"""Number of frames whose curves are recorded at once, which bounds the memory of a long run."""
Watch = Callable[[GazeState, Frame | None, Mapping[str, str], Array | None], None]
"""A function that records a state and its frame, further phases by lane, and the position (3,) [m]
of a hand in frame body. Without a frame it records nothing."""


@contextmanager
def recorded(
    out: Path | None,
    name: str,
    twin: Twin,
    settings: GazeSettings,
    *,
    seed: int,
    reach_m: float,
    speed: float = 1.0,
    hand: bool = False,
) -> Iterator[tuple[Watch, list[str]]]:
    """Record runs in a `with` block to `name`.rrd in a folder; None: nothing is recorded.

    Runs, each with its time from zero, follow each other on one timeline. Images are recorded of
    the frames that have those of all cameras.

    Args:
        out: folder.
        name: of the demo.
        twin: the head, whose truth is drawn with the controller's estimates.
        settings: of the controller.
        seed: of the head, for the title.
        reach_m: maximum distance of objects [m], for the 3-D view.
        speed: of the playback, in recorded seconds a second.
        hand: whether there is a hand.

    Yields:
        The function to call, and a list for the lines of the report in Markdown.

    Raises:
        VergenceError: the file cannot be written.
    """
    title = f"{name}, profile {twin.profile.name}, seed {seed}"
    report = [f"# {title}", ""]
    if out is None:
        yield lambda *_: None, report
        return
    head = settings.calibration
    seen = settings.geometry == "seen"
    layout = gaze_blueprint(title, head, reach_m=reach_m, speed=speed, hand=hand, seen=seen)
    file = out / f"{name}.rrd"
    with recording_file(file, title, layout, head, visual_geoms(twin.model)) as rec:
        recorder = _Recorder(rec, twin, settings)
        yield recorder.watch, report
        recorder.record_series()
        log_report(rec, "\n".join(report))


class _Recorder:
    """Records frame after frame, and the curves of SERIES frames at a time."""

    def __init__(self, rec: Recording, twin: Twin, settings: GazeSettings):
        self._rec, self._twin, self._settings = rec, twin, settings
        self._count = 0  # frames of all runs
        self._moments: list[Moment] = []  # frames whose curves are not recorded yet
        self._lanes: Mapping[str, str] = {}
        # Time of the latest frame in its run, and of the start of that run on the timeline.
        self._latest_s, self._start_s = -np.inf, 0.0

    def watch(
        self, state: GazeState, frame: Frame | None, lanes: Mapping[str, str], hand: Array | None
    ) -> None:
        """Record a state and its frame: see `Watch`."""
        if frame is None:
            return
        rec, twin, settings = self._rec, self._twin, self._settings
        head = settings.calibration
        if frame.time_s < self._latest_s:  # the next run
            self._start_s += self._latest_s + FRAME_S
        self._latest_s = frame.time_s
        time_s = self._start_s + frame.time_s
        T_body_lbase = T_body_base(head, "left", frame.neck_angles)
        if not self._count:
            log_gaze_styles(rec, head, twin.T_world_lbase() @ inverse(T_body_lbase))
            if state.geometry is not None:
                log_seen_styles(rec, head, state.geometry.state)
        poses = twin.body_poses()
        where, errors_px = twin.true_object(), foveal_errors(twin, settings)
        if poses["object"][2, 3] < 0:  # hidden, below the floor
            where, errors_px = np.full(3, np.nan), np.full(len(settings.eyes), np.nan)
        eyes = twin.true_angles()[EYE_READINGS]
        log_gaze_frame(
            rec,
            settings,
            state,
            frame,
            time_s=time_s,
            index=self._count,
            pictures=len(frame.images) == len(head.cameras),
            body_poses=poses,
            truth={name: project_point(twin.truth, name, eyes, where) for name in frame.images},
        )
        truth = transform(T_body_lbase, where)
        observed = {"lanes": lanes, "truth": truth, "errors_px": errors_px, "hand": hand}
        self._moments.append(moment(settings, state, frame, time_s, **observed))
        self._count += 1
        if len(self._moments) == SERIES:
            self.record_series()

    def record_series(self) -> None:
        """Record the curves of the frames since the last time."""
        log_gaze_series(
            self._rec,
            self._moments,
            eyes=tuple(self._settings.eyes),
            joints=self._settings.joints,
            first=self._count - len(self._moments),
            lanes=self._lanes,
        )
        if self._moments:
            self._lanes = self._moments[-1].lanes
        self._moments.clear()
