"""Dense depth of stereo pairs, by the joint readings or by the geometry that both eyes see."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Dataset, Frame, stereo_rows
from vergence.errors import VergenceError
from vergence.geometry.camera import unproject
from vergence.geometry.eye_motion import eye_motions, measured
from vergence.geometry.head import HeadCalibration, reading_stds
from vergence.geometry.se3 import pose
from vergence.self_calibration.calibrator import Geometry, initial_visual_geometry, update_geometry
from vergence.self_calibration.frame import locate_in_frame
from vergence.self_calibration.prior import JOINT_STD_RAD
from vergence.self_calibration.robust_fit import FEWEST
from vergence.self_calibration.state import FrameEstimate
from vergence.stereo.dense_depth import DenseDepth, dense_depth
from vergence.stereo.rectification import RectifiedPair, rectify
from vergence.vision.matching.scene_features import match_scene

RANGE_M = (0.5, 1.5)
"""Distances at which accuracy is stated [m]."""


PairDepth = tuple[RectifiedPair, DenseDepth]
"""A rectified pair, and the depth of its pixels."""


@dataclass(frozen=True, eq=False)
class DepthSequence:
    """Dense depth of pairs in order of time."""

    head: HeadCalibration
    found: Iterator[tuple[Frame, PairDepth]]
    """Frames with their rectified pairs and depths, computed as they are taken."""
    count: int
    left_out: int = 0
    """Further pairs at whose postures the views cannot be rectified."""
    errors: Callable[[], dict[str, Any]] = dict
    """Returns the errors of the pairs so far by geometry, where the truth is known."""


def dataset_depth(
    dataset: Dataset, head: HeadCalibration, pairs: int, geometry: Geometry
) -> DepthSequence:
    """Compute the depth of at most `pairs` evenly spaced pairs of a dataset.

    "seen" learns the geometry from all rows up to each pair. VergenceError if the dataset has no
    pair that can be rectified, or has measured poses, which "seen" cannot correct.
    """
    both = stereo_rows(dataset, head)
    if geometry == "seen" and measured(both.joints):
        raise VergenceError(f"--geometry seen corrects joint readings; {dataset.folder} has poses.")
    wanted = np.unique(np.linspace(0, len(both.rows) - 1, pairs).round().astype(int))
    errors = [_rectification_error(head, both.joints[k]) for k in wanted]
    chosen = [int(k) for k, error in zip(wanted, errors, strict=True) if error is None]
    if errors[0] is not None and not chosen:
        raise errors[0]
    before = initial_visual_geometry(head) if geometry == "seen" else None

    def read() -> Iterator[tuple[Frame, PairDepth]]:
        known = before
        for k in chosen if known is None else range(chosen[-1] + 1):
            frame = both.frame(k)
            known = None if known is None else update_geometry(known, frame)
            if k in chosen:
                frame = replace(frame, time_s=frame.time_s - float(dataset.time_s[0]))
                seen = None if known is None else known.latest
                yield frame, depth_by(frame, head, both.joints[k], seen=seen)

    return DepthSequence(head, read(), len(chosen), len(wanted) - len(chosen))


def _rectification_error(head: HeadCalibration, joints: Array) -> VergenceError | None:
    try:
        rectify(head, joints)
    except VergenceError as error:
        return error
    return None


def depth_by(
    frame: Frame,
    head: HeadCalibration,
    joints: Array,
    *,
    reading_std: float | None = None,
    seen: FrameEstimate | None = None,
) -> PairDepth:
    """Compute the depth of a frame by a head and joints, or by what both eyes see of these.

    Joints are readings [rad] or measured poses (2, 4, 4), and their noise is that of `dense_depth`.
    """
    located = None
    if seen is not None:
        head, joints = seen.head, seen.joints
        located = partial(locate_in_frame, seen, pixel_std_px=0.0)
    pair = rectify(head, joints)
    left, right = (frame.images[name] for name in pair.cameras)
    return pair, dense_depth(pair, left, right, reading_std=reading_std, located=located)


def row_difference_rad(frame: Frame, pair: RectifiedPair) -> float:
    """Measure the angle between the rows of matched features, in the median [rad].

    NaN if too few features are matched. The search allows for a geometry wrong by some degrees.
    """
    views = pair.left, pair.right
    R_lrect_lcam, R_rrect_rcam = (view.R_rect_cam for view in views)
    left, right = (frame.images[name] for name in pair.cameras)
    matches = match_scene(
        left,
        right,
        left_camera=pair.left.camera,
        right_camera=pair.right.camera,
        T_rcam_lcam=pose(
            R_rrect_rcam.T @ R_lrect_lcam, -R_rrect_rcam.T @ np.array([pair.baseline_m, 0, 0])
        ),
    )
    if len(matches.left) < FEWEST:
        return np.nan
    rays = [
        unproject(view.camera, pixels) @ view.R_rect_cam.T
        for view, pixels in zip(views, (matches.left, matches.right), strict=True)
    ]
    above = [np.arctan2(each[:, 1], each[:, 2]) for each in rays]
    return float(np.nanmedian(np.abs(above[1] - above[0])))


def largest_row_difference_rad(pair: RectifiedPair) -> float:
    """Compute the angle [rad] between rows from which a calibration is doubted.

    It is 4.2 standard deviations by the noise of readings, where noise alone makes a median of 0.7,
    and at least 0.1 degrees. A tilt that both eyes share turns the rows of both alike.
    """
    return max(4.2 * _row_noise_rad(pair), float(np.radians(0.1)))


def _row_noise_rad(pair: RectifiedPair) -> float:
    """Compute the standard deviation [rad] of the angle between rows by the noise of readings."""
    if measured(pair.joints):
        return JOINT_STD_RAD
    head, factors = pair.head, pair.head.kinematics.gear_ratios
    stds = reading_stds(head)
    stds = stds if stds.any() else JOINT_STD_RAD / factors
    along = pair.T_lbase_rect[:3, 0]
    axes = along, head.T_rbase_lbase[:3, :3] @ along
    by_readings = np.zeros(len(factors))
    eyes = eye_motions(head, pair.joints, errors=False)
    for sign, axis, eye in zip((1, -1), axes, eyes, strict=True):
        by_readings += sign * axis @ eye.by_readings(eye.by_moves)[:3]
    return float(np.linalg.norm(by_readings * stds))
