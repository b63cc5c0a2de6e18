"""Replay one of the paper's figures: locate a fixed object in each sample while the eyes move."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from vergence.accuracy.motions import eye_angles
from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration
from vergence.geometry.projection import project_point
from vergence.paper.comparison import PAPER, Comparison
from vergence.paper.figures import WIDE, Figure, default_duration_s
from vergence.progress import Progress, silent
from vergence.stereo.triangulation import triangulate_at
from vergence.twin.head import Exposure, Twin
from vergence.vision.sphere import find_sphere

SAMPLES = 640
"""Samples per figure, evenly spaced; with 600, standard deviations vary by 2-3 % with the seed."""
_LEAD_S = 1.0
"""Time in which the eyes reach the trajectory before the first sample [s]."""


@dataclass(frozen=True, eq=False)
class Measurements:
    """Joint readings and image positions of N samples."""

    time_s: Array
    """(N,) since the first sample."""
    eye_angles: Array
    """(N, 4) joint readings [rad], in the order of EYE_JOINTS."""
    pixels_l: Array
    """(N, 2) the object's centre in the left wide image [px]; NaN: not found."""
    pixels_r: Array
    """(N, 2) the object's centre in the right wide image [px]; NaN: not found."""


@dataclass(frozen=True, eq=False)
class Statistics:
    """Statistics of one figure's estimates, in the left eye's base frame (x forward = depth)."""

    mean_m: Array
    """(3,) mean."""
    std_m: Array
    """(3,) standard deviation, with N - 1 in the denominator."""
    samples: int
    """Samples that were located."""
    dropped: int
    """Samples in which the object was not found, or its rays did not meet."""


def describe(points: Array) -> Statistics:
    """Compute the statistics of points (N, 3) [m]; rows with NaN are dropped samples."""
    good = points[np.isfinite(points).all(axis=1)]
    mean, std = np.full((2, 3), np.nan)
    if len(good) >= 2:
        mean, std = good.mean(0), good.std(0, ddof=1)
    return Statistics(mean, std, len(good), len(points) - len(good))


@dataclass(frozen=True, eq=False)
class Replay:
    """One replayed figure; the object is at the mean that the paper prints."""

    figure: Figure
    measurements: Measurements
    points: Array
    """(N, 3) estimated positions [m] in the left eye's base frame; NaN: not located."""
    others: dict[str, Array] = field(default_factory=dict)
    """The same by other methods, from the same images and readings."""

    @cached_property
    def statistics(self) -> Statistics:
        """Statistics of the points."""
        return describe(self.points)


def sample_times(figure: Figure, duration_s: float | None, rate_hz: float | None) -> Array:
    """Compute the times (N,) [s] of a figure's samples, in whole milliseconds.

    The default duration is the figure's full combined period, at least 60 s; without a rate there
    are SAMPLES samples, whatever the duration.
    """
    duration = default_duration_s(figure.motion) if duration_s is None else duration_s
    count = SAMPLES if rate_hz is None else round(duration * rate_hz)
    # The physics steps in milliseconds.
    return np.round(np.arange(count) * duration / count, 3)


def replay(
    twin: Twin,
    calibration: HeadCalibration,
    figure: Figure,
    times_s: Array,
    *,
    observer: Callable[..., None] | None = None,
    image_every: int = 1,
    compared: Comparison | None = None,
    progress: Progress = silent,
) -> Replay:
    """Replay a figure on rendered images.

    Args:
        twin: the head, with the figure's lens.
        calibration: the estimated calibration of the head.
        figure: the figure to replay.
        times_s: (N,) times of the samples, rising.
        observer: function that gets each sample in its order, from another thread, as arguments of
            `viewer.recording.log_frame` by name.
        image_every: every Nth sample is rendered by all cameras, for the observer; the others by
            the wide cameras, which the estimation uses.
        compared: other methods, which get each sample in its order.
        progress: is called after each sample.
    """
    twin.restart(figure.number)
    twin.place_object(np.array(figure.mean_m))

    def command(time_s: float) -> Array:
        return twin.posture(eye_angles(figure.motion, np.array(time_s - _LEAD_S)))

    def process(
        index: int, exposure: Exposure, eyes: Array, where: Array, bodies: dict[str, Array]
    ) -> tuple[Array, ...]:
        """Develop a frame, detect the object, and show both to observer and other methods."""
        frame = twin.develop(exposure)
        detected = {
            name: find_sphere(image, calibration.camera(name).intrinsics)
            for name, image in frame.images.items()
        }
        if compared is not None:
            compared.add(frame.images, frame.eye_angles, detected, times_s[index])
        if observer is not None:
            complete = len(frame.images) == len(twin.truth.cameras)
            shown = {n: project_point(twin.truth, n, eyes, where) for n in frame.images}
            observer(
                time_s=times_s[index],
                index=index,
                frame=frame if complete else None,
                body_poses=bodies,
                detected=detected,
                truth=shown,
            )
        return (frame.eye_angles, *(detected[name] for name in WIDE))

    task = f"figure {figure.number}, {figure.motion}"
    progress(task, 0, len(times_s))
    twin.advance(_LEAD_S / 2, command(_LEAD_S))  # to the first posture
    pending = []
    # A worker develops and searches images while the next ones render.
    with ThreadPoolExecutor(max_workers=1) as worker:
        try:
            for index, time_s in enumerate(times_s):
                twin.advance(_LEAD_S + time_s, command)
                complete = observer is not None and index % image_every == 0
                exposure = twin.expose(tuple(twin.truth.cameras) if complete else WIDE)
                if index >= 3:
                    pending[index - 3].result()  # limits images in memory, raises errors early
                eyes, where = twin.true_readings(), twin.true_object()
                sample = index, exposure, eyes, where, twin.body_poses()
                pending.append(worker.submit(process, *sample))
                progress(task, index + 1, len(times_s))
        except BaseException:
            worker.shutdown(cancel_futures=True)
            raise
        results = [future.result() for future in pending]
    angles, pixels_l, pixels_r = (np.array(column) for column in zip(*results, strict=True))
    result = estimate(calibration, figure, Measurements(times_s, angles, pixels_l, pixels_r))
    if compared is None:
        return result
    others = {method: np.array(points) for method, points in compared.points.items()}
    return replace(result, others=others)


def estimate(calibration: HeadCalibration, figure: Figure, measurements: Measurements) -> Replay:
    """Locate the object in all samples."""
    points, _ = triangulate_at(
        calibration,
        left=measurements.pixels_l,
        right=measurements.pixels_r,
        joints=measurements.eye_angles,
        cameras=WIDE,
    )
    return Replay(figure, measurements, points)


def as_plain(figure: Figure, ours: Statistics) -> dict[str, Any]:
    """Convert a figure's results, and the paper's, to plain values for JSON."""
    return {
        "paper_mean_m": list(figure.mean_m),
        "paper_std_m": list(figure.std_m),
        "object_m": list(figure.mean_m),
        "mean_m": ours.mean_m.tolist(),
        "std_m": ours.std_m.tolist(),
        "samples": ours.samples,
        "dropped": ours.dropped,
    }


def show_method(result: Replay, method: str) -> Replay:
    """Exchange a replay's points for those of another method; its own become `paper`."""
    if method == PAPER:
        return result
    return replace(
        result, points=result.others[method], others={PAPER: result.points, **result.others}
    )


def summaries(result: Replay) -> dict[str, dict[str, Any]]:
    """Convert the results of all methods as `as_plain` does; empty if only one was used."""
    points = {PAPER: result.points, **result.others} if result.others else {}
    return {method: as_plain(result.figure, describe(each)) for method, each in points.items()}
