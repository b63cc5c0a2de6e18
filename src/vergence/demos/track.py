"""Keep the eyes on an object that moves, and know where it is (Sec. III).

The object goes along a smooth random path before the head, is hidden once for half a second, and
is followed from frames alone. The truth is asked only for how well.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.demos.recording import recorded
from vergence.errors import VergenceError
from vergence.files import write_whole
from vergence.gaze.commands import HEAD_JOINTS, NECK
from vergence.gaze.controller import WIDE, Settings, State, look, start
from vergence.geometry.head import HeadCalibration, T_body_base, T_head_base
from vergence.geometry.se3 import inverse, transform
from vergence.stereo.triangulation import locate
from vergence.twin.head import Twin
from vergence.twin.profile import ErrorProfile
from vergence.twin.simulated_robot import (
    FRAME_S,
    Delivery,
    TwinHead,
    calibrated,
    foveal_errors,
    in_both_foveas,
)
from vergence.vision.sphere import find_sphere

SPEED_M_S = 0.3
"""The object's greatest."""
DEPTH_M = (0.4, 1.0)
DIRECTION_RAD = (0.30, 0.22)
"""Farthest from straight ahead, sideways and in height: well within the eyes' ranges."""
HIDDEN_S = 0.5
ACQUIRE_S = 0.5
"""From its first appearance until the count begins; after it was hidden, nothing is left out."""
ALL_EVERY = 6
"""Of so many frames one has all images, to compare the lenses by and to look at."""
_GRID = 6000
SHORTEST_S, LONGEST_S = 3.0, 3600.0


@dataclass(frozen=True)
class Summary:
    """What a run came to; written as JSON."""

    seconds: float
    frames: int
    """In which the object was to be seen, from ACQUIRE_S on: those that count."""
    in_both: float
    """Share of them in which its centre truly was in both narrow images."""
    rms_px: float
    """Of its distance from the centres of the narrow images, while in both."""
    position_rms_m: float
    """Of the fused estimate, over frames that have a single-frame estimate too."""
    single_frame_rms_m: float
    """Of stereo by each of these frames alone."""
    wide_rms_m: float
    """Of stereo by the wide images alone, over the frames that have them: one in ALL_EVERY."""
    found_again: bool
    """Whether it was in both narrow images again within a second of its return."""


def smooth_path(seed: int, seconds: float) -> Callable[[float], Array]:
    """Return a smooth random path: where the object is (3,) [m] in frame head, at a time.

    Depth and direction are sums of three slow waves, and time is scaled so that the speed comes
    to SPEED_M_S at the fastest place of the run.
    """
    rng = np.random.default_rng([seed, 6])
    frequency, phase = rng.uniform(0.4, 1.6, (3, 3)), rng.uniform(0, 2 * np.pi, (3, 3))
    weight = rng.uniform(0.5, 1.0, (3, 3))
    weight /= weight.sum(axis=1, keepdims=True)

    def shape(s: Array) -> Array:
        waves = np.sum(weight * np.sin(frequency * s[:, None, None] + phase), axis=2)  # (N, 3)
        depth = np.mean(DEPTH_M) + waves[:, 0] * np.ptp(DEPTH_M) / 2
        sideways, up = (
            np.tan(limit) * waves[:, k] for k, limit in zip((1, 2), DIRECTION_RAD, strict=True)
        )
        return depth[:, None] * np.stack([np.ones_like(depth), sideways, up], axis=-1)

    def fastest(rate: float) -> float:
        times = np.linspace(0, seconds, max(_GRID, int(100 * seconds)))
        steps = np.linalg.norm(np.diff(shape(rate * times), axis=0), axis=1)
        return float(steps.max() / (times[1] - times[0]))

    low, high = 0.0, 10.0
    for _ in range(40):  # the speed grows with the rate, if not evenly: the run covers more
        middle = (low + high) / 2
        low, high = (middle, high) if fastest(middle) < SPEED_M_S else (low, middle)
    return lambda time_s: shape(np.array([low * time_s]))[0]


def follow(
    twin: Twin,
    settings: Settings,
    run: int,
    path_head: Callable[[float], Array],
    seconds: float,
    *,
    hidden_s: float | None = None,
    watch: Callable[[State, Frame | None], None] = lambda state, frame: None,
) -> Summary:
    """Follow an object for a time.

    Args:
        twin: the head.
        settings: of the controller.
        run: number of the run, for the noise.
        path_head: where the object is (3,) [m] in frame head.
        seconds: how long.
        hidden_s: when it is hidden for HIDDEN_S; None: never.
        watch: is shown every state and its frame.
    """
    T_lbase_head = inverse(T_head_base(twin.truth, "left"))
    ends = -np.inf if hidden_s is None else hidden_s + HIDDEN_S

    def path(time_s: float) -> Array | None:
        if hidden_s is not None and hidden_s <= time_s < ends:
            return None
        return transform(T_lbase_head, path_head(time_s))

    delivery = Delivery(all_every=ALL_EVERY)
    head = TwinHead(twin, run, path, limits=settings.limits, delivery=delivery)
    times: list[float] = []
    inside: list[bool] = []
    distances: list[Array] = []
    fused: list[float] = []
    single: list[float] = []
    wide: list[float] = []

    def keep(state: State, frame: Frame | None) -> None:
        watch(state, frame)
        if frame is None or frame.time_s < ACQUIRE_S or path(frame.time_s) is None:
            return
        times.append(frame.time_s)
        inside.append(in_both_foveas(twin))
        distances.append(foveal_errors(twin, settings.calibration))
        where = twin.true_object()
        if state.measured is not None and state.track is not None:
            neck = frame.neck_angles[NECK][: len(settings.calibration.neck.axes)]
            truth = transform(T_body_base(settings.calibration, "left", neck), where)
            fused.append(float(np.sum((state.track.position - truth) ** 2)))
            single.append(float(np.sum((state.measured - truth) ** 2)))
        if all(name in frame.images for name in WIDE):
            wide.append(float(np.sum((by_wide_images(settings.calibration, frame) - where) ** 2)))

    state = start(settings, np.zeros(len(HEAD_JOINTS)), head.now_s())
    look(head, settings, state, seconds - FRAME_S, watch=keep)
    time, seen = np.array(times), np.array(inside)
    back = seen[(time >= ends) & (time < ends + 1.0)]
    if not seen.any() or not fused:
        return Summary(seconds, len(times), 0.0, np.inf, np.inf, np.inf, np.inf, False)
    return Summary(
        seconds=seconds,
        frames=len(times),
        in_both=float(seen.mean()),
        rms_px=float(np.sqrt((np.array(distances)[seen] ** 2).mean())),
        position_rms_m=float(np.sqrt(np.mean(fused))),
        single_frame_rms_m=float(np.sqrt(np.mean(single))),
        wide_rms_m=float(np.sqrt(np.nanmean(wide))),
        found_again=hidden_s is None or bool(back.any()),
    )


def by_wide_images(calibration: HeadCalibration, frame: Frame) -> Array:
    """Return the object (3,) [m] in the left eye's base frame by stereo of the wide images.

    NaN where one of them does not show it.
    """
    pixels = [
        find_sphere(frame.images[name], calibration.camera(name).intrinsics)[None] for name in WIDE
    ]
    return locate(calibration, pixels[0], pixels[1], frame.eye_angles[None]).points[0]


def track(
    *,
    seconds: float = 60.0,
    seed: int = 0,
    profile: ErrorProfile,
    out: Path | None = None,
    watch: Callable[[State, Frame | None], None] = lambda state, frame: None,
) -> Summary:
    """Calibrate the twin, and follow an object that is hidden once on its way.

    Args:
        seconds: how long.
        seed: of everything random.
        profile: imperfections of the head.
        out: folder for track.json and track.rrd; None: nothing is written.
        watch: is shown every state and its frame.

    Raises:
        VergenceError: an argument cannot be met, or the folder cannot be written.
    """
    if not SHORTEST_S <= seconds <= LONGEST_S:
        raise VergenceError(f"A run takes {SHORTEST_S:.0f} to {LONGEST_S:.0f} s, found {seconds}.")
    if seed < 0:
        raise VergenceError(f"The seed must be a whole number from 0, found {seed}.")
    hidden_s = float(np.random.default_rng([seed, 7]).uniform(0.3, 0.6)) * seconds
    with Twin(profile, seed=seed) as twin:
        settings = calibrated(twin, seed)
        path = smooth_path(seed, seconds)
        if out is None:
            return follow(twin, settings, 1, path, seconds, hidden_s=hidden_s, watch=watch)
        title = f"track, profile {profile.name}, seed {seed}"
        file, reach = out / "track.rrd", DEPTH_M[1]
        with recorded(file, twin, settings, title=title, reach_m=reach) as (record, report):

            def both(state: State, frame: Frame | None) -> None:
                watch(state, frame)
                record(state, frame)

            found = follow(twin, settings, 1, path, seconds, hidden_s=hidden_s, watch=both)
            report += [f"# {title}", "", *as_markdown(found, hidden_s)]
    write_whole(out / "track.json", json.dumps(asdict(found), indent=1) + "\n")
    return found


def as_markdown(found: Summary, hidden_s: float) -> list[str]:
    """Return the lines of a report."""
    return [
        f"An object at up to {SPEED_M_S} m/s; hidden from {hidden_s:.1f} s for {HIDDEN_S} s.",
        "",
        f"- in both narrow images in {found.in_both:.1%} of {found.frames} frames",
        f"- {found.rms_px:.2f} px rms from their centres",
        f"- position: {1e3 * found.position_rms_m:.2f} mm rms, "
        f"{1e3 * found.single_frame_rms_m:.2f} mm by single frames, "
        f"{1e3 * found.wide_rms_m:.2f} mm by the wide images alone",
        f"- found again: {'yes' if found.found_again else 'no'}",
    ]
