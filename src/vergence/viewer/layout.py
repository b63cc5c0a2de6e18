"""The blueprint of a recording: what the viewer shows without a click."""

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
    """Return the entity of each camera."""
    return {name: f"world/{mounted.eye}_eye/{name}" for name, mounted in head.cameras.items()}


def whole_time() -> rrb.TimeAxis:
    """Return the time axis of a plot that shows all there is."""
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
