"""Record a dataset with its calibration: images, detected corners and their residuals.

In addition to the images there are

    /world/<side>_eye/<camera>/corners    detected corners
    /world/<side>_eye/<camera>/residuals  their residuals, magnified
    /world/board                          the board, in frame target
    /residual/<camera>                    root mean square of an image's residuals [px]
    /joints/<joint>                       joint readings [rad]
    /report                               report in markdown

The world is the left eye's base frame. A row of frames.csv is a `frame`.
"""

from __future__ import annotations

from itertools import cycle
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vergence.arrays import Array
from vergence.calibration.bundle_adjustment import BundleEstimate
from vergence.calibration.calibrate import CalibrationResult
from vergence.data.dataset import Dataset
from vergence.geometry.board import Board, corner_points
from vergence.geometry.head import HeadCalibration, cameras_of
from vergence.geometry.kinematics import EYES
from vergence.geometry.projection import T_lbase_eye
from vergence.progress import Progress, silent
from vergence.viewer import style
from vergence.viewer.frame import log_image, time_columns
from vergence.viewer.layout import (
    camera_entities,
    camera_views,
    curves_view,
    hidden,
    playing,
    view_3d,
)
from vergence.viewer.opening import log_report, recording_file
from vergence.viewer.shapes import placed

RESIDUAL_LENGTH_PX = 12
"""Drawn length of a typical residual, within a factor of three."""


def record_dataset(
    path: Path,
    dataset: Dataset,
    result: CalibrationResult,
    *,
    report: str,
    progress: Progress = silent,
) -> None:
    """Write a recording of a dataset, of its calibration and of the report, which is markdown.

    Without bundle adjustment only images and corners are recorded; images that cannot be read are
    left out. VergenceError if the file cannot be written.
    """
    head, estimate = result.head, result.estimate
    typical = 1.0 if estimate is None else max(estimate.pixel_std_px, 1e-6)
    magnified = int(10 ** max(0, round(np.log10(RESIDUAL_LENGTH_PX / typical))))
    layout = _blueprint(head, magnified if estimate else None)
    eyes = _eye_poses(result)
    entities = camera_entities(head)
    with recording_file(path, "dataset", layout, head, ()) as rec:
        _log_styles(rec, head, dataset)
        if estimate is not None:
            rec.log("world/board/shape", _outline(result.observations.board), static=True)
        time_s = dataset.time_s - dataset.time_s[0]
        for row in range(len(dataset)):
            rec.set_time("sim_time", duration=float(time_s[row]))
            rec.set_time("frame", sequence=row)
            for k, eye in enumerate(EYES):
                if np.isfinite(eyes[row, k]).all():
                    T = T_lbase_eye(eye, head.T_rbase_lbase, eyes[row, k])
                    rec.log(f"world/{eye}_eye", placed(T))
            if estimate is not None:
                T = estimate.T_lbase_target.get(int(dataset.placement[row]))
                rec.log("world/board", rr.Clear(recursive=False) if T is None else placed(T))
            for name, entity in entities.items():
                corners = result.observations.corners[name][row]
                errors = None if estimate is None else estimate.residuals_px.get(name)
                offset = None if errors is None else magnified * errors[row]
                _log_image(rec, entity, dataset.readable_image(name, row), corners, offset)
            progress("writing the report", row + 1, len(dataset))
        _log_series(rec, dataset, estimate, time_s)
        log_report(rec, report)


def _eye_poses(result: CalibrationResult) -> Array:
    """Return poses (V, 2, 4, 4) of the eyes in their bases, as read where not estimated."""
    poses = result.observations.eye_poses(result.head)
    if result.estimate is None:
        return poses
    estimated = result.estimate.T_base_eye
    return np.where(np.isfinite(estimated), estimated, poses)


def _outline(board: Board) -> rr.LineStrips3D:
    """Return the lines through the board's inner corners, in frame target."""
    corners = corner_points(board).reshape(board.rows, board.columns, 3)
    strips = [*corners[:, [0, -1]], *corners[[0, -1]].swapaxes(0, 1)]
    return rr.LineStrips3D(strips, colors=style.OBJECT, radii=-1.0)


def _log_image(
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
    rec.log(f"{entity}/corners", rr.Points2D.from_fields(positions=at[seen]))
    if offset is not None:
        used = seen & np.isfinite(offset).all(axis=1)
        strips = list(np.stack([at[used], at[used] + offset[used]], axis=1).astype(np.float32))
        rec.log(f"{entity}/residuals", rr.LineStrips2D.from_fields(strips=strips))


def _log_styles(rec: rr.RecordingStream, head: HeadCalibration, dataset: Dataset) -> None:
    for entity in camera_entities(head).values():
        dots = rr.Points2D.from_fields(colors=style.DETECTED, radii=-2.0)
        rec.log(f"{entity}/corners", dots, static=True)
        lines = rr.LineStrips2D.from_fields(colors=style.RAY, radii=-1.0)
        rec.log(f"{entity}/residuals", lines, static=True)
    readings = dataset.description.head_kinematics.readings
    joints = [joint for joint in readings if joint in dataset.description.sources]
    others = cycle(style.JOINT_COLOURS.values())
    colours = {
        f"joints/{joint}": style.JOINT_COLOURS.get(joint) or next(others) for joint in joints
    }
    for eye in EYES:
        own = [f"residual/{name}" for name in cameras_of(head, eye)]
        colours |= zip(own, 9 * style.EYE_COLOURS[eye], strict=False)
    for entity, colour in colours.items():
        name = entity.partition("/")[2].replace("_", " ")
        points = rr.SeriesPoints(names=name, colors=colour, marker_sizes=3)
        rec.log(entity, points, static=True)


def rms_by_view(errors: Array) -> Array:
    """Return the root mean square (V,) [px] of residuals (V, K, 2); NaN: the view has none."""
    squares = (errors**2).sum(axis=2)
    seen = np.isfinite(squares)
    total = np.where(seen, squares, 0.0).sum(axis=1)
    return np.where(seen.any(axis=1), np.sqrt(total / np.maximum(seen.sum(axis=1), 1)), np.nan)


def _log_series(
    rec: rr.RecordingStream, dataset: Dataset, estimate: BundleEstimate | None, time_s: Array
) -> None:
    rows = np.arange(len(dataset))
    curves: dict[str, Array] = {}
    if dataset.T_base_eye is None:
        names = dataset.description.head_kinematics.readings
        curves |= {f"joints/{name}": dataset.eye_angles[:, k] for k, name in enumerate(names)}
    for name, errors in ({} if estimate is None else estimate.residuals_px).items():
        curves[f"residual/{name}"] = rms_by_view(errors)
    for entity, values in curves.items():
        known = np.isfinite(values)
        if known.any():
            times = time_columns(time_s[known], rows[known])
            rec.send_columns(entity, times, rr.Scalars.columns(scalars=values[known]))


def _blueprint(head: HeadCalibration, magnified: int | None) -> rrb.Blueprint:
    marks = "dots: corners"
    if magnified is not None:
        marks += f", lines: residuals x {magnified}"
    space = view_3d(
        "estimated poses of eyes and board",
        origin="world",
        contents=["+ $origin/**", *hidden(head, "corners", "residuals")],
        middle=np.array([0.35, -0.04, 0.0]),
        eye=np.array([-0.1, 0.5, 0.3]),
        trails={},
    )
    return playing(
        rrb.Horizontal(
            rrb.Vertical(space, camera_views(head, marks=marks), row_shares=[5, 8]),
            rrb.Vertical(
                curves_view("residuals of an image, rms [px]", "residual"),
                curves_view("joint readings [rad]", "joints"),
                rrb.TextDocumentView(name="report", origin="report"),
                row_shares=[3, 3, 5],
            ),
            column_shares=[6, 5],
        ),
        timeline="frame",
        fps=2.0,
    )
