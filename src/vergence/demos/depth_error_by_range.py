"""How wrong the eyes are along their line of sight, by distance, beside what Eq. 20 says.

What scatters is told from what is merely wrong by differences between one frame and the next: the
errors of a calibration, or of the gain of a joint, change little from frame to frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.gaze.commands import EYES_4
from vergence.gaze.controller import NARROW
from vergence.gaze.state import Settings, State
from vergence.geometry.head import T_body_base
from vergence.geometry.se3 import inverse, transform
from vergence.paper.replay import see
from vergence.stereo.uncertainty import depth_error, disparity_error
from vergence.twin.head import Twin

EDGES_M = (0.35, 0.45, 0.6, 0.8, 1.0, 1.4)
_FEWEST = 10


@dataclass(frozen=True)
class Sight:
    """The errors of one frame that shows the object to both narrow cameras."""

    time_s: float
    distance_m: float
    """From midway between the eyes."""
    depth_error_m: float
    """Of the estimate by this frame alone, along the line of sight."""
    pixel_error_px: float
    """Of where the object was found: what the left image is wrong more than the right one."""
    vergence_error_rad: float
    """Of the readings: likewise, of the pans."""
    baseline_m: float
    """Between the narrow cameras."""
    focal_px: float


@dataclass(frozen=True)
class Distance:
    """The errors at some distance."""

    from_m: float
    to_m: float
    frames: int
    depth_rms_mm: float
    """Of all that is wrong."""
    depth_scatter_mm: float
    """Of what differs from frame to frame: a standard deviation."""
    eq20_mm: float
    """The same by Eqs. 20-21, from how much pixels and readings scattered over all distances."""


def sight(twin: Twin, settings: Settings, state: State, frame: Frame) -> Sight | None:
    """Return the errors of the latest frame; None where it gave no estimate by narrow cameras.

    Args:
        twin: the head, asked for the truth.
        settings: of the gaze.
        state: of the gaze after the frame.
        frame: the frame, taken now.
    """
    found = [state.pixels.get(name, np.full(2, np.nan)) for name in NARROW]
    if state.measured is None or state.frame_s != frame.time_s or not np.isfinite(found).all():
        return None
    calibration, eyes = settings.calibration, twin.true_angles()[EYES_4]
    truth = twin.true_object()
    true_pixels = [see(twin.truth, name, eyes[None], truth)[0] for name in NARROW]
    neck = frame.neck_angles[: len(calibration.neck.axes)]
    T_lbase_body = inverse(T_body_base(calibration, "left", neck))
    middle = inverse(twin.truth.T_rbase_lbase)[:3, 3] / 2
    away = truth - middle
    distance = float(np.linalg.norm(away))
    wrong = transform(T_lbase_body, state.measured) - truth
    pixel_errors = np.array(found) - true_pixels
    reading_errors = frame.eye_angles - eyes
    return Sight(
        time_s=frame.time_s,
        distance_m=distance,
        depth_error_m=float(wrong @ away) / distance,
        pixel_error_px=float(pixel_errors[0, 0] - pixel_errors[1, 0]),
        vergence_error_rad=float(reading_errors[0] - reading_errors[2]),
        baseline_m=float(2 * np.linalg.norm(middle)),
        focal_px=float(calibration.camera(NARROW[0]).intrinsics.matrix[0, 0]),
    )


def by_distance(runs: Sequence[Sequence[Sight]]) -> tuple[Distance, ...]:
    """Return the errors by distance, where there are enough frames.

    Args:
        runs: sights in the order of their times; only differences within a run count.
    """
    pairs = [(a, b) for run in runs for a, b in pairwise(run)]
    pairs = [(a, b) for a, b in pairs if b.time_s - a.time_s < 0.1]
    if len(pairs) < _FEWEST:
        return ()
    every = [s for run in runs for s in run]
    pixel_std = _scatter([b.pixel_error_px - a.pixel_error_px for a, b in pairs])
    vergence_std = _scatter([b.vergence_error_rad - a.vergence_error_rad for a, b in pairs])
    found = []
    for low, high in pairwise(EDGES_M):
        here = [s for s in every if low <= s.distance_m < high]
        steps = [b.depth_error_m - a.depth_error_m for a, b in pairs if low <= a.distance_m < high]
        if len(steps) < _FEWEST:
            continue
        z, b, f = (
            np.array([getattr(s, name) for s in here])
            for name in ("distance_m", "baseline_m", "focal_px")
        )
        by_eq20 = depth_error(z, b, f, np.hypot(pixel_std, disparity_error(f, vergence_std)))
        found.append(
            Distance(
                from_m=low,
                to_m=high,
                frames=len(here),
                depth_rms_mm=1e3 * _rms([s.depth_error_m for s in here]),
                depth_scatter_mm=1e3 * _scatter(steps),
                eq20_mm=1e3 * _rms(by_eq20),
            )
        )
    return tuple(found)


def _rms(values: Sequence[float] | Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _scatter(steps: Sequence[float]) -> float:
    """Return the standard deviation of what differs by these steps from one frame to the next."""
    return _rms(steps) / float(np.sqrt(2))
