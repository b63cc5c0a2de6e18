"""Depth errors of the eyes by range, compared with the standard deviations of Eq. 20.

Differences between successive frames separate random errors from systematic ones: errors of the
calibration, or of a joint's gain, change little from frame to frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.gaze.state import GazeSettings, GazeState
from vergence.geometry.head import base_pose, base_pose_in_body
from vergence.geometry.se3 import inverse, transform
from vergence.stereo.uncertainty import depth_error, disparity_error
from vergence.twin.head import Twin
from vergence.twin.simulated_robot import true_pixels

EDGES_M = (0.35, 0.45, 0.6, 0.8, 1.0, 1.4)
"""Intervals of distance [m], from where the hand closes to where objects come into view."""
_FEWEST = 10
"""Minimum number of samples of an interval."""


@dataclass(frozen=True)
class DepthSample:
    """Errors of one frame in which both narrow cameras see the object."""

    time_s: float
    """Time of the frame."""
    distance_m: float
    """True distance from the midpoint between the eyes."""
    depth_error_m: float
    """Error of this frame's estimate along the line of sight."""
    pixel_error_px: float
    """Horizontal error of the object's pixel, left image minus right image."""
    vergence_error_rad: float
    """Error of the pan readings, left eye minus right eye."""
    baseline_m: float
    """Distance between the eyes."""
    focal_px: float
    """Focal length of the narrow cameras."""


@dataclass(frozen=True)
class RangeBin:
    """Errors within an interval of distances."""

    from_m: float
    to_m: float
    frames: int
    depth_rms_mm: float
    """Root mean square of the whole depth error."""
    depth_std_mm: float
    """Standard deviation of the part that differs from frame to frame."""
    eq20_mm: float
    """Its prediction by Eqs. 20-21, from the standard deviations of pixels and readings over all
    distances."""


def depth_sample(
    twin: Twin, settings: GazeSettings, state: GazeState, frame: Frame
) -> DepthSample | None:
    """Compare the state after a frame of the twin's present time with the truth.

    None without an estimate by both narrow cameras.
    """
    found = [state.detections.get(name) for name in settings.narrow]
    left, right = found
    if state.measured is None or state.frame_s != frame.time_s or left is None or right is None:
        return None
    truth, middle = twin.true_object(), inverse(base_pose(twin.truth, "left"))[:3, 3]
    away = truth - middle
    distance = float(np.linalg.norm(away))
    T_lbase_body = inverse(base_pose_in_body(settings.calibration, "left", frame.neck_angles))
    error = transform(T_lbase_body, state.measured) - truth
    left_px, right_px = np.array([left.pixel, right.pixel]) - true_pixels(twin, settings)
    reading_errors = frame.eye_angles - twin.true_readings()
    return DepthSample(
        time_s=frame.time_s,
        distance_m=distance,
        depth_error_m=float(error @ away) / distance,
        pixel_error_px=float(left_px[0] - right_px[0]),
        vergence_error_rad=float(reading_errors[0] - reading_errors[2]),
        baseline_m=float(2 * np.linalg.norm(middle)),
        focal_px=float(settings.calibration.camera(settings.narrow[0]).intrinsics.matrix[0, 0]),
    )


def bin_by_range(runs: Sequence[Sequence[DepthSample]]) -> tuple[RangeBin, ...]:
    """Compute the errors by distance, for the intervals with enough frames.

    The samples of a run are in the order of their times; differences are taken within a run.
    """
    pairs = [(a, b) for run in runs for a, b in pairwise(run) if b.time_s - a.time_s < 0.1]
    if len(pairs) < _FEWEST:
        return ()
    samples = [sample for run in runs for sample in run]
    pixel_std = _std([b.pixel_error_px - a.pixel_error_px for a, b in pairs])
    vergence_std = _std([b.vergence_error_rad - a.vergence_error_rad for a, b in pairs])
    found = []
    for low, high in pairwise(EDGES_M):
        here = [sample for sample in samples if low <= sample.distance_m < high]
        steps = [b.depth_error_m - a.depth_error_m for a, b in pairs if low <= a.distance_m < high]
        if len(steps) < _FEWEST:
            continue
        z, b, f = np.array([(s.distance_m, s.baseline_m, s.focal_px) for s in here]).T
        eq20_m = depth_error(z, b, f, np.hypot(pixel_std, disparity_error(f, vergence_std)))
        rms_m = _rms([sample.depth_error_m for sample in here])
        millimetres = 1e3 * np.array([rms_m, _std(steps), _rms(eq20_m)])
        found.append(RangeBin(low, high, len(here), *millimetres.tolist()))
    return tuple(found)


def _rms(values: Sequence[float] | Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _std(steps: Sequence[float]) -> float:
    """Compute the standard deviation of independent errors from their steps."""
    return _rms(steps) / float(np.sqrt(2))
