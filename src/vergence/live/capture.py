"""One step of a guided capture: a frame comes, is kept if it is worth it, and a view is asked for.

A step is a function of settings, state and frame; `live.session` joins it with a driver.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from vergence.accuracy.plan import LIMIT_RAD
from vergence.arrays import Array
from vergence.data.dataset import MAX_GAP_S, Frame
from vergence.data.description import Description
from vergence.data.table import NECK_MOVED_RAD
from vergence.data.writer import DatasetRow
from vergence.errors import VergenceError
from vergence.gaze.commands import JointLimits
from vergence.geometry.board import corner_points
from vergence.geometry.head import HeadCalibration, lenses_of, main_camera, main_cameras
from vergence.geometry.se3 import angle, known_poses
from vergence.live.estimate import LEAST_SEEN, Estimate
from vergence.live.guide import (
    Outlook,
    View,
    assumed_head,
    begin_outlook,
    board_in_left_base,
    board_of,
    deviations_m,
    first_views,
    mean_deviation_m,
    next_view,
    views_of_camera,
    with_view,
    without_view,
)
from vergence.live.kept import Kept
from vergence.live.stillness import WATCHED_PX, Detect, Watched, find_board, watch
from vergence.vision.board_pose import board_poses

STILL_S = 0.4
"""Time for which board and eyes stand still before a frame is kept [s]: longer than a hand pauses
between two motions, and than images lag behind readings."""
NEW_PER_WIDTH, NEW_RAD = 0.04, 0.05
"""Least motion of the board's corners, in image widths, or turn of a joint [rad] since every view
that was kept, before there is a plan; views of the paper are as far apart."""
WORTH = 0.4
"""Gain of a view, relative to that of the best one, from which it is kept. With it, a
person who follows the guide by 3 cm and 10 degrees needs as many views as a plan that is carried
out exactly (benchmarks/guided_capture.py)."""
PATIENCE_S = 15.0
"""Time after which another view is asked for [s]; a person takes 5 to 10 s to show one: assumed."""
MOVED_M, TURNED_RAD = 0.02, 0.05
"""Motion of a board between two views from which it has another place [m, rad]: above the errors of
a first calibration."""
NO_GAIN = 0.97
"""Predicted deviation after further views, relative to the present one, from which capture ends."""
WITHOUT_PLAN = 40
"""Views after which capture ends where views cannot be planned, as for one eye: twice those that
docs/calibrate.md asks for of cameras that stand still."""
SWEEP_S, SWEEP_RAD, SWEEP_PERIODS_S = 3.0, 0.06, (1.5, 2.0, 1.2, 1.7)
"""Duration [s], amplitude [rad] and periods [s] of the motion by which the time offset is found: a
board stays in the images, and joints differ."""
SWEEP_STEP_S, SWEEP_ROWS = 0.06, 10
"""Least time between rows of a sweep [s], for 15 Hz; and fewest rows of one that is kept."""


@dataclass(frozen=True, eq=False)
class CaptureSettings:
    """What is recorded, and how good the calibration is to become."""

    description: Description
    """With a board."""
    limits: JointLimits | None = None
    """Of the joints of a posture; None: the head takes no commands."""
    goal_m: float = 0.003
    """Wanted standard deviation of a point by the calibration, in its worst direction [m]."""
    distance_m: float = 0.5
    """Distance of such points [m]."""
    most_views: int = 150
    seed: int = 0

    def __post_init__(self) -> None:
        board_of(self.description)
        if self.description.eye_motion == "poses":
            raise VergenceError("A capture is of joint readings; this head measures eye poses.")
        joints = *self.description.neck_joints, *self.description.head_kinematics.readings
        if self.limits is not None and len(self.limits.joints) != len(joints):
            raise VergenceError(
                f"The limits of a driver are of all joints, {', '.join(joints)}; found those of "
                f"{', '.join(self.limits.joints)}."
            )
        if not (self.goal_m > 0 and self.distance_m > 0):
            raise VergenceError(
                f"A goal is an accuracy above 0 m at a distance above 0 m; found {self.goal_m:g} m "
                f"at {self.distance_m:g} m."
            )

    @property
    def limits_rad(self) -> Array:
        """(r,) largest readings to either side that views may have."""
        usual = LIMIT_RAD / self.description.head_kinematics.gear_ratios
        if self.limits is None or not len(usual):
            return usual
        lower, upper = self.limits.setpoint_range_rad[-len(usual) :].T
        return np.minimum(usual, np.maximum(np.minimum(-lower, upper), 1e-3))


@dataclass(frozen=True, eq=False)
class Sweep:
    """A small motion of the eyes before a board at rest."""

    begin_s: float
    posture: Array
    """(j,) about which it swings [rad]."""
    rows: tuple[tuple[DatasetRow, Kept], ...] = ()


@dataclass(frozen=True, eq=False)
class CaptureState:
    """The state of a guided capture after the frames so far."""

    head: HeadCalibration
    """As assumed, then as calibrated."""
    asked: tuple[View, ...] = ()
    """Views to show, the present one first."""
    asked_s: float = np.inf
    """Time since which the present one is asked for."""
    rounds: int = 0
    """How often views were drawn without a plan."""
    focal_px: Mapping[str, float] = field(default_factory=dict)
    """By such a camera that has seen the board, its rough focal length."""
    for_camera: str = ""
    """Camera that has shown the board too seldom, for which they were drawn; empty: for all."""
    kept: tuple[Kept, ...] = ()
    watched: Watched = field(default_factory=Watched)
    judged_s: float = -np.inf
    """Since when the board has stood in the latest place that was judged."""
    to_keep: bool = False
    """Whether the next frame is to be kept."""
    T_lbase_board: Array | None = None
    """(4, 4) where the board is now; None: not seen."""
    in_place: bool = False
    """Whether the board was only asked to stay since the latest view that was kept."""
    estimate: Estimate | None = None
    outlook: Outlook | None = None
    """What further views bring; None: there is no plan."""
    best_m: float = np.inf
    """Mean deviation that is predicted with the view that is asked for [m]."""
    sweep: Sweep | None = None
    finished: str = ""
    """Why the capture has ended; empty: it goes on."""

    @property
    def all_cameras(self) -> bool:
        """Whether images of all cameras are needed next, and not of the main ones only."""
        return self.to_keep or bool(self.for_camera)

    @property
    def views(self) -> int:
        """Number of views at rest."""
        return sum(not view.moving for view in self.kept)

    @property
    def accuracy_m(self) -> float | None:
        """Largest deviation of a point, predicted for all kept views [m]; None: not known yet."""
        return None if self.outlook is None else float(deviations_m(self.outlook).max())


def begin_capture(settings: CaptureSettings, kept: tuple[Kept, ...] = ()) -> CaptureState:
    """Begin, or go on after views that were kept before."""
    state = CaptureState(assumed_head(settings.description), kept=kept)
    for _ in range(1 + sum(not view.moving for view in kept)):
        state = _ask(settings, state, np.inf)
    return state


def _ask(settings: CaptureSettings, state: CaptureState, now_s: float) -> CaptureState:
    """Ask for the next view: of the plan or, without one, of those that were drawn."""
    if state.outlook is not None and not _missing(settings, state):
        view, best_m = next_view(state.outlook)
        return _asked(replace(state, best_m=best_m, for_camera=""), (view,), now_s)
    views, missing, camera = state.asked[1:], _missing(settings, state), state.for_camera
    if views and (not camera or camera in missing):
        return _asked(state, views, now_s)
    description, limits_rad = settings.description, settings.limits_rad
    seed = settings.seed + state.rounds
    if state.rounds and missing:
        camera = missing[0]
        views = views_of_camera(
            state.head,
            description,
            camera,
            limits_rad,
            seed=seed,
            focal_px=state.focal_px.get(camera),
        )
    else:
        camera, views = "", first_views(description, limits_rad, seed=seed)
    return _asked(replace(state, rounds=state.rounds + 1, for_camera=camera), views, now_s)


def _asked(state: CaptureState, views: tuple[View, ...], now_s: float) -> CaptureState:
    in_place = state.in_place and views[0].board_stays
    return replace(state, asked=views, asked_s=now_s, in_place=in_place)


def _missing(settings: CaptureSettings, state: CaptureState) -> tuple[str, ...]:
    """List the cameras that have shown the board at rest too seldom."""
    return tuple(
        name
        for name in settings.description.cameras
        if sum(name in view.corners for view in state.kept if not view.moving) < LEAST_SEEN
    )


def _rough_focal_px(settings: CaptureSettings, state: CaptureState, corners: Array) -> float:
    """Estimate a focal length by the size of a board that is about where it is asked for.

    Slant makes it up to a third too short.
    """
    points = corner_points(board_of(settings.description))
    T, seen = state.T_lbase_board, np.isfinite(corners).all(axis=1)
    distance_m = (state.asked[0].T_lbase_target if T is None else T)[0, 3]
    size_px, size_m = (np.linalg.norm(np.ptp(each[seen], axis=0)) for each in (corners, points))
    return float(size_px * distance_m / size_m)


def step_capture(
    settings: CaptureSettings, state: CaptureState, frame: Frame, detect: Detect = find_board
) -> tuple[CaptureState, tuple[DatasetRow, ...]]:
    """Look at a frame; also return the rows to be added to the dataset."""
    board, now_s = board_of(settings.description), frame.time_s
    watched = watch(state.watched, frame, detect(frame, board, WATCHED_PX))
    place = _located(settings, state.head, watched.corners, frame.eye_angles)
    state = replace(state, watched=watched, T_lbase_board=place, asked_s=min(state.asked_s, now_s))
    if state.sweep is not None:
        return _step_sweep(state, state.sweep, frame)
    still, camera = watched.still_s >= STILL_S, state.for_camera
    if still and camera in watched.corners and camera not in state.focal_px:
        rough_px = _rough_focal_px(settings, state, watched.corners[camera])
        state = replace(state, focal_px={**state.focal_px, camera: rough_px}, asked=())
        return _ask(settings, state, now_s), ()
    if still and not state.to_keep and state.judged_s != watched.since_s:
        worth = _is_worth(settings, state, frame)
        return replace(state, judged_s=watched.since_s, to_keep=worth), ()
    if not (still and state.to_keep):
        state = replace(state, to_keep=False)
        if now_s - state.asked_s > PATIENCE_S:
            if state.outlook is not None:
                state = replace(state, outlook=without_view(state.outlook, state.asked[0]))
            state = _ask(settings, state, now_s)
        return state, ()
    state = replace(state, to_keep=False)
    if not (corners := detect(frame, board, np.inf)):
        return state, ()
    kept = Kept(replace(frame, images={}), corners, _placement(settings, state, frame))
    state = replace(state, kept=(*state.kept, kept), in_place=True)
    if state.outlook is not None:
        state = replace(state, outlook=_with_views(settings, state, state.outlook, (kept,)))
    state = _ask(settings, state, now_s)
    swept = any(view.moving for view in state.kept)
    if settings.limits is not None and state.asked[0].board_stays and not swept:
        state = replace(state, sweep=Sweep(now_s, posture_of(frame)))
    return state, (DatasetRow(frame, kept.placement),)


def posture_of(frame: Frame) -> Array:
    """Read the posture (j,) [rad]: neck, then eyes."""
    return np.concatenate([frame.neck_angles, frame.eye_angles])


def _located(
    settings: CaptureSettings, head: HeadCalibration, corners: Mapping[str, Array], joints: Array
) -> Array | None:
    """Locate the board (4, 4) in the left eye's base by a main camera; None: it is not seen."""
    points = corner_points(board_of(settings.description))
    for name in main_cameras(head):
        if name in corners:
            T = board_poses(head.camera(name).intrinsics, corners[name][None], points)
            if known_poses(T)[0]:
                return board_in_left_base(head, name, joints, T[0])
    return None


def _is_worth(settings: CaptureSettings, state: CaptureState, frame: Frame) -> bool:
    """Judge a view at rest: by what it adds or, without a plan, by whether it is new."""
    if state.for_camera:  # its place in the eye is found by the main camera
        eye = settings.description.cameras[state.for_camera].eye
        main = main_camera(lenses_of(state.head, eye))
        if not {state.for_camera, main} <= state.watched.corners.keys():
            return False
    if state.outlook is None or state.T_lbase_board is None or state.for_camera:
        return all(_differs(settings, state, frame, view) for view in state.kept if not view.moving)
    placement = _placement(settings, state, frame)
    after = with_view(state.outlook, state.T_lbase_board, frame.eye_angles, placement)
    now_m = mean_deviation_m(state.outlook)
    return now_m - mean_deviation_m(after) > WORTH * (now_m - state.best_m)


def _differs(settings: CaptureSettings, state: CaptureState, frame: Frame, view: Kept) -> bool:
    """Check whether the eyes have turned, or the board has moved, since a view."""
    if (np.abs(posture_of(frame) - posture_of(view.frame)) > NEW_RAD).any():
        return True
    moved = []
    for name in state.watched.corners.keys() & view.corners.keys():
        moved_px = np.linalg.norm(state.watched.corners[name] - view.corners[name], axis=1)
        moved_px = moved_px[np.isfinite(moved_px)]
        width = settings.description.cameras[name].width
        moved.append(not len(moved_px) or np.median(moved_px) > NEW_PER_WIDTH * width)
    return any(moved) or not moved


def _placement(settings: CaptureSettings, state: CaptureState, frame: Frame) -> int:
    """Number the board's place in the head: that of the view before, if it has stayed."""
    if not state.kept:
        return 0
    last, now = state.kept[-1], state.T_lbase_board
    first = next(view for view in state.kept if view.placement == last.placement)
    neck = np.abs(frame.neck_angles - first.frame.neck_angles)
    stays = state.in_place and bool((neck < NECK_MOVED_RAD).all())
    if stays and state.outlook is not None and now is not None:
        before = _located(settings, state.head, last.corners, last.frame.eye_angles)
        if before is not None:
            stays = float(np.linalg.norm(now[:3, 3] - before[:3, 3])) < MOVED_M
            stays = stays and float(angle(before[:3, :3].T @ now[:3, :3])) < TURNED_RAD
    return last.placement if stays else max(view.placement for view in state.kept) + 1


def _with_views(
    settings: CaptureSettings, state: CaptureState, outlook: Outlook, views: tuple[Kept, ...]
) -> Outlook:
    """Add views to an outlook, by where the present head sees the board in them."""
    for view in views:
        T = _located(settings, state.head, view.corners, view.frame.eye_angles)
        if T is not None and not view.moving:
            outlook = with_view(outlook, T, view.frame.eye_angles, view.placement)
    return outlook


def _step_sweep(
    state: CaptureState, sweep: Sweep, frame: Frame
) -> tuple[CaptureState, tuple[DatasetRow, ...]]:
    """Collect the frames of a sweep; at its end the longest run of them is kept if it suffices."""
    if frame.time_s - sweep.begin_s < SWEEP_S:
        last = sweep.rows[-1][0].frame if sweep.rows else None
        late = last is None or frame.time_s > last.time_s + SWEEP_STEP_S
        late = late and (last is None or frame.joint_time_s > last.joint_time_s)
        if state.watched.corners and late:
            # Copies, since a driver may write its next images into the same arrays.
            copied = replace(frame, images={n: np.array(im) for n, im in frame.images.items()})
            place = state.kept[-1].placement
            view = Kept(replace(frame, images={}), state.watched.corners, place, moving=True)
            sweep = replace(sweep, rows=(*sweep.rows, (DatasetRow(copied, place, True), view)))
        return replace(state, sweep=sweep), ()
    state = replace(state, sweep=None, asked_s=frame.time_s)
    times_s = np.array([row.frame.time_s for row, _ in sweep.rows])
    ends = np.flatnonzero(np.diff(times_s) > MAX_GAP_S) + 1  # where the board was out of sight
    parts = np.split(np.arange(len(times_s)), ends)
    longest = max(parts, key=len)
    if len(longest) < SWEEP_ROWS:
        return state, ()
    rows, views = zip(*(sweep.rows[k] for k in longest), strict=True)
    return replace(state, kept=(*state.kept, *views)), rows


def with_estimate(settings: CaptureSettings, state: CaptureState, found: Estimate) -> CaptureState:
    """Go on with a calibration: its head, its plan, and whether it is good enough."""
    state = replace(state, estimate=found)
    if found.head is not None:
        state = replace(state, head=found.head)
    if found.candidates is not None:
        outlook = begin_outlook(found.candidates, settings.limits_rad)
        outlook = _with_views(settings, state, outlook, state.kept[found.rows :])
        state = replace(state, outlook=outlook)
        if state.for_camera not in _missing(settings, state):
            state = _ask(settings, state, state.watched.time_s)
        now_m, later_m = found.accuracy_m
        if now_m <= settings.goal_m and not found.missing:
            return replace(state, finished="the accuracy is reached")
        if later_m > NO_GAIN * now_m and not found.missing:
            return replace(state, finished="more views would not help")
    elif found.head is not None and state.views >= WITHOUT_PLAN and not found.missing:
        return replace(state, finished=f"{state.views} views usually suffice where none is planned")
    if state.views >= settings.most_views:
        return replace(state, finished=f"{state.views} views are as many as were allowed")
    return state
