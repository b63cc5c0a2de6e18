"""The blueprint of a recording: what the viewer shows without a click."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vergence.arrays import Array
from vergence.experiments.paper import Figure
from vergence.head import HeadCalibration
from vergence.kinematics import EYES
from vergence.recording import style

_TRAILS = {"world/left_base/trail": None, "world/left_base/recent": style.TRAIL_S}


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


def whole_time() -> rrb.TimeAxis:
    """Return the time axis of a plot that shows all there is."""
    # Without it a plot keeps the range of what was loaded when it was first drawn.
    ever = rr.TimeRangeBoundary.infinite()
    return rrb.TimeAxis(view_range=rr.TimeRange(start=ever, end=ever))


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


def view_3d(
    name: str,
    *,
    origin: str,
    contents: list[str],
    middle: Array,
    eye: Array,
    trails: Mapping[str, float | None],
) -> rrb.Spatial3DView:
    """Return a view in space.

    Args:
        name: its title.
        origin: entity in whose frame it is drawn.
        contents: what is drawn.
        middle: (3,) what it looks at.
        eye: (3,) from where.
        trails: by entity, for how many seconds before the cursor it stays; None: for ever.
    """
    overrides: dict[Any, rrb.VisibleTimeRanges] = {
        entity: _last_seconds(seconds) for entity, seconds in trails.items()
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


def camera_views(head: HeadCalibration, *, marks: str) -> list[rrb.Spatial2DView]:
    """Return a view of each camera, the widest of each eye first; titles say what marks mean."""
    views = []
    entities = camera_entities(head)
    for name in _by_rank(head):
        camera = head.camera(name).intrinsics
        bounds = rrb.VisualBounds2D(x_range=(0, camera.width), y_range=(0, camera.height))
        views.append(
            rrb.Spatial2DView(
                name=f"{name.replace('_', ' ')}: {marks}",
                origin=entities[name],
                visual_bounds=bounds,
            )
        )
    return views


def _by_rank(head: HeadCalibration) -> list[str]:
    """Return the cameras by width of view: the widest of the left eye, of the right one, ..."""

    def narrowness(name: str) -> float:
        camera = head.camera(name).intrinsics
        return float(camera.matrix[0, 0] / camera.width)

    ranked = []
    for k, eye in enumerate(EYES):
        own = [name for name, mounted in head.cameras.items() if mounted.eye == eye]
        ranked += [(rank, k, name) for rank, name in enumerate(sorted(own, key=narrowness))]
    return [name for _, _, name in sorted(ranked)]
