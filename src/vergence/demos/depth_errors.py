"""Errors of dense depth and of the rows of a rectified pair, from the truth of the twin."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vergence.arrays import Array
from vergence.geometry.camera import project, unproject
from vergence.geometry.head import HeadCalibration
from vergence.geometry.se3 import transform
from vergence.stereo.dense_depth import DenseDepth
from vergence.stereo.extrinsics import T_rcam_lcam, stereo_cameras
from vergence.stereo.rectification import RectifiedPair, rectified_pixels, rectified_points

RANGE_M = (0.5, 1.5)
"""Distances at which accuracy is stated [m]."""
_GRID_PX = 16
"""Distance between the points whose rows are compared [px]."""
_WRONG = 0.2
"""Relative error of depth above which a pixel is a mismatch."""
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
    v, u = np.mgrid[: left.height : _GRID_PX, : left.width : _GRID_PX]
    pixels = np.stack([u, v], axis=-1).reshape(-1, 2).astype(float)
    points = unproject(left, pixels) * truth.depth_m[v, u].reshape(-1, 1)
    T = T_rcam_lcam(truth.head, truth.eye_angles)
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
    wrong = np.abs(relative) > _WRONG
    within = np.abs(standardised[~wrong]) < 2
    return DepthErrors(
        median_relative=float(np.median(np.abs(relative))) if relative.size else np.nan,
        wrong=float(wrong.mean()) if relative.size else np.nan,
        within_two_std=float(within.mean()) if within.size else np.nan,
        pixels=len(relative),
        vertical_rms_px=float(np.sqrt(np.mean([each[2] ** 2 for each in found]))),
    )
