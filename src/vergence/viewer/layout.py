"""Parts of a recording's blueprint, the layout with which the viewer opens it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import rerun as rr
import rerun.blueprint as rrb

from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES
from vergence.viewer import style


def camera_entities(head: HeadCalibration) -> dict[str, str]:
    """Return by camera its entity in a recording."""
    return {name: f"world/{mounted.eye}_eye/{name}" for name, mounted in head.cameras.items()}


def whole_time() -> rrb.TimeAxis:
    """Return the time axis of a plot that shows the whole recording."""
    # Without it a plot keeps the range of what was loaded when it was first drawn.
    ever = rr.TimeRangeBoundary.infinite()
    return rrb.TimeAxis(view_range=rr.TimeRange(start=ever, end=ever))


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
        trails: by entity, for how many seconds it stays visible; None: for ever.
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

    Args:
        views: all views.
        timeline: that is played.
        speed: recorded seconds per second, of sim_time.
        fps: steps per second, of frame.
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


def _last_seconds(seconds: float | None) -> rrb.VisibleTimeRanges:
    """Show what was logged in the last seconds before the cursor; None: since the beginning."""
    boundary = rr.TimeRangeBoundary
    start = boundary.infinite() if seconds is None else boundary.cursor_relative(seconds=-seconds)
    now = boundary.cursor_relative(seconds=0)
    return rrb.VisibleTimeRanges(rrb.VisibleTimeRange("sim_time", start=start, end=now))


def camera_views(head: HeadCalibration, *, marks: str) -> list[rrb.Spatial2DView]:
    """Return a view of each camera, the widest of each eye first; titles explain the marks."""
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
    """Return the cameras by field of view: the widest of the left eye, of the right eye, ..."""

    def narrowness(name: str) -> float:
        camera = head.camera(name).intrinsics
        return float(camera.matrix[0, 0] / camera.width)

    ranked = []
    for k, eye in enumerate(EYES):
        own = [name for name, mounted in head.cameras.items() if mounted.eye == eye]
        ranked += [(rank, k, name) for rank, name in enumerate(sorted(own, key=narrowness))]
    return [name for _, _, name in sorted(ranked)]
