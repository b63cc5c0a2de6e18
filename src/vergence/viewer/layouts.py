"""Layouts with which the viewer opens recordings: their views and how they play."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain, zip_longest
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration, cameras_of
from vergence.geometry.kinematics import EYES
from vergence.viewer import style


def camera_entities(head: HeadCalibration) -> dict[str, str]:
    """Name the entity of each camera in a recording."""
    return {name: f"world/{mounted.eye}_eye/{name}" for name, mounted in head.cameras.items()}


def curves_view(
    name: str, origin: str, *, legend: bool = True, **options: Any
) -> rrb.TimeSeriesView:
    """Plot the curves below an entity over the whole recording; a legend hides the latest samples.

    Further options are those of `TimeSeriesView`.
    """
    # Without a range a plot keeps the one of what was loaded when it was first drawn.
    ever = rr.TimeRangeBoundary.infinite()
    options["axis_x"] = rrb.TimeAxis(view_range=rr.TimeRange(start=ever, end=ever))
    if not legend:
        options["plot_legend"] = rrb.PlotLegend(visible=False)
    return rrb.TimeSeriesView(name=name, origin=origin, **options)


def report_view() -> rrb.TextDocumentView:
    """Show the report of a recording."""
    return rrb.TextDocumentView(name="report", origin="report")


def view_3d(
    name: str,
    *,
    middle: Array,
    eye: Array,
    origin: str = "world",
    contents: tuple[str, ...] = (),
    trails: Mapping[str, float | None] | None = None,
) -> rrb.Spatial3DView:
    """Show a 3-D view in which z points up, from point `eye` (3,) to point `middle` (3,).

    It draws what is below `origin`, in that frame. `contents` are expressions for further entities,
    or hide some. `trails` are the seconds for which an entity stays visible; None: for ever.
    """
    boundary, overrides = rr.TimeRangeBoundary, {}
    now = boundary.cursor_relative(seconds=0)
    for entity, seconds in (trails or {}).items():
        first = (
            boundary.infinite() if seconds is None else boundary.cursor_relative(seconds=-seconds)
        )
        shown = rrb.VisibleTimeRange("sim_time", start=first, end=now)
        overrides[entity] = rrb.VisibleTimeRanges(shown)
    return rrb.Spatial3DView(
        name=name,
        origin=origin,
        contents=["+ $origin/**", *contents],
        background=rrb.Background(color=style.BACKGROUND),
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=middle, eye_up=(0, 0, 1)),
        overrides=overrides,
    )


def hidden(head: HeadCalibration, *marks: str) -> tuple[str, ...]:
    """Leave marks in the images out of a 3-D view."""
    entities = camera_entities(head).values()
    return tuple(f"- {entity}/{mark}" for entity in entities for mark in marks)


def camera_views(head: HeadCalibration, *, marks: str) -> rrb.Grid:
    """Show the cameras, a column for each eye; titles explain the marks."""
    views, entities = [], camera_entities(head)
    by_eye = zip_longest(*(cameras_of(head, eye) for eye in EYES))
    for name in filter(None, chain.from_iterable(by_eye)):
        camera = head.camera(name).intrinsics
        bounds = rrb.VisualBounds2D(x_range=(0, camera.width), y_range=(0, camera.height))
        title = f"{name.replace('_', ' ')}: {marks}"
        views.append(rrb.Spatial2DView(name=title, origin=entities[name], visual_bounds=bounds))
    return rrb.Grid(*views, grid_columns=2)


def learned_views() -> rrb.Tabs:
    """Plot the parameters that self-calibration has learned."""
    title = "{} since the calibration [%], ± std: orange left, teal right"
    return rrb.Tabs(
        curves_view(title.format("gains"), "learned/gain", legend=False),
        curves_view(title.format("focal lengths"), "learned/focal", legend=False),
    )


def playing(
    views: rrb.Horizontal,
    *,
    timeline: str = "sim_time",
    speed: float | None = None,
    fps: float | None = None,
) -> rrb.Blueprint:
    """Open with these views only, and play in a loop.

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


def following(layout: rrb.Blueprint) -> rrb.Blueprint:
    """Show the latest moment of a run that goes on, by the layout of its recording."""
    panel = rrb.TimePanel(
        timeline=getattr(layout.time_panel, "timeline", None),
        state="collapsed",
        play_state="following",
    )
    return rrb.Blueprint(layout.root_container, panel, auto_views=False, collapse_panels=True)


def dataset_blueprint(head: HeadCalibration) -> rrb.Blueprint:
    """Lay out a calibrated dataset."""
    marks = f"dots: corners, lines: residuals x {style.MAGNIFICATION}"
    space = view_3d(
        "estimated poses of eyes and board",
        middle=np.array([0.35, -0.04, 0.0]),
        eye=np.array([-0.1, 0.5, 0.3]),
        contents=hidden(head, "corners", "residuals"),
    )
    curves = rrb.Vertical(
        curves_view("residuals of an image, rms [px]", "residual"),
        curves_view("joint readings [rad]", "joints"),
        report_view(),
        row_shares=[3, 3, 5],
    )
    images = rrb.Vertical(space, camera_views(head, marks=marks), row_shares=[5, 8])
    views = rrb.Horizontal(images, curves, column_shares=[6, 5])
    return playing(views, timeline="frame", fps=2.0)


def gaze_blueprint(
    title: str,
    head: HeadCalibration,
    *,
    reach_m: float,
    speed: float,
    hand: bool,
    seen: bool = False,
) -> rrb.Blueprint:
    """Lay out a recording of gaze control.

    The 3-D view reaches as far as an object, `reach_m`. `hand` shows the distance of a hand from
    the object, `seen` the matches and the learned parameters.
    """

    def plot(name: str, origin: str, **options: Any) -> rrb.TimeSeriesView:
        return curves_view(name, origin, legend=False, **options)

    middle = np.array([reach_m / 2 - 0.1, 0.0, style.EYE_HEIGHT_M - 0.04])
    space = view_3d(
        f"{title}: head, axes of the narrow cameras, estimate and truth",
        middle=middle,
        # Above and behind the left shoulder, from where the eyes' axes are seen to meet.
        eye=middle + (0.15 + 0.75 * reach_m) * np.array([-0.45, 0.75, 0.50]),
        contents=("- world/board/**", *hidden(head, "detected", "truth", "aim", "matches")),
        trails=dict.fromkeys(("world/gaze/trail", "world/gaze/hand_trail"), 4.0),
    )
    marks = "long cross target, + found, ○ truth" + (", dots matched" if seen else "")
    lines = "blue fused, grey one frame" + (", pale by the joints" if seen else "")
    errors = plot(f"error [mm]: {lines}", "error")
    if hand:
        of_hand = plot("hand by its encoders, from the object [mm]", "hand")
        errors = rrb.Horizontal(errors, of_hand)
    curves = [
        rrb.StateTimelineView(name="what it is doing", origin="doing"),
        plot(
            "object from the centre of the narrow images [px], cut off: orange left eye, teal "
            "right",
            "gaze_error",
            axis_y=rrb.ScalarAxis(range=(0, 50), zoom_lock=True),  # saccades have larger errors
        ),
        plot("position in the body [m], pale truth: x (depth) blue, y green, z red", "position"),
        errors,
        *([learned_views()] if seen else []),
        plot("eyes [rad], pale commanded: orange left, teal right, light tilt", "eyes"),
        rrb.Tabs(
            report_view(),
            plot("neck [rad], pale commanded: pitch violet, roll grey, yaw green", "neck"),
        ),
    ]
    views = rrb.Horizontal(
        rrb.Vertical(space, camera_views(head, marks=marks), row_shares=[5, 8]),
        rrb.Vertical(*curves),
        column_shares=[6, 5],
    )
    return playing(views, speed=speed)
