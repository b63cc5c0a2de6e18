"""Record dense depth: rectified pairs, disparity, depth and its deviation, and the points.

    /rectified/<side>/image   the rectified images
    /rectified/disparity      disparities [px / 16], 0 where there is none
    /rectified/depth          depth [mm]
    /rectified/std            its standard deviation [mm]
    /world/points             the points, coloured
    /world/<side>_eye         the eyes
    /report                   report in markdown

The world is the left eye's base frame.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vergence.arrays import Array
from vergence.geometry.eye_motion import eye_poses
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES
from vergence.geometry.projection import T_lbase_eye
from vergence.stereo.dense_depth import DenseDepth, point_cloud
from vergence.stereo.rectification import RectifiedPair, rectified_image
from vergence.viewer.frame import log_image
from vergence.viewer.layout import playing, view_3d
from vergence.viewer.opening import recording_file
from vergence.viewer.shapes import placed

FARTHEST_M = 4.0
"""Farther points are not drawn: of a short baseline they scatter over metres."""
POINTS = 30_000
"""About how many points of a pair are drawn."""


def depth_recording(
    path: Path, head: HeadCalibration
) -> AbstractContextManager[rr.RecordingStream]:
    """Record dense depth in a `with` block, as `recording_file` does."""
    return recording_file(path, "depth", _blueprint(), head, ())


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
    """Record one pair: `right` is the right camera's own image (H, W, 3) uint8."""
    rec.set_time("sim_time", duration=time_s)
    rec.set_time("frame", sequence=index)
    for eye, T in zip(EYES, eye_poses(head, joints), strict=True):
        rec.log(f"world/{eye}_eye", placed(T_lbase_eye(eye, head.T_rbase_lbase, T)))
    log_image(rec, "rectified/left", found.image)
    log_image(rec, "rectified/right", rectified_image(pair.right, right))
    for name, values, unit in (
        ("disparity", 16 * found.disparity_px, 16.0),
        ("depth", 1e3 * found.depth_m, 1e3),
        ("std", 1e3 * found.std_m * np.where(np.isfinite(found.depth_m), 1, np.nan), 1e3),
    ):
        whole = np.nan_to_num(values, nan=0.0, posinf=0.0).clip(0, 65535).astype(np.uint16)
        png = cv2.imencode(".png", whole)[1].tobytes()
        rec.log(
            f"rectified/{name}",
            rr.EncodedDepthImage(blob=png, media_type="image/png", meter=unit),
        )
    points, colours = point_cloud(pair, found)
    near = np.flatnonzero(np.linalg.norm(points, axis=-1) < FARTHEST_M)
    near = near[:: 1 + len(near) // POINTS]
    cloud = rr.Points3D(points[near].astype(np.float32), colors=colours[near], radii=-1.5)
    rec.log("world/points", cloud)


def _blueprint() -> rrb.Blueprint:
    space = view_3d(
        "points in the left eye's base frame",
        origin="world",
        contents=["+ $origin/**"],
        middle=np.array([0.9, 0.0, -0.2]),
        eye=np.array([-0.5, 0.5, 0.5]),
        trails={},
    )
    images = [
        rrb.Spatial2DView(name=title, origin=f"rectified/{entity}")
        for title, entity in (
            ("left, rectified", "left"),
            ("right, rectified", "right"),
            ("disparity [px / 16]", "disparity"),
            ("depth [mm]", "depth"),
            ("standard deviation of the depth [mm]", "std"),
        )
    ]
    report = rrb.TextDocumentView(name="report", origin="report")
    grid = rrb.Grid(*images, report, grid_columns=2)
    return playing(rrb.Horizontal(space, grid), timeline="frame", fps=2.0)
