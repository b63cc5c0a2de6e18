"""Record one figure: its frames, its series, its report."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYE_JOINTS
from vergence.paper.figures import Figure
from vergence.paper.statistics import Statistics

if TYPE_CHECKING:  # the twin, and with it mujoco, is not needed to record a real head
    from vergence.twin.appearance import VisualGeom
from vergence.viewer import style
from vergence.viewer.frame import time_columns
from vergence.viewer.layout import camera_entities, camera_views, view_3d, whole_time
from vergence.viewer.opening import recording_file
from vergence.viewer.shapes import lines_of_sight, placed, spread_ellipsoid

_TRAILS = {"world/left_base/trail": None, "world/left_base/recent": style.TRAIL_S}


@contextmanager
def figure_recording(
    path: Path, figure: Figure, head: HeadCalibration, geoms: Sequence[VisualGeom]
) -> Iterator[rr.RecordingStream]:
    """Record a figure in a `with` block.

    The file appears under its name only when the block ends well: an interrupted run leaves no
    half a file.

    Args:
        path: of the `.rrd` file; one that is there is replaced.
        figure: which one.
        head: whose cameras are drawn, as it is believed to be.
        geoms: the head's shapes.

    Raises:
        VergenceError: the file cannot be written.
    """
    layout = blueprint(figure, head)
    with recording_file(path, title(figure), layout, head, geoms) as rec:
        log_styles(rec)
        yield rec


def log_styles(rec: rr.RecordingStream) -> None:
    for axis, color in style.AXIS_COLOURS.items():
        # Plots average the samples that share a pixel, unless told to keep the extremes.
        curve = rr.SeriesLines(names=axis, colors=color, widths=1.5, aggregation_policy="MinMax")
        rec.log(f"estimate/{axis}", curve, static=True)
        for entity, color3, name in (
            (f"estimate_mean/{axis}", style.PALE[axis], "mean"),
            (f"paper/{axis}", style.PAPER, "paper's mean"),
        ):
            names = [name, f"{name} + std", f"{name} - std"]
            levels = rr.SeriesLines(names=names, colors=[color3] * 3, widths=[2.5, 1.5, 1.5])
            rec.log(entity, levels, static=True)
    for joint, color in style.JOINT_COLOURS.items():
        curve = rr.SeriesLines(names=joint.replace("_", " "), colors=color)
        rec.log(f"joints/{joint}", curve, static=True)
    for name, radius_px, color in (
        ("trail", 1.5, style.OLD),
        ("recent", 2.5, style.ESTIMATE),
        ("estimate", 6.0, style.ESTIMATE),
    ):
        points = rr.Points3D.from_fields(radii=-radius_px, colors=color)  # negative: in pixels
        rec.log(f"world/left_base/{name}", points, static=True)
    rays = rr.LineStrips3D.from_fields(colors=style.RAY, radii=-1.0)
    rec.log("world/left_base/rays", rays, static=True)


def log_series(
    rec: rr.RecordingStream,
    *,
    figure: Figure,
    head: HeadCalibration,
    time_s: Array,
    points: Array,
    object_m: Array,
    eye_angles: Array,
    T_world_lbase: Array,
    statistics: Statistics,
) -> None:
    """Record what was estimated, as curves and as a trail in space.

    Args:
        rec: the recording.
        figure: which one, for the paper's values beside ours.
        head: the calibration, for the lines of sight.
        time_s: (N,) since the first sample.
        points: (N, 3) estimates in the left eye's base frame; samples with NaN are left out.
        object_m: (3,) where the object truly is, in the same frame.
        eye_angles: (N, 4) joint readings.
        T_world_lbase: (4, 4) where that frame is.
        statistics: of the points.
    """
    index = np.arange(len(time_s))
    for joint, angles in zip(EYE_JOINTS, eye_angles.T, strict=True):
        scalars = rr.Scalars.columns(scalars=angles)
        rec.send_columns(f"joints/{joint}", time_columns(time_s, index), scalars)
    good = np.isfinite(points).all(axis=1)
    times, points = time_columns(time_s[good], index[good]), points[good]
    for k, axis in enumerate(style.AXIS_COLOURS):
        rec.send_columns(f"estimate/{axis}", times, rr.Scalars.columns(scalars=points[:, k]))
        for kind, mean, std in (
            ("estimate_mean", statistics.mean_m[k], statistics.std_m[k]),
            ("paper", figure.mean_m[k], figure.std_m[k]),
        ):
            levels = np.tile([mean, mean + std, mean - std], (2, 1))
            if len(time_s) and np.isfinite(levels).all():
                ends = time_columns(time_s[[0, -1]], index[[0, -1]])
                rec.send_columns(f"{kind}/{axis}", ends, rr.Scalars.columns(scalars=levels))
    rec.log("world/left_base", placed(T_world_lbase), static=True)
    marker = rr.Points3D([object_m], radii=-4.0, colors=style.OBJECT)
    rec.log("world/left_base/object", marker, static=True)
    if len(points) > 3:
        rec.log("world/left_base/spread", spread_ellipsoid(points), static=True)
    for name in ("trail", "recent", "estimate"):
        entity = f"world/left_base/{name}"
        rec.send_columns(entity, times, rr.Points3D.columns(positions=points))
    rays = rr.LineStrips3D.columns(strips=list(lines_of_sight(head, points, eye_angles[good])))
    rec.send_columns("world/left_base/rays", times, rays)


def log_report(rec: rr.RecordingStream, markdown: str) -> None:
    """Record the report of a figure."""
    rec.log("report", rr.TextDocument(markdown, media_type=rr.MediaType.MARKDOWN), static=True)


def log_statistics(
    rec: rr.RecordingStream, *, figure: Figure, object_m: Array, statistics: Statistics
) -> None:
    """Record a figure's statistics as a property of the recording."""
    rec.send_property(
        "statistics",
        rr.AnyValues(
            figure=figure.number,
            paper_mean_m=np.array(figure.mean_m),
            paper_std_m=np.array(figure.std_m),
            object_m=object_m,
            mean_m=statistics.mean_m,
            std_m=statistics.std_m,
            samples=statistics.samples,
            dropped=statistics.dropped,
        ),
    )


def title(figure: Figure) -> str:
    return f"Fig. {figure.number} - {figure.motion}, {figure.lens.removesuffix('mm')} mm"


def blueprint(figure: Figure, head: HeadCalibration) -> rrb.Blueprint:
    """Return the layout of a figure's recording, complete as it opens.

    Args:
        figure: the one that is recorded; its object and the head fill the 3-D view.
        head: whose cameras are shown.
    """
    whole = whole_time()
    axes = [
        rrb.TimeSeriesView(
            name=f"{label} [m]: bright estimate, pale mean and ± std, grey the paper's",
            origin="/",
            contents=[f"+ /{kind}/{axis}" for kind in ("paper", "estimate_mean", "estimate")],
            axis_x=whole,
            plot_legend=rrb.PlotLegend(visible=False),
        )
        for axis, label in zip(style.AXIS_COLOURS, ("x = depth", "y", "z"), strict=True)
    ]
    joints = rrb.TimeSeriesView(name="joint readings [rad]", origin="joints", axis_x=whole)
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                _head_view(figure, head),
                rrb.Grid(*camera_views(head, marks="+ found, ○ truth"), grid_columns=2),
                row_shares=[6, 7],
            ),
            rrb.Vertical(*axes, joints),
            rrb.Vertical(
                rrb.TextDocumentView(name="report", origin="report"),
                _close_up(figure),
                row_shares=[5, 4],
            ),
            column_shares=[6, 5, 4],
        ),
        rrb.TimePanel(
            timeline="sim_time",
            state="collapsed",
            playback_speed=style.SPEED,
            loop_mode="all",
            play_state="playing",
        ),
        auto_views=False,
        collapse_panels=True,
    )


def _head_view(figure: Figure, head: HeadCalibration) -> rrb.Spatial3DView:
    marks = [
        f"- {entity}/{mark}"
        for entity in camera_entities(head).values()
        for mark in ("detected", "truth")
    ]
    back, front = -0.20, figure.mean_m[0] + 2 * figure.std_m[0]  # of all that is to be seen
    middle = np.array([(back + front) / 2, 0.3 * figure.mean_m[1], style.EYE_HEIGHT_M - 0.03])
    return view_3d(
        f"{title(figure)}: head, lines of sight, estimates",
        origin="world",
        contents=["+ $origin/**", "- world/left_base/spread", *marks],
        middle=middle,
        eye=middle + np.array([0.30, 0.85, 0.42]) * (0.10 + 0.74 * (front - back)),
        trails=_TRAILS,
    )


def _close_up(figure: Figure) -> rrb.Spatial3DView:
    middle = np.array(figure.mean_m)
    return view_3d(
        "close-up: object, estimates and their 2-std ellipsoid",
        origin="world/left_base",
        contents=["+ $origin/**", "+ world/object/**"],
        middle=middle,
        eye=middle + np.array([-0.25, 0.85, 0.45]) * (0.06 + 2.8 * figure.std_m[0]),
        trails=_TRAILS,
    )
