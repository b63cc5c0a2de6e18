"""The blueprint of a recording: what the viewer shows without a click."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vergence.arrays import Array
from vergence.experiments.paper import Figure
from vergence.head import HeadCalibration
from vergence.kinematics import EYES

if TYPE_CHECKING:  # the twin, and with it mujoco, is not needed to record a real head
    pass
from vergence.recording import style


def title(figure: Figure) -> str:
    return f"Fig. {figure.number} - {figure.motion}, {figure.lens.removesuffix('mm')} mm"


def camera_entities(head: HeadCalibration) -> dict[str, str]:
    """Return the entity of each camera."""
    return {name: f"world/{mounted.eye}_eye/{name}" for name, mounted in head.cameras.items()}


def blueprint(figure: Figure, head: HeadCalibration) -> rrb.Blueprint:
    """Return the layout of a figure's recording, complete as it opens.

    Args:
        figure: the one that is recorded; its object and the head fill the 3-D view.
        head: whose cameras are shown.
    """
    # Without it a plot keeps the range of what was loaded when it was first drawn.
    ever = rr.TimeRangeBoundary.infinite()
    whole = rrb.TimeAxis(view_range=rr.TimeRange(start=ever, end=ever))
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
                rrb.Grid(*_camera_views(head), grid_columns=2),
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
    return _view_3d(
        f"{title(figure)}: head, lines of sight, estimates",
        origin="world",
        contents=["+ $origin/**", "- world/left_base/spread", *marks],
        middle=middle,
        eye=middle + np.array([0.30, 0.85, 0.42]) * (0.10 + 0.74 * (front - back)),
    )


def _close_up(figure: Figure) -> rrb.Spatial3DView:
    middle = np.array(figure.mean_m)
    return _view_3d(
        "close-up: object, estimates and their 2-std ellipsoid",
        origin="world/left_base",
        contents=["+ $origin/**", "+ world/object/**"],
        middle=middle,
        eye=middle + np.array([-0.25, 0.85, 0.45]) * (0.06 + 2.8 * figure.std_m[0]),
    )


def _view_3d(
    name: str, *, origin: str, contents: list[str], middle: Array, eye: Array
) -> rrb.Spatial3DView:
    overrides: dict[Any, rrb.VisibleTimeRanges] = {
        "world/left_base/trail": _last_seconds(None),
        "world/left_base/recent": _last_seconds(style.TRAIL_S),
    }
    return rrb.Spatial3DView(
        name=name,
        origin=origin,
        contents=contents,
        background=rrb.Background(color=style.BACKGROUND),
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=middle, eye_up=(0, 0, 1)),
        overrides=overrides,
    )


def _last_seconds(seconds: float | None) -> rrb.VisibleTimeRanges:
    """Show what was logged in so many seconds before the cursor; None: since the beginning."""
    boundary = rr.TimeRangeBoundary
    start = boundary.infinite() if seconds is None else boundary.cursor_relative(seconds=-seconds)
    now = boundary.cursor_relative(seconds=0)
    return rrb.VisibleTimeRanges(rrb.VisibleTimeRange("sim_time", start=start, end=now))


def _camera_views(head: HeadCalibration) -> list[rrb.Spatial2DView]:
    views = []
    entities = camera_entities(head)
    for name in (f"{eye}_{lens}" for lens in ("wide", "narrow") for eye in EYES):
        if name in entities:
            camera = head.camera(name).intrinsics
            bounds = rrb.VisualBounds2D(x_range=(0, camera.width), y_range=(0, camera.height))
            views.append(
                rrb.Spatial2DView(
                    name=f"{name.replace('_', ' ')}: + found, ○ truth",
                    origin=entities[name],
                    visual_bounds=bounds,
                )
            )
    return views
