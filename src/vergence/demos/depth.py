"""Dense depth while the twin's eyes move, and its error; the truth is used for the errors only."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame, check_fits
from vergence.demos.experiment import LOOKING, Experiment
from vergence.geometry.camera import project, unproject
from vergence.geometry.head import HeadCalibration, pair_names
from vergence.geometry.se3 import transform
from vergence.progress import Progress
from vergence.self_calibration.calibrator import Geometry, initial_visual_geometry, update_geometry
from vergence.self_calibration.dense_pairs import (
    RANGE_M,
    DepthSequence,
    PairDepth,
    depth_by,
)
from vergence.stereo.dense_depth import DenseDepth
from vergence.stereo.extrinsics import relative_camera_pose, stereo_cameras
from vergence.stereo.rectification import RectifiedPair, rectified_pixels, rectified_points
from vergence.twin.head import Twin
from vergence.twin.record import describe_twin
from vergence.twin.simulated_robot import calibrate_twin, divergent_motion, learn_by_looking

PairErrors = tuple[Array, Array, float]
"""Errors of one pair: see `depth_errors`."""


@dataclass(frozen=True)
class DepthErrors:
    """Errors of depth at RANGE_M in textured pixels, over all pairs."""

    median_relative: float
    wrong: float
    """Share of the pixels with an error above a fifth."""
    within_two_std: float
    """Share of the others whose error is within two standard deviations."""
    pixels: int
    vertical_rms_px: float
    """Difference of a point's rows in the two rectified images."""


@dataclass(frozen=True, eq=False)
class DepthTruth:
    """The truth of a pair: the head, its angles and the depth of each pixel."""

    head: HeadCalibration
    eye_angles: Array
    """(r,) [rad]."""
    depth_m: Array
    """(H, W) along the optical axis of the left camera."""


def depth_errors(pair: RectifiedPair, found: DenseDepth, truth: DepthTruth) -> PairErrors:
    """Compute errors over the depth (N,), over the stated std (N,), and of the rows [px].

    The depth is that along the left camera's axis, at the pixel of its own image.
    """
    view = pair.left
    size = found.depth_m.shape[::-1]
    pixels = np.stack(np.meshgrid(*map(np.arange, size)), axis=-1).astype(float)
    points = rectified_points(pair, pixels, found.disparity_px) @ view.R_rect_cam
    true_m = cv2.remap(
        truth.depth_m.astype(np.float32),
        view.map_x,
        view.map_y,
        cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=np.nan,
    )
    near = found.textured & (true_m > RANGE_M[0]) & (true_m < RANGE_M[1])
    error_m = points[near][:, 2] - true_m[near]
    return error_m / true_m[near], error_m / found.std_m[near], _row_rms(pair, truth)


def _row_rms(pair: RectifiedPair, truth: DepthTruth) -> float:
    """Compute the root mean square difference of a true point's rows in the pair [px]."""
    left, right = (mounted.intrinsics for mounted in stereo_cameras(truth.head, None))
    v, u = np.mgrid[: left.height : 16, : left.width : 16]  # [px]
    pixels = np.stack([u, v], axis=-1).reshape(-1, 2).astype(float)
    points = unproject(left, pixels) * truth.depth_m[v, u].reshape(-1, 1)
    T = relative_camera_pose(truth.head, truth.eye_angles)
    opposite = project(right, transform(T, points))
    inside = ((opposite >= 0) & (opposite <= [right.width - 1, right.height - 1])).all(axis=-1)
    rows = [
        rectified_pixels(pair, view, at[inside])[:, 1]
        for view, at in ((pair.left, pixels), (pair.right, opposite))
    ]
    return float(np.sqrt(np.nanmean((rows[0] - rows[1]) ** 2)))


def pooled(found: list[PairErrors]) -> DepthErrors:
    """Compute the statistics of the errors of all pairs."""
    relative, standardised = (np.concatenate([each[k] for each in found]) for k in (0, 1))
    wrong = np.abs(relative) > 0.2  # a mismatch
    within = np.abs(standardised[~wrong]) < 2
    return DepthErrors(
        median_relative=float(np.median(np.abs(relative))) if relative.size else np.nan,
        wrong=float(wrong.mean()) if relative.size else np.nan,
        within_two_std=float(within.mean()) if within.size else np.nan,
        pixels=len(relative),
        vertical_rms_px=float(np.sqrt(np.mean([each[2] ** 2 for each in found]))),
    )


STEP_S = 9.0
"""Time between two pairs of the divergent motion [s]: no divisor of its periods."""


@contextmanager
def twin_depth(
    calibration: HeadCalibration | None, experiment: Experiment, pairs: int, progress: Progress
) -> Iterator[DepthSequence]:
    """Compute dense depth over the divergent motion of a twin, in a `with` block.

    Without a calibration the twin is calibrated first, by the paper's method. With the geometry
    "seen" it looks around first. VergenceError for a calibration of other cameras or readings.
    """
    with experiment.twin() as twin:
        reading_std = None
        if calibration is None:
            settings = calibrate_twin(twin, experiment.seed, progress)
            calibration, reading_std = settings.calibration, settings.reading_std
        described = describe_twin(twin.truth, None, "")
        check_fits(described, calibration, "the twin", pair_names(twin.truth))
        errors: dict[str, list[PairErrors]] = defaultdict(list)
        found = _pairs(twin, calibration, pairs, experiment.geometry, reading_std, errors)
        yield DepthSequence(
            calibration,
            found,
            pairs,
            errors=lambda: {name: pooled(each) for name, each in errors.items()},
        )


def _pairs(
    twin: Twin,
    head: HeadCalibration,
    pairs: int,
    geometry: Geometry,
    reading_std: float | None,
    errors: dict[str, list[PairErrors]],
) -> Iterator[tuple[Frame, PairDepth]]:
    """Yield pairs with their depths, and append their errors by geometry."""
    left, right = pair_names(twin.truth)
    visual = None
    if geometry == "seen":
        visual = learn_by_looking(twin, initial_visual_geometry(head), run=LOOKING)
    motion = divergent_motion(twin)
    twin.restart(1)
    for k in range(pairs):
        twin.advance(twin.time_s + 0.5, motion(STEP_S * k))
        angles = twin.true_readings()
        frame = twin.capture((left, right))
        visual = None if visual is None else update_geometry(visual, frame)
        truth = DepthTruth(twin.truth, angles, twin.true_depth(left))
        found = depth_by(frame, head, frame.eye_angles, reading_std=reading_std)
        errors["joints"].append(depth_errors(*found, truth))
        true = depth_by(frame, truth.head, truth.eye_angles)
        errors["true_geometry"].append(depth_errors(*true, truth))
        if visual is not None:
            found = depth_by(frame, head, frame.eye_angles, seen=visual.latest)
            errors["seen"].append(depth_errors(*found, truth))
        yield replace(frame, time_s=STEP_S * k), found
