"""Replay one of the paper's figures: locate a fixed object in every sample while the eyes move."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from vergence.accuracy.motions import eye_angles
from vergence.arrays import Array
from vergence.gaze.commands import EYE_READINGS
from vergence.geometry.head import WIDE, HeadCalibration
from vergence.geometry.projection import project_point
from vergence.paper.comparison import PAPER, Comparison
from vergence.paper.figures import Figure, default_duration_s
from vergence.progress import Progress, silent
from vergence.stereo.triangulation import triangulate_at
from vergence.twin.calibration_sequence import straight_neck
from vergence.twin.head import Exposure, Twin
from vergence.vision.sphere import find_sphere

SAMPLES = 640
"""Samples per figure, evenly spaced; with 600, standard deviations vary by 2-3 % with the seed."""
_LEAD_S = 1.0  # the eyes reach the trajectory before the first sample


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


@dataclass(frozen=True, eq=False)
class Replay:
    """One replayed figure; the object is at the mean that the paper prints."""

    figure: Figure
    measurements: Measurements
    points: Array
    """(N, 3) estimated positions [m] in the left eye's base frame; NaN: not located."""
    statistics: Statistics
    others: dict[str, Estimates] = field(default_factory=dict)
    """What other methods made of the same images and readings, by method."""


@dataclass(frozen=True, eq=False)
class Estimates:
    """What one method made of a figure's images and readings."""

    points: Array
    """(N, 3) [m] in the left eye's base frame; NaN: not located."""
    depth_std_m: Array
    """(N,) the standard deviation of depth that the method states."""
    statistics: Statistics


def sample_times(figure: Figure, duration_s: float | None, rate_hz: float | None) -> Array:
    """Return the times (N,) [s] of a figure's samples, in whole milliseconds.

    The default duration is the figure's full combined period, at least 60 s; without a rate there
    are SAMPLES samples, whatever the duration.
    """
    duration = default_duration_s(figure.motion) if duration_s is None else duration_s
    count = SAMPLES if rate_hz is None else round(duration * rate_hz)
    # Whole milliseconds, since the physics steps in them.
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
        observer: is called with every sample in its order, from another thread, with the arguments
            of `viewer.frame.log_frame` by name.
        image_every: every Nth sample is rendered by all cameras, and the observer gets its images;
            the others only by the wide cameras, which the estimation uses.
        compared: other methods, which get every sample in its order.
        progress: is called after each sample.
    """
    start = _LEAD_S
    twin.restart(figure.number)
    twin.place_object(np.array(figure.mean_m))

    def command(time_s: float) -> Array:
        return straight_neck(eye_angles(figure.motion, np.array(time_s - start)))

    task = f"figure {figure.number}, {figure.motion}"
    progress(task, 0, len(times_s))
    twin.advance(start / 2, command(start))  # to the first posture
    pending = []
    # One worker: images are developed and searched while the next ones render.
    with ThreadPoolExecutor(max_workers=1) as worker:
        try:
            for index, time_s in enumerate(times_s):
                twin.advance(start + time_s, command)
                complete = observer is not None and index % image_every == 0
                exposure = twin.expose(tuple(twin.truth.cameras) if complete else WIDE)
                if index >= 3:
                    pending[index - 3].result()  # limits images in memory, raises errors early
                eyes, where = twin.true_angles()[EYE_READINGS], twin.true_object()
                sample = _Sample(index, time_s, complete, exposure, eyes, where, twin.body_poses())
                pending.append(
                    worker.submit(_measured, twin, calibration, sample, observer, compared)
                )
                progress(task, index + 1, len(times_s))
        except BaseException:
            worker.shutdown(cancel_futures=True)
            raise
        results = [future.result() for future in pending]
    angles = np.array([angles for angles, _ in results])
    pixels_l, pixels_r = (np.array([pixels[name] for _, pixels in results]) for name in WIDE)
    result = estimate(calibration, figure, Measurements(times_s, angles, pixels_l, pixels_r))
    if compared is None:
        return result
    points = {method: np.array(each) for method, each in compared.points.items()}
    others = {
        method: Estimates(each, np.array(compared.stds[method]), describe(each))
        for method, each in points.items()
    }
    return replace(result, others=others)


class _Sample(NamedTuple):
    """What is exposed at one time, and the truth then, for recordings."""

    number: int
    time_s: float
    complete: bool
    """Whether all cameras are rendered."""
    exposure: Exposure
    eyes: Array
    """(4,) true angles [rad]."""
    where: Array
    """(3,) where the object is [m]."""
    bodies: dict[str, Array]


def _measured(
    twin: Twin,
    calibration: HeadCalibration,
    sample: _Sample,
    observer: Callable[..., None] | None,
    compared: Comparison | None,
) -> tuple[Array, dict[str, Array]]:
    """Return the joint readings (4,), and by camera the object's pixel (2,).

    Observer and other methods get the sample; see `replay`.
    """
    frame = twin.develop(sample.exposure)
    detected = {
        name: find_sphere(image, calibration.camera(name).intrinsics)
        for name, image in frame.images.items()
    }
    if compared is not None:
        compared.add(frame.images, frame.eye_angles, detected, sample.time_s)
    if observer is not None:
        shown = {n: project_point(twin.truth, n, sample.eyes, sample.where) for n in frame.images}
        observer(
            time_s=sample.time_s,
            index=sample.number,
            frame=frame if sample.complete else None,
            body_poses=sample.bodies,
            detected=detected,
            truth=shown,
        )
    return frame.eye_angles, detected


def estimate(calibration: HeadCalibration, figure: Figure, measurements: Measurements) -> Replay:
    """Locate the object in all samples, and compute the statistics of its positions."""
    points, _ = triangulate_at(
        calibration,
        left=measurements.pixels_l,
        right=measurements.pixels_r,
        joints=measurements.eye_angles,
        cameras=WIDE,
    )
    return Replay(figure, measurements, points, describe(points))


def describe(points: Array) -> Statistics:
    """Return the statistics of points (N, 3) [m]; rows with NaN count as dropped samples."""
    good = points[np.isfinite(points).all(axis=1)]
    mean, std = np.full((2, 3), np.nan)
    if len(good) >= 2:
        mean, std = good.mean(0), good.std(0, ddof=1)
    return Statistics(mean, std, len(good), len(points) - len(good))


def as_plain(figure: Figure, ours: Statistics) -> dict[str, Any]:
    """Return a figure's results and the paper's beside them, as plain values for JSON."""
    return {
        "paper_mean_m": list(figure.mean_m),
        "paper_std_m": list(figure.std_m),
        "object_m": list(figure.mean_m),
        "mean_m": ours.mean_m.tolist(),
        "std_m": ours.std_m.tolist(),
        "samples": ours.samples,
        "dropped": ours.dropped,
    }


def chosen(result: Replay, method: str) -> Replay:
    """Return a replay whose points are those of another method; its own become `paper`."""
    if method == PAPER:
        return result
    taken = result.others[method]
    own = Estimates(result.points, np.full(len(result.points), np.nan), result.statistics)
    others = {PAPER: own, **result.others}
    return replace(result, points=taken.points, statistics=taken.statistics, others=others)


def summaries(result: Replay) -> dict[str, dict[str, Any]]:
    """Return what `as_plain` does for each method that was compared; empty: none was."""
    others = {name: each.statistics for name, each in result.others.items()}
    if others and PAPER not in others:
        others = {PAPER: result.statistics, **others}
    return {method: as_plain(result.figure, each) for method, each in others.items()}
