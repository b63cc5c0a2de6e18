"""Record a dataset with its calibration: images, detected corners and their residuals.

The world is the left eye's base frame. A row of frames.csv is a `frame`. Curves are below
/residual [px] and /joints [rad].
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr

from vergence.arrays import Array
from vergence.calibration.calibrate import CalibrationResult
from vergence.data.dataset import Dataset
from vergence.geometry.board import Board, corner_points
from vergence.geometry.kinematics import EYES
from vergence.geometry.projection import eye_pose_in_left_base
from vergence.progress import Progress, silent
from vergence.viewer import style
from vergence.viewer.layouts import camera_entities, dataset_blueprint
from vergence.viewer.recording import (
    log_curve,
    log_image,
    log_report,
    recording_file,
    set_time,
    time_columns,
)
from vergence.viewer.shapes import placed


def record_dataset(
    path: Path,
    dataset: Dataset,
    result: CalibrationResult,
    *,
    report: str,
    progress: Progress = silent,
) -> None:
    """Write a recording of a dataset, of its calibration and of the report in markdown.

    Images that cannot be read are left out; without bundle adjustment there are no residuals.
    VergenceError if the file cannot be written.
    """
    head, estimate, corners = result.head, result.estimate, result.observations.corners
    residuals, eyes = {}, result.observations.eye_poses(head)
    if estimate is not None:
        residuals = estimate.residuals_px
        eyes = np.where(np.isfinite(estimate.T_base_eye), estimate.T_base_eye, eyes)
    with recording_file(path, "dataset", dataset_blueprint(head), head) as rec:
        if estimate is not None:
            rec.log("world/board/shape", _outline(result.observations.board), static=True)
        time_s = dataset.time_s - dataset.time_s[0]
        for row in range(len(dataset)):
            set_time(rec, float(time_s[row]), row)
            for eye, T in zip(EYES, eyes[row], strict=True):
                if np.isfinite(T).all():
                    rec.log(
                        f"world/{eye}_eye",
                        placed(eye_pose_in_left_base(eye, head.T_rbase_lbase, T)),
                    )
            if estimate is not None:
                T = estimate.T_lbase_target.get(int(dataset.placement[row]))
                rec.log("world/board", rr.Clear(recursive=False) if T is None else placed(T))
            for name, entity in camera_entities(head).items():
                offset = style.MAGNIFICATION * residuals[name][row] if name in residuals else None
                image = dataset.readable_image(name, row)
                _log_view(rec, entity, image, corners[name][row], offset)
            progress("writing the report", row + 1, len(dataset))
        curves = {f"residual/{name}": rms_by_view(errors) for name, errors in residuals.items()}
        if dataset.T_base_eye is None:
            names = dataset.description.head_kinematics.readings
            curves |= {f"joints/{name}": dataset.eye_angles[:, k] for k, name in enumerate(names)}
        for entity, values in curves.items():
            known = np.flatnonzero(np.isfinite(values))
            if len(known):
                name = entity.partition("/")[2].replace("_", " ")
                rec.log(entity, rr.SeriesPoints(names=name, marker_sizes=3), static=True)
                log_curve(rec, entity, time_columns(time_s[known], known), values[known])
        log_report(rec, report)


def _outline(board: Board) -> rr.LineStrips3D:
    """Draw the outline of the board's inner corners, in frame target."""
    corners = corner_points(board).reshape(board.rows, board.columns, 3)
    strips = [*corners[:, [0, -1]], *corners[[0, -1]].swapaxes(0, 1)]
    return rr.LineStrips3D(strips, colors=style.OBJECT, radii=-1.0)


def _log_view(
    rec: rr.RecordingStream,
    entity: str,
    image: np.ndarray | None,
    corners: Array,
    offset: Array | None,
) -> None:
    if image is None:
        for part in ("image", "corners", "residuals"):
            rec.log(f"{entity}/{part}", rr.Clear(recursive=False))
        return
    log_image(rec, entity, image)
    at = corners + 0.5  # a pixel's centre in the viewer
    seen = np.isfinite(at).all(axis=1)
    rec.log(f"{entity}/corners", rr.Points2D(at[seen], colors=style.DETECTED, radii=-2.0))
    if offset is not None:
        used = seen & np.isfinite(offset).all(axis=1)
        strips = list(np.stack([at[used], at[used] + offset[used]], axis=1).astype(np.float32))
        lines = rr.LineStrips2D(strips, colors=style.RAY, radii=-1.0)
        rec.log(f"{entity}/residuals", lines)


def rms_by_view(errors: Array) -> Array:
    """Compute the root mean square (V,) [px] of residuals (V, K, 2); NaN: no corner is seen."""
    squares = np.ma.masked_invalid((errors**2).sum(axis=2))
    return np.ma.sqrt(squares.mean(axis=1)).filled(np.nan)
