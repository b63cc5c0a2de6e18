"""Track a moving object: keep it on both foveas and estimate its position (Sec. III).

The object moves on a smooth random path before the head and is hidden once for half a second. The
gaze controller follows it from frames alone. The truth is used to measure the errors only.
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
    initial_geometry,
    recorded,
)
from vergence.errors import VergenceError
from vergence.gaze.controller import run_gaze
from vergence.gaze.state import GazeSettings, GazeState, initial_gaze_state
from vergence.progress import Progress, silent
from vergence.self_calibration.calibrator import VisualGeometry
from vergence.stereo.triangulation import in_body, triangulate_at
from vergence.twin.head import Twin
from vergence.twin.simulated_robot import FRAME_S, SimulatedHead, foveal_errors, in_all_foveas
from vergence.vision.sphere import find_sphere

SPEED_M_S = 0.3
"""Maximum speed of the object [m/s]."""
DEPTH_M = (0.4, 1.0)
"""Range of depths of the object [m]."""
HIDDEN_S = 0.5
"""Time for which the object is hidden [s]: longer than `GazeSettings.lost_s`."""
SHORTEST_S, LONGEST_S = 3.0, 3600.0
"""Range of the length of a run [s]."""


@dataclass(frozen=True)
class Summary:
    """Statistics of a run; written as JSON."""

    seconds: float
    """Length of the run."""
    frames: int
    """Number of frames that count: from 0.5 s on, without those that hide the object."""
    in_both: float
    """Share of them with the object's true centre in both narrow images."""
    rms_px: float
    """Root mean square of its distance from their centres, while in both."""
    position_rms_m: float
    """Error of the track, over the frames that have a single-frame estimate."""
    single_frame_rms_m: float
    """Error of the single-frame estimates."""
    wide_rms_m: float
    """Error of stereo by the wide images alone, over one frame in six."""
    found_again: bool
    """Whether the object was in both narrow images within a second of its return."""


def smooth_path(seed: int, seconds: float) -> Callable[[float], Array]:
    """Draw a smooth path: the position (3,) [m] in frame head as a function of time [s].

    Depth and direction are sums of three slow waves. Time is scaled so that the maximum speed in a
    run of this length is SPEED_M_S.
    """
    rng = np.random.default_rng([seed, 6])
    frequency, phase = rng.uniform(0.4, 1.6, (3, 3)), rng.uniform(0, 2 * np.pi, (3, 3))
    weight = rng.uniform(0.5, 1.0, (3, 3))
    weight /= weight.sum(axis=1, keepdims=True)

    def shape(s: Array) -> Array:
        waves = np.sum(weight * np.sin(frequency * s[:, None, None] + phase), axis=2)  # (N, 3)
        depth = np.mean(DEPTH_M) + waves[:, 0] * np.ptp(DEPTH_M) / 2
        # Largest pan and tilt [rad], well within the eyes' ranges.
        sideways, up = np.tan(0.30) * waves[:, 1], np.tan(0.22) * waves[:, 2]
        return depth[:, None] * np.stack([np.ones_like(depth), sideways, up], axis=-1)

    def fastest(rate: float) -> float:
        times = np.linspace(0, seconds, max(6000, int(100 * seconds)))
        steps = np.linalg.norm(np.diff(shape(rate * times), axis=0), axis=1)
        return float(steps.max() / (times[1] - times[0]))

    low, high = 0.0, 10.0
    for _ in range(40):  # bisection: the maximum speed grows with the rate
        middle = (low + high) / 2
        low, high = (middle, high) if fastest(middle) < SPEED_M_S else (low, middle)
    return lambda time_s: shape(np.array([low * time_s]))[0]


def follow(
    twin: Twin,
    settings: GazeSettings,
    run: int,
    path_head: Callable[[float], Array],
    seconds: float,
    *,
    hidden_s: float | None = None,
    geometry: VisualGeometry | None = None,
    watch: Callable[[GazeState, Frame | None], None] = lambda state, frame: None,
) -> Summary:
    """Run the gaze controller on a moving object, and compute the statistics.

    The number of the run is the seed of the noise. The object's path is its position (3,) [m] in
    frame head by time [s]. From `hidden_s` on it is hidden for HIDDEN_S; None: it is not hidden.
    The geometry is what was learned before. `watch` gets each state and its frame.
    """

    def path(time_s: float) -> Array | None:
        if hidden_s is not None and hidden_s <= time_s < hidden_s + HIDDEN_S:
            return None
        return path_head(time_s)

    head = SimulatedHead(twin, run, path, all_cameras_every=6)
    rows: list[tuple[float, ...]] = []

    def keep(state: GazeState, frame: Frame | None) -> None:
        watch(state, frame)
        if frame is None or frame.time_s < 0.5 or path(frame.time_s) is None:
            return
        where = twin.true_object()
        fused = single = wide = np.nan  # squared errors
        if state.measured is not None and state.track is not None:
            truth = in_body(settings.calibration, where, frame.neck_angles)
            fused = np.sum((state.track.position - truth) ** 2)
            single = np.sum((state.measured - truth) ** 2)
        if len(settings.wide) == 2 and set(settings.wide) <= set(frame.images):
            wide = np.sum((by_wide_images(settings, frame) - where) ** 2)
        squared = float(np.mean(foveal_errors(twin, settings) ** 2))
        rows.append((frame.time_s, in_all_foveas(twin, settings), squared, fused, single, wide))

    at_rest = np.zeros(len(settings.joints))
    state = initial_gaze_state(settings, at_rest, head.now_s(), geometry=geometry)
    run_gaze(head, settings, state, seconds - FRAME_S, watch=keep)
    return _statistics(np.array(rows, float).reshape(-1, 6), seconds, hidden_s)


def _statistics(table: Array, seconds: float, hidden_s: float | None) -> Summary:
    """Compute the statistics of a run from the rows (N, 6) of the frames that count.

    A row has the time [s]; whether the object is in both narrow images; the mean square of its
    distances from their centres [px^2]; and squared errors [m^2] of the track, of the single frame
    and of the wide images, NaN without an estimate.
    """
    time, seen = table[:, 0], table[:, 1] == 1
    fused, single, wide = (column[np.isfinite(column)] for column in table[:, 3:].T)
    if not seen.any():
        return Summary(seconds, len(time), 0.0, np.inf, np.inf, np.inf, np.inf, False)
    ends = -np.inf if hidden_s is None else hidden_s + HIDDEN_S
    back = seen[(time >= ends) & (time < ends + 1.0)]
    return Summary(
        seconds=seconds,
        frames=len(time),
        in_both=float(seen.mean()),
        rms_px=float(np.sqrt(table[seen, 2].mean())),
        position_rms_m=_root_mean(fused),
        single_frame_rms_m=_root_mean(single),
        wide_rms_m=_root_mean(wide),
        found_again=hidden_s is None or bool(back.any()),
    )


def _root_mean(squares: Array) -> float:
    """Compute the root of the mean of squares (n,); infinite without squares."""
    return float(np.sqrt(squares.mean())) if len(squares) else np.inf


def by_wide_images(settings: GazeSettings, frame: Frame) -> Array:
    """Locate the sphere (3,) [m] in the left eye's base by both wide images; NaN: not in both."""
    cameras = settings.wide[0], settings.wide[1]
    left, right = (
        find_sphere(frame.images[name], settings.calibration.camera(name).intrinsics)[None]
        for name in cameras
    )
    points, _ = triangulate_at(
        settings.calibration, left=left, right=right, joints=frame.eye_angles, cameras=cameras
    )
    return points[0]


def track(experiment: Experiment, progress: Progress = silent, *, seconds: float = 60.0) -> Summary:
    """Calibrate the twin, and track an object that is hidden once on its way.

    The folder gets track.json and the recording track.rrd. Raises VergenceError if an argument is
    out of range, or a file cannot be written.
    """
    if not SHORTEST_S <= seconds <= LONGEST_S:
        raise VergenceError(f"A run takes {SHORTEST_S:.0f} to {LONGEST_S:.0f} s, found {seconds}.")
    seed = experiment.seed
    with (
        calibrated_twin(experiment, progress) as (twin, settings),
        recorded(experiment, "track", twin, settings, reach_m=DEPTH_M[1]) as (record, finish),
    ):
        hidden_s = float(np.random.default_rng([seed, 7]).uniform(0.3, 0.6)) * seconds
        path = smooth_path(seed, seconds)

        def both(state: GazeState, frame: Frame | None) -> None:
            progress("track, seconds", max(0, int(state.frame_s)), int(seconds))
            record(state, frame, {}, None)

        geometry = initial_geometry(twin, settings)
        arguments = twin, settings, 1, path, seconds
        found = follow(*arguments, hidden_s=hidden_s, geometry=geometry, watch=both)
        progress("track, seconds", int(seconds), int(seconds))
        finish(found)
    return found
