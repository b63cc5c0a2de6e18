"""Record one replayed figure: layout, curves, trails and statistics."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYE_JOINTS
from vergence.paper.figures import Figure
from vergence.paper.replay import Replay, as_plain
from vergence.self_calibration.state import FilterState
from vergence.twin.appearance import VisualGeom
from vergence.viewer import style
from vergence.viewer.layouts import (
    camera_views,
    curves_view,
    hidden,
    learned_views,
    playing,
    report_view,
    view_3d,
)
from vergence.viewer.recording import log_curve, recording_file, time_columns
from vergence.viewer.seen import log_seen_styles
from vergence.viewer.shapes import lines_of_sight, log_points_style, placed, spread_ellipsoid

_TRAILS = {"world/left_base/trail": None, "world/left_base/recent": 10.0}
"""Time for which points of these entities stay visible [s]; None: for ever."""


@contextmanager
def figure_recording(
    path: Path,
    figure: Figure,
    head: HeadCalibration,
    geoms: Sequence[VisualGeom],
    *,
    beside: str | None = None,
    known: FilterState | None = None,
) -> Iterator[rr.RecordingStream]:
    """Record a figure in a `with` block, as `recording_file` does.

    `beside` is a method whose estimates are shown with those of the result; `known` is a head that
    learns from the images, and its matches and parameters are shown.
    """
    layout = blueprint(figure, head, beside=beside, learns=known is not None)
    with recording_file(path, figure.title, layout, head, geoms) as rec:
        _log_styles(rec)
        if known is not None:
            log_seen_styles(rec, head, known)
        yield rec


def _log_styles(rec: rr.RecordingStream) -> None:
    for axis, color in style.AXIS_COLOURS.items():
        # By default plots average the samples that share a pixel; MinMax keeps the extremes.
        curve = rr.SeriesLines(names=axis, colors=color, widths=1.5, aggregation_policy="MinMax")
        rec.log(f"estimate/{axis}", curve, static=True)
        for entity, color3, name in (
            (f"estimate_mean/{axis}", style.PALE[axis], "mean"),
            (f"paper/{axis}", style.PAPER, "paper's mean"),
        ):
            names = [name, f"{name} + std", f"{name} - std"]
            levels = rr.SeriesLines(names=names, colors=[color3] * 3, widths=[2.5, 1.5, 1.5])
            rec.log(entity, levels, static=True)
        other = rr.SeriesLines(colors=style.RAY, widths=1.0, aggregation_policy="MinMax")
        rec.log(f"beside/{axis}", other, static=True)
    for joint, color in style.JOINT_COLOURS.items():
        curve = rr.SeriesLines(names=joint.replace("_", " "), colors=color)
        rec.log(f"joints/{joint}", curve, static=True)
    log_points_style(rec, "world/left_base/trail", 1.5, style.OLD)
    log_points_style(rec, "world/left_base/recent", 2.5, style.ESTIMATE)
    log_points_style(rec, "world/left_base/estimate", 6.0, style.ESTIMATE)
    rays = rr.LineStrips3D.from_fields(colors=style.RAY, radii=-1.0)
    rec.log("world/left_base/rays", rays, static=True)


def log_results(
    rec: rr.RecordingStream,
    result: Replay,
    head: HeadCalibration,
    T_world_lbase: Array,
    *,
    beside: str | None = None,
) -> None:
    """Record a figure's estimates as curves and as a trail in space, and its statistics.

    Samples that were not located are left out. The head is that of the lines of sight;
    `T_world_lbase` (4, 4) is the pose of the left eye's base frame in the world. `beside` is a
    method whose estimates are recorded as curves too.
    """
    figure, statistics = result.figure, result.statistics
    time_s, eye_angles = result.measurements.time_s, result.measurements.eye_angles
    index = np.arange(len(time_s))
    for joint, angles in zip(EYE_JOINTS, eye_angles.T, strict=True):
        log_curve(rec, f"joints/{joint}", time_columns(time_s, index), angles)
    good = np.isfinite(result.points).all(axis=1)
    times, points = time_columns(time_s[good], index[good]), result.points[good]
    for k, axis in enumerate(style.AXIS_COLOURS):
        log_curve(rec, f"estimate/{axis}", times, points[:, k])
        for kind, mean, std in (
            ("estimate_mean", statistics.mean_m[k], statistics.std_m[k]),
            ("paper", figure.mean_m[k], figure.std_m[k]),
        ):
            levels = np.tile([mean, mean + std, mean - std], (2, 1))
            if len(time_s) and np.isfinite(levels).all():
                ends = time_columns(time_s[[0, -1]], index[[0, -1]])
                log_curve(rec, f"{kind}/{axis}", ends, levels)
    others = np.full((0, 3), np.nan) if beside is None else result.others[beside]
    there = np.isfinite(others).all(axis=1)
    for k, axis in enumerate(style.AXIS_COLOURS if there.any() else ()):
        log_curve(
            rec, f"beside/{axis}", time_columns(time_s[there], index[there]), others[there, k]
        )
    rec.log("world/left_base", placed(T_world_lbase), static=True)
    marker = rr.Points3D([figure.mean_m], radii=-4.0, colors=style.OBJECT)
    rec.log("world/left_base/object", marker, static=True)
    if len(points) > 3:
        rec.log("world/left_base/spread", spread_ellipsoid(points), static=True)
    for name in ("trail", "recent", "estimate"):
        entity = f"world/left_base/{name}"
        rec.send_columns(entity, times, rr.Points3D.columns(positions=points))
    rays = rr.LineStrips3D.columns(strips=list(lines_of_sight(head, points, eye_angles[good])))
    rec.send_columns("world/left_base/rays", times, rays)
    values: dict[str, Any] = {"figure": figure.number, **as_plain(figure, result.statistics)}
    rec.send_property("statistics", rr.AnyValues(**values))


def blueprint(
    figure: Figure, head: HeadCalibration, *, beside: str | None = None, learns: bool = False
) -> rrb.Blueprint:
    """Make the layout with which the viewer opens a figure's recording."""
    other = "" if beside is None else f", orange {beside}"
    kinds = ("paper", "estimate_mean", "estimate", "beside")
    axes = [
        curves_view(
            f"{label} [m]: bright estimate{other}, pale mean and ± std, grey the paper's",
            "/",
            legend=False,
            contents=[f"+ /{kind}/{axis}" for kind in kinds],
        )
        for axis, label in zip(style.AXIS_COLOURS, ("x = depth", "y", "z"), strict=True)
    ]
    marks = "+ found, ○ truth" + (", dots matched" if learns else "")
    learned = (learned_views(),) if learns else ()
    return playing(
        rrb.Horizontal(
            rrb.Vertical(
                _head_view(figure, head),
                camera_views(head, marks=marks),
                row_shares=[6, 7],
            ),
            rrb.Vertical(*axes, *learned, curves_view("joint readings [rad]", "joints")),
            rrb.Vertical(
                report_view(),
                _close_up(figure),
                row_shares=[5, 4],
            ),
            column_shares=[6, 5, 4],
        ),
        speed=3.0,  # the eyes' period of 2 pi s is slow to watch
    )


def _head_view(figure: Figure, head: HeadCalibration) -> rrb.Spatial3DView:
    back, front = -0.20, figure.mean_m[0] + 2 * figure.std_m[0]  # of what has to be in view
    scale = 0.10 + 0.74 * (front - back)
    # Seen from above, but looked at horizontally: a camera that is tilted down would show the
    # robot's post, which stands at the side of the view, leaning.
    height = style.EYE_HEIGHT_M - 0.03 + 0.20 * scale
    middle = np.array([(back + front) / 2, 0.3 * figure.mean_m[1], height])
    marks = hidden(head, "detected", "truth", "matches")
    return view_3d(
        f"{figure.title}: head, lines of sight, estimates",
        contents=("- world/left_base/spread", *marks),
        middle=middle,
        eye=middle + np.array([0.33, 0.94, 0.0]) * scale,
        trails=_TRAILS,
    )


def _close_up(figure: Figure) -> rrb.Spatial3DView:
    middle = np.array(figure.mean_m)
    return view_3d(
        "close-up: object, estimates and their 2-std ellipsoid",
        origin="world/left_base",
        contents=("+ world/object/**",),
        middle=middle,
        eye=middle + np.array([-0.25, 0.85, 0.45]) * (0.06 + 2.8 * figure.std_m[0]),
        trails=_TRAILS,
    )
