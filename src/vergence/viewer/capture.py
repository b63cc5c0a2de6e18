"""Show a guided capture while it goes on: what the cameras see, what is asked for, what is reached.

The world is the left eye's base frame. The curve is /accuracy [mm], the words are /report.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.geometry.board import corner_points
from vergence.geometry.eye_motion import eye_poses
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES
from vergence.geometry.projection import eye_pose_in_left_base
from vergence.live.capture import CaptureSettings, CaptureState
from vergence.live.guide import board_of, outlines
from vergence.live.status import status
from vergence.viewer import style
from vergence.viewer.layouts import (
    camera_entities,
    camera_views,
    curves_view,
    hidden,
    playing,
    report_view,
    view_3d,
)
from vergence.viewer.live import Feed
from vergence.viewer.recording import log_image, set_time
from vergence.viewer.shapes import log_cameras, placed

WANTED, KEPT = (60, 220, 90), (255, 230, 0, 70)
"""Colours of the board where it is wanted, and of corners in the views that were kept."""


def capture_blueprint(head: HeadCalibration) -> rrb.Blueprint:
    """Lay out a capture of an assumed head."""
    marks = "green where the board is wanted, + where it is, dots kept"
    space = view_3d(
        "eyes, board, and where it is wanted (green)",
        middle=np.array([0.35, -0.04, 0.0]),
        eye=np.array([-0.3, 0.4, 0.3]),
        contents=hidden(head, "corners", "wanted", "kept"),
    )
    told = rrb.Vertical(
        report_view(),
        curves_view("accuracy of points [mm]", "accuracy"),
        space,
        row_shares=[4, 3, 5],
    )
    views = rrb.Horizontal(camera_views(head, marks=marks), told, column_shares=[6, 5])
    return playing(views)


def capture_log(feed: Feed, settings: CaptureSettings) -> Callable[[CaptureState, Frame], None]:
    """Make the function that records a capture frame by frame."""
    index, kept, head = 0, 0, None

    def look(state: CaptureState, frame: Frame) -> None:
        nonlocal index, kept, head
        if state.head is not head:
            feed.always(log_cameras, state.head)
            head = state.head
        if len(state.kept) > kept:
            feed.always(_log_kept, settings, state, frame.time_s, index)
            kept = len(state.kept)
        # Copies, since a driver may write its next images into the same arrays.
        images = {name: np.array(image) for name, image in frame.images.items()}
        feed(_log_frame, settings, state, frame, images, index)
        index += 1

    return look


def _log_frame(
    rec: rr.RecordingStream,
    settings: CaptureSettings,
    state: CaptureState,
    frame: Frame,
    images: dict[str, np.ndarray],
    index: int,
) -> None:
    """Record images with the board as it is and as it is wanted, and the words."""
    set_time(rec, frame.time_s, index)
    head, board, view = state.head, board_of(settings.description), state.asked[0]
    wanted = outlines(head, board, view.T_lbase_target, frame.eye_angles)
    for name, entity in camera_entities(head).items():
        if name in images:
            log_image(rec, entity, images[name])
            corners = state.watched.corners.get(name, np.empty((0, 2)))
            seen = corners[np.isfinite(corners).all(axis=1)] + 0.5
            rec.log(f"{entity}/corners", rr.Points2D(seen, colors=style.DETECTED, radii=-2.0))
        if name in wanted:
            strip = wanted[name][[0, 1, 2, 3, 0]] + 0.5
            strips = [strip] if np.isfinite(strip).all() else []
            rec.log(f"{entity}/wanted", rr.LineStrips2D(strips, colors=WANTED, radii=-1.5))
    poses = eye_poses(head, frame.eye_angles)
    for eye, T in zip(EYES, poses, strict=True):
        rec.log(f"world/{eye}_eye", placed(eye_pose_in_left_base(eye, head.T_rbase_lbase, T)))
    _log_board(rec, "wanted", settings, view.T_lbase_target, WANTED)
    _log_board(rec, "board", settings, state.T_lbase_board, style.OBJECT)
    words = status(settings, state).replace("\n", "\n\n")
    rec.log("report", rr.TextDocument(words, media_type=rr.MediaType.MARKDOWN))


def _log_board(
    rec: rr.RecordingStream,
    name: str,
    settings: CaptureSettings,
    T: Array | None,
    color: tuple[int, int, int],
) -> None:
    """Record the outline of the board at a pose (4, 4); None: it is not seen."""
    if T is None:
        rec.log(f"world/{name}", rr.Clear(recursive=False))
        return
    board = board_of(settings.description)
    grid = corner_points(board).reshape(board.rows, board.columns, 3)
    strip = grid[[0, 0, -1, -1, 0], [0, -1, -1, 0, 0]]
    rec.log(f"world/{name}", placed(T), rr.LineStrips3D([strip], colors=color, radii=-2.0))


def _log_kept(
    rec: rr.RecordingStream,
    settings: CaptureSettings,
    state: CaptureState,
    time_s: float,
    index: int,
) -> None:
    """Record the accuracy, and the corners of all views so far, which show what is covered."""
    set_time(rec, time_s, index)
    if state.accuracy_m is not None:
        rec.log("accuracy", rr.Scalars([1e3 * state.accuracy_m, 1e3 * settings.goal_m]))
    for name, entity in camera_entities(state.head).items():
        if views := [v.corners[name] for v in state.kept if name in v.corners]:
            seen = np.concatenate(views)
            seen = seen[np.isfinite(seen).all(axis=1)] + 0.5
            rec.log(f"{entity}/kept", rr.Points2D(seen, colors=KEPT, radii=-1.0))
