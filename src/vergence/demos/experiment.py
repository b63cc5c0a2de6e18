"""Settings, calibrated twin and recording that the demos have in common."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.errors import VergenceError, check_seed
from vergence.files import as_json, results_folder, write_json
from vergence.gaze.state import GazeSettings, GazeState
from vergence.geometry.head import base_pose_in_body
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import inverse, transform
from vergence.progress import Progress
from vergence.self_calibration.calibrator import Geometry, VisualGeometry, initial_visual_geometry
from vergence.twin.appearance import visual_geoms
from vergence.twin.head import Twin
from vergence.twin.head_model import load_head_model
from vergence.twin.profile import ErrorProfile
from vergence.twin.scene import Scene
from vergence.twin.simulated_robot import (
    FRAME_S,
    calibrate_twin,
    foveal_errors_at,
    learn_by_looking,
)
from vergence.viewer.gaze import Observed, log_gaze, log_gaze_styles, log_states
from vergence.viewer.layouts import gaze_blueprint
from vergence.viewer.live import Feed, Viewer, open_feed
from vergence.viewer.recording import Recording, log_report
from vergence.viewer.seen import log_seen_styles

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

LOOKING = 100_000
"""Number of the run in which the twin looks around first, beyond those of trials."""


@dataclass(frozen=True)
class Experiment:
    """The settings that foveate, track and grasp have in common."""

    profile: ErrorProfile
    """Imperfections of the head."""
    seed: int = 0
    """Seed of everything random."""
    scene: Scene = "room"
    """What the head looks at."""
    geometry: Geometry = "joints"
    """How objects are located. With "seen" the head looks around first, and keeps what it learns
    from trial to trial."""
    out: Path | None = None
    """Folder for the summary as JSON, and for a recording; None: nothing is written."""
    head: Path | None = None
    """The head's head.toml; None: the default head."""
    viewer: Viewer | None = None
    """What shows it while it goes on."""

    def __post_init__(self) -> None:
        check_seed(self.seed)

    def twin(self) -> Twin:
        """Build the twin."""
        head = load_head_model(self.head)
        return Twin(self.profile, head=head, seed=self.seed, scene=self.scene)


def p95(values: Sequence[float] | Array) -> float:
    """Select the 95 % quantile among values."""
    return float(np.quantile(values, 0.95, method="higher"))


@contextmanager
def calibrated_twin(
    experiment: Experiment, progress: Progress
) -> Iterator[tuple[Twin, GazeSettings]]:
    """Calibrate a twin for a `with` block, and make the settings of its gaze controller.

    The folder of results is marked as unfinished from before the calibration until the block ends.
    """
    with (
        results_folder(experiment.out),
        experiment.twin() as twin,
    ):
        settings = calibrate_twin(twin, experiment.seed, progress)
        yield twin, replace(settings, geometry=experiment.geometry)


def initial_geometry(twin: Twin, settings: GazeSettings) -> VisualGeometry | None:
    """Let the twin look around if its geometry is seen; None: it is that of the joints."""
    if settings.geometry == "joints":
        return None
    left, right = settings.wide
    geometry = initial_visual_geometry(settings.calibration, cameras=(left, right))
    return learn_by_looking(twin, geometry, run=LOOKING)


def check_trials(trials: int) -> None:
    """Raise VergenceError unless a number of trials can be made."""
    if not 1 <= trials <= 10_000:
        raise VergenceError(f"Asked for {trials} trials; from 1 to 10000 can be made.")


Watch = Callable[[GazeState, Frame | None, Mapping[str, str], Array | None], None]
"""A function that records a state and its frame, further phases by lane, and the position (3,) [m]
of a hand in frame body. Without a frame it records nothing."""
Finish = Callable[["DataclassInstance"], None]
"""A function that writes the summary of the runs."""


@contextmanager
def recorded(
    experiment: Experiment,
    name: str,
    twin: Twin,
    settings: GazeSettings,
    *,
    reach_m: float,
    speed: float = 1.0,
    hand: bool = False,
) -> Iterator[tuple[Watch, Finish]]:
    """Record runs in a `with` block to `name`.rrd in the experiment's folder, and in its viewer.

    Either may be missing. Runs, each with its time from zero, follow each other on one timeline.
    Images are recorded of the frames that have those of all cameras. The 3-D view reaches as far as
    stated [m]; `speed` is that of the playback. Yields the function to call for each frame, and the
    one that writes a summary to `name`.json and into the recording. VergenceError if a file cannot
    be written.
    """
    title = f"{name}, profile {experiment.profile.name}, seed {experiment.seed}"
    out, viewer = experiment.out, experiment.viewer
    if out is None and viewer is None:
        yield lambda *_: None, lambda _: None
        return
    head, seen = settings.calibration, settings.geometry == "seen"
    layout = gaze_blueprint(title, head, reach_m=reach_m, speed=speed, hand=hand, seen=seen)
    file = None if out is None else out / f"{name}.rrd"
    geoms = visual_geoms(twin.model)
    with open_feed(title, layout, head, geoms, file=file, viewer=viewer) as feed:

        def finish(summary: DataclassInstance) -> None:
            if out is not None:
                write_json(summary, out / f"{name}.json")
            feed.always(log_report, f"# {title}\n\n```\n{as_json(summary, digits=4)}```\n")

        yield _watch(feed, twin, settings), finish


def _watch(feed: Feed, twin: Twin, settings: GazeSettings) -> Watch:
    """Make the function that records the frames of all runs on one timeline."""
    head = settings.calibration
    count, latest_s, began_s = 0, -np.inf, 0.0
    lanes_before: dict[str, str] = {}

    def watch(
        state: GazeState, frame: Frame | None, lanes: Mapping[str, str], hand: Array | None
    ) -> None:
        nonlocal count, latest_s, began_s, lanes_before
        if frame is None:
            return
        if frame.time_s < latest_s:  # the next run
            began_s += latest_s + FRAME_S
        latest_s = frame.time_s
        # Those of all cameras are enough, and the file stays small.
        shown = frame if len(frame.images) == len(head.cameras) else replace(frame, images={})
        T_body_lbase = base_pose_in_body(head, "left", frame.neck_angles)
        if not count:
            T_world_body = twin.T_world_lbase() @ inverse(T_body_lbase)
            feed.always(log_gaze_styles, settings, T_world_body)
            if state.geometry is not None:
                feed.always(log_seen_styles, head, state.geometry.state)
        time_s, index, poses = began_s + frame.time_s, count, twin.body_poses()
        truth, readings, where = twin.truth, twin.true_readings(), twin.true_object()
        if poses["object"][2, 3] < 0:  # hidden, below the floor
            where = np.full(3, np.nan)
        lanes = {"gaze": state.phase.value, **lanes}
        changed = {
            lane: lanes.get(lane, "")
            for lane in {*lanes_before, *lanes}
            if lanes_before.get(lane) != lanes.get(lane)
        }

        def log(rec: Recording) -> None:
            errors_px = foveal_errors_at(truth, settings, readings, where)
            observed = Observed(
                time_s=time_s,
                index=index,
                body_poses=poses,
                pixels={name: project_point(truth, name, readings, where) for name in frame.images},
                position=transform(T_body_lbase, where),
                errors_px=dict(zip(settings.eyes, errors_px, strict=True)),
                hand=hand,
            )
            log_gaze(rec, settings, state, shown, observed)

        if changed:
            feed.always(log_states, time_s, index, changed)
        feed(log)
        count, lanes_before = count + 1, lanes

    return watch
