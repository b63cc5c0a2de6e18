"""The blueprint of a recording of gaze control: the views with which it opens."""

from __future__ import annotations

from functools import partial

import numpy as np
import rerun.blueprint as rrb

from vergence.geometry.head import HeadCalibration
from vergence.viewer import style
from vergence.viewer.layout import camera_views, curves_view, hidden, playing, view_3d
from vergence.viewer.seen import learned_views

TRAILS = {"world/gaze/trail": style.GAZE_TRAIL_S, "world/gaze/hand_trail": style.GAZE_TRAIL_S}
_FROM = np.array([-0.45, 0.75, 0.50])
"""View from above and behind the left shoulder, in which the eyes' axes are seen to meet."""
ERROR_PX = 50.0
"""Range of the plot of the gaze error; larger errors occur only during saccades."""


def gaze_blueprint(
    title: str,
    head: HeadCalibration,
    *,
    reach_m: float,
    speed: float,
    hand: bool,
    seen: bool = False,
) -> rrb.Blueprint:
    """Return the layout with which the viewer opens a recording of gaze control.

    Args:
        title: of the 3-D view.
        head: the calibration whose cameras are shown.
        reach_m: largest distance of an object, which the 3-D view includes.
        speed: recorded seconds per second.
        hand: whether the distance of a hand from the object is shown.
        seen: whether the geometry is seen, so that its matches and what was learned are shown.
    """
    plot = partial(curves_view, legend=False)
    lines = "blue fused, grey one frame" + (", pale by the joints" if seen else "")
    errors = plot(f"error [mm]: {lines}", "error")
    marks = "long cross target, + found, ○ truth" + (", dots matched" if seen else "")
    learned = (learned_views(),) if seen else ()
    return playing(
        rrb.Horizontal(
            rrb.Vertical(
                _space(title, head, reach_m),
                camera_views(head, marks=marks),
                row_shares=[5, 8],
            ),
            rrb.Vertical(
                rrb.StateTimelineView(name="what it is doing", origin="doing"),
                plot(
                    "object from the centre of the narrow images [px], cut off: "
                    "orange left eye, teal right",
                    "gaze_error",
                    axis_y=rrb.ScalarAxis(range=(0, ERROR_PX), zoom_lock=True),
                ),
                plot(
                    "position in the body [m], pale the truth: x (depth) blue, y green, z red",
                    "position",
                ),
                rrb.Horizontal(errors, plot("hand by its encoders, from the object [mm]", "hand"))
                if hand
                else errors,
                *learned,
                plot("eyes [rad], pale commanded: orange left, teal right, light tilt", "eyes"),
                rrb.Tabs(
                    rrb.TextDocumentView(name="report", origin="report"),
                    plot("neck [rad], pale commanded: pitch violet, roll grey, yaw green", "neck"),
                ),
                row_shares=[3.2, 4, 3.5, 3.5, *[3.5 for _ in learned], 3.5, 4],
            ),
            column_shares=[6, 5],
        ),
        speed=speed,
    )


def _space(title: str, head: HeadCalibration, reach_m: float) -> rrb.Spatial3DView:
    middle = np.array([reach_m / 2 - 0.1, 0.0, style.EYE_HEIGHT_M - 0.04])
    marks = hidden(head, "detected", "truth", "aim", "matches")
    return view_3d(
        f"{title}: head, axes of the narrow cameras, estimate and truth",
        origin="world",
        contents=["+ $origin/**", "- world/board/**", *marks],
        middle=middle,
        eye=middle + (0.15 + 0.75 * reach_m) * _FROM,
        trails=TRAILS,
    )
