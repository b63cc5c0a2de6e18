"""Parts of a recording's blueprint, the layout with which the viewer opens it."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain, zip_longest
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration, cameras_of
from vergence.geometry.kinematics import EYES
from vergence.viewer import style


def camera_entities(head: HeadCalibration) -> dict[str, str]:
    """Return by camera its entity in a recording."""
    return {name: f"world/{mounted.eye}_eye/{name}" for name, mounted in head.cameras.items()}


def curves_view(
    name: str, origin: str, *, legend: bool = True, **options: Any
) -> rrb.TimeSeriesView:
    """Return a plot of the curves below an entity, over the whole recording.

    Args:
        name: title of the plot.
        origin: the entity.
        legend: whether there is one; it hides the latest samples.
        options: further arguments of `TimeSeriesView`.
    """
    # Without a range a plot keeps the one of what was loaded when it was first drawn.
    ever = rr.TimeRangeBoundary.infinite()
    options["axis_x"] = rrb.TimeAxis(view_range=rr.TimeRange(start=ever, end=ever))
    if not legend:
        options["plot_legend"] = rrb.PlotLegend(visible=False)
    return rrb.TimeSeriesView(name=name, origin=origin, **options)


def view_3d(
    name: str,
    *,
    origin: str,
    contents: list[str],
    middle: Array,
    eye: Array,
    trails: Mapping[str, float | None],
) -> rrb.Spatial3DView:
    """Return a 3-D view in which z points up.

    Args:
        name: title of the view.
        origin: entity in whose frame it is drawn.
        contents: expressions for the entities to draw.
        middle: (3,) the point that the view looks at.
        eye: (3,) the point that it looks from.
        trails: by entity, for how many seconds before the cursor it stays visible; None: for ever.
    """
    boundary, overrides = rr.TimeRangeBoundary, {}
    now = boundary.cursor_relative(seconds=0)
    for entity, seconds in trails.items():
        ever = seconds is None
        start = boundary.infinite() if ever else boundary.cursor_relative(seconds=-seconds)
        shown = rrb.VisibleTimeRange("sim_time", start=start, end=now)
        overrides[entity] = rrb.VisibleTimeRanges(shown)
    return rrb.Spatial3DView(
        name=name,
        origin=origin,
        contents=contents,
        background=rrb.Background(color=style.BACKGROUND),
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=middle, eye_up=(0, 0, 1)),
        overrides=overrides,
    )


def hidden(head: HeadCalibration, *marks: str) -> list[str]:
    """Return the expressions that leave marks in the images out of a 3-D view."""
    return [f"- {entity}/{mark}" for entity in camera_entities(head).values() for mark in marks]


def playing(
    views: rrb.Horizontal,
    *,
    timeline: str = "sim_time",
    speed: float | None = None,
    fps: float | None = None,
) -> rrb.Blueprint:
    """Return the layout of a recording that opens with these views only, and plays in a loop.

    On sim_time `speed` is in recorded seconds per second; on frame `fps` is in steps per second.
    """
    panel = rrb.TimePanel(
        timeline=timeline,
        state="collapsed",
        playback_speed=speed,
        fps=fps,
        loop_mode="all",
        play_state="playing",
    )
    return rrb.Blueprint(views, panel, auto_views=False, collapse_panels=True)


def camera_views(head: HeadCalibration, *, marks: str) -> rrb.Grid:
    """Return the views of the cameras, the widest of each eye first; titles explain the marks."""

    def narrowness(name: str) -> float:
        camera = head.camera(name).intrinsics
        return float(camera.matrix[0, 0] / camera.width)

    views, entities = [], camera_entities(head)
    own = [sorted(cameras_of(head, eye), key=narrowness) for eye in EYES]
    for name in filter(None, chain.from_iterable(zip_longest(*own))):
        camera = head.camera(name).intrinsics
        bounds = rrb.VisualBounds2D(x_range=(0, camera.width), y_range=(0, camera.height))
        title = f"{name.replace('_', ' ')}: {marks}"
        views.append(rrb.Spatial2DView(name=title, origin=entities[name], visual_bounds=bounds))
    return rrb.Grid(*views, grid_columns=2)
