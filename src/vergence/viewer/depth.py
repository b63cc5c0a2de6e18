"""Record dense depth: rectified pairs, disparity, depth and its deviation, and the points.

The world is the left eye's base frame.
"""

from __future__ import annotations

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vergence.data.dataset import Frame
from vergence.geometry.eye_motion import eye_poses
from vergence.geometry.kinematics import EYES
from vergence.geometry.projection import eye_pose_in_left_base
from vergence.stereo.dense_depth import DenseDepth, point_cloud
from vergence.stereo.rectification import RectifiedPair, rectified_image
from vergence.viewer.layouts import playing, report_view, view_3d
from vergence.viewer.recording import log_image, set_time
from vergence.viewer.shapes import placed


def depth_blueprint() -> rrb.Blueprint:
    """Lay out dense depth."""
    space = view_3d(
        "points in the left eye's base frame",
        middle=np.array([0.9, 0.0, -0.2]),
        eye=np.array([-0.5, 0.5, 0.5]),
    )
    titles = {
        "left": "left, rectified",
        "right": "right, rectified",
        "disparity": "disparity [px / 16]",
        "depth": "depth [mm]",
        "std": "standard deviation of the depth [mm]",
    }
    images = [
        rrb.Spatial2DView(name=title, origin=f"rectified/{entity}")
        for entity, title in titles.items()
    ]
    grid = rrb.Grid(*images, report_view(), grid_columns=2)
    return playing(rrb.Horizontal(space, grid), timeline="frame", fps=2.0)


def log_depth(
    rec: rr.RecordingStream,
    *,
    index: int,
    frame: Frame,
    pair: RectifiedPair,
    found: DenseDepth,
) -> None:
    """Record one pair, its depth, and the eyes as the pair was rectified."""
    set_time(rec, frame.time_s, index)
    for eye, T in zip(EYES, eye_poses(pair.head, pair.joints), strict=True):
        rec.log(f"world/{eye}_eye", placed(eye_pose_in_left_base(eye, pair.head.T_rbase_lbase, T)))
    log_image(rec, "rectified/left", found.image)
    log_image(rec, "rectified/right", rectified_image(pair.right, frame.images[pair.cameras[1]]))
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
    # Beyond 4 m points of a short baseline scatter by metres.
    near = np.flatnonzero(np.linalg.norm(points, axis=-1) < 4)
    near = near[:: 1 + len(near) // 30_000]
    cloud = rr.Points3D(points[near].astype(np.float32), colors=colours[near], radii=-1.5)
    rec.log("world/points", cloud)
