"""The blueprint of a recording of the gaze: what the viewer shows without a click."""

from __future__ import annotations

import numpy as np
import rerun.blueprint as rrb

from vergence.head import HeadCalibration
from vergence.recording import style
from vergence.recording.layout import camera_entities, camera_views, view_3d, whole_time

TRAILS = {"world/gaze/trail": style.GAZE_TRAIL_S, "world/gaze/hand_trail": style.GAZE_TRAIL_S}
_MIDDLE = np.array([0.25, 0.0, style.EYE_HEIGHT_M - 0.05])
_EYE = np.array([-0.35, 1.05, style.EYE_HEIGHT_M + 0.62])
"""From above and behind the left shoulder: the eyes' axes are seen to meet."""


def gaze_blueprint(title: str, head: HeadCalibration, *, speed: float) -> rrb.Blueprint:
    """Return the layout, complete as it opens.

    Args:
        title: of the view in space.
        head: whose cameras are shown.
        speed: of the playback, in recorded seconds a second.
    """
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                _space(title, head),
                rrb.Grid(
                    *camera_views(head, marks="long cross aim, + found, ○ truth"), grid_columns=2
                ),
                row_shares=[5, 8],
            ),
            rrb.Vertical(
                rrb.StateTimelineView(name="what it is doing", origin="doing"),
                _plot("object from the centre of the narrow images [px]", "gaze_error"),
                _plot("position in the body [m]: bright estimate, pale truth", "position"),
                _plot("error of the position [mm]: bright fused, grey one frame", "error"),
                _plot("eyes [rad]: bright readings, pale where they were sent", "eyes"),
                rrb.Tabs(
                    rrb.TextDocumentView(name="report", origin="report"),
                    _plot("neck [rad]: bright readings, pale where it was sent", "neck"),
                ),
                row_shares=[2.2, 4, 3.5, 3.5, 3.5, 3.5],
            ),
            column_shares=[6, 5],
        ),
        rrb.TimePanel(
            timeline="sim_time",
            state="collapsed",
            playback_speed=speed,
            loop_mode="all",
            play_state="playing",
        ),
        auto_views=False,
        collapse_panels=True,
    )


def _plot(name: str, origin: str) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        name=name,
        origin=origin,
        axis_x=whole_time(),
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
    )


def _space(title: str, head: HeadCalibration) -> rrb.Spatial3DView:
    marks = [
        f"- {entity}/{mark}"
        for entity in camera_entities(head).values()
        for mark in ("detected", "truth", "aim")
    ]
    return view_3d(
        f"{title}: head, axes of the narrow cameras, estimate and truth",
        origin="world",
        contents=["+ $origin/**", "- world/board/**", *marks],
        middle=_MIDDLE,
        eye=_EYE,
        trails=TRAILS,
    )
