"""Record dense depth: rectified pairs, disparity, depth and its deviation, and the points.

    /rectified/<side>/image   the rectified images
    /rectified/disparity      disparities [px / 16]; 0: not matched
    /rectified/depth          depth [mm]
    /rectified/std            its standard deviation [mm]
    /world/points             the points, coloured
    /world/<side>_eye         the eyes

The world is the left eye's base frame.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path

import cv2
import numpy as np
import rerun as rr

from vergence.arrays import Array
from vergence.geometry.eye_motion import eye_poses
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES
from vergence.geometry.projection import T_lbase_eye
from vergence.stereo.dense_depth import DenseDepth, point_cloud
from vergence.stereo.rectification import RectifiedPair, rectified_image
from vergence.viewer.layouts import depth_blueprint
from vergence.viewer.recording import log_image, recording_file, set_time
from vergence.viewer.shapes import placed

FARTHEST_M = 4.0
"""Largest distance of a drawn point [m]: beyond it points of a short baseline scatter by metres."""
POINTS = 30_000
"""Number of drawn points of a pair, within a factor of two."""


def depth_recording(
    path: Path, head: HeadCalibration
) -> AbstractContextManager[rr.RecordingStream]:
    """Record dense depth in a `with` block, as `recording_file` does."""
    return recording_file(path, "depth", depth_blueprint(), head)


def log_depth(
    rec: rr.RecordingStream,
    head: HeadCalibration,
    *,
    time_s: float,
    index: int,
    joints: Array,
    pair: RectifiedPair,
    right: np.ndarray,
    found: DenseDepth,
) -> None:
    """Record one pair; `right` is that camera's own image (H, W, 3) uint8."""
    set_time(rec, time_s, index)
    for eye, T in zip(EYES, eye_poses(head, joints), strict=True):
        rec.log(f"world/{eye}_eye", placed(T_lbase_eye(eye, head.T_rbase_lbase, T)))
    log_image(rec, "rectified/left", found.image)
    log_image(rec, "rectified/right", rectified_image(pair.right, right))
    std_m = np.where(np.isfinite(found.depth_m), found.std_m, np.nan)
    for name, values, unit in (
        ("disparity", 16 * found.disparity_px, 16.0),
        ("depth", 1e3 * found.depth_m, 1e3),
        ("std", 1e3 * std_m, 1e3),
    ):
        levels = np.nan_to_num(values, nan=0.0, posinf=0.0).clip(0, 65535).astype(np.uint16)
        png = cv2.imencode(".png", levels)[1].tobytes()
        depth_image = rr.EncodedDepthImage(blob=png, media_type="image/png", meter=unit)
        rec.log(f"rectified/{name}", depth_image)
    points, colours = point_cloud(pair, found)
    near = np.flatnonzero(np.linalg.norm(points, axis=-1) < FARTHEST_M)
    near = near[:: 1 + len(near) // POINTS]
    cloud = rr.Points3D(points[near].astype(np.float32), colors=colours[near], radii=-1.5)
    rec.log("world/points", cloud)
