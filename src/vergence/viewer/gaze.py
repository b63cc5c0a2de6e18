"""Record a gaze controller frame by frame: its images, its commands and its estimates.

Positions and errors are in frame body, the entity /world/gaze. Curves are below /gaze_error [px],
/position [m], /error and /hand [mm], /eyes and /neck [rad]; states are below /doing.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import rerun as rr

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.gaze.commands import setpoints_at
from vergence.gaze.foveation import ideal_wide_pixel
from vergence.gaze.state import GazeSettings, GazeState
from vergence.geometry.head import base_pose_in_body, camera_pose_in_base
from vergence.geometry.kinematics import EYES, Side, eye_pose
from vergence.geometry.se3 import inverse, pose, transform
from vergence.viewer import style
from vergence.viewer.layouts import camera_entities
from vergence.viewer.live import Feed
from vergence.viewer.recording import log_frame, set_time
from vergence.viewer.seen import log_learned, log_matches, log_seen_styles
from vergence.viewer.shapes import log_points_style, placed


@dataclass(frozen=True, eq=False)
class Observed:
    """Ground truth of a moment. Positions are in frame body [m]; NaN: not known."""

    time_s: float
    """Time in the recording."""
    index: int
    """Number of the frame."""
    body_poses: Mapping[str, Array]
    """By name, poses (4, 4) in the world."""
    pixels: Mapping[str, Array]
    """By camera, the true pixel (2,) of the object."""
    position: Array
    """(3,) true position of the object."""
    errors_px: Mapping[Side, float]
    """By eye in use, true distance of the object from the centre of the narrow image [px]."""
    hand: Array | None
    """(3,) position of the hand by its encoders; None: there is no hand."""


def log_gaze(
    rec: rr.RecordingStream,
    settings: GazeSettings,
    state: GazeState,
    frame: Frame,
    observed: Observed,
) -> None:
    """Record a frame, the state of the controller after it, and the truth."""
    head, geometry = settings.calibration, state.geometry
    log_frame(
        rec,
        head,
        time_s=observed.time_s,
        index=observed.index,
        frame=frame,
        body_poses=observed.body_poses,
        detected=state.pixels,
        truth=observed.pixels,
    )
    readings = np.concatenate([frame.neck_angles, frame.eye_angles])
    _log_positions(rec, settings, state, observed)
    _log_axes(rec, settings, state, readings)
    commanded = setpoints_at(state.commands, frame.time_s)
    for joint, angle, command in zip(settings.joints, readings, commanded, strict=True):
        rec.log(_joint(settings, joint), rr.Scalars(angle))
        rec.log(_joint(settings, joint, "command_"), rr.Scalars(command))
    if geometry is not None and geometry.updated_s == frame.time_s:
        log_learned(rec, head, geometry.state)
    latest = None if geometry is None or geometry.time_s != frame.time_s else geometry.latest
    if frame.images and latest is not None:
        log_matches(rec, head, latest)
    for name, pixel in aims(settings, state, frame).items():
        if name not in frame.images:
            continue
        height, width = frame.images[name].shape[:2]
        u, v = pixel + 0.5
        strips = [[(0, v), (width, v)], [(u, 0), (u, height)]]
        rec.log(
            f"{camera_entities(head)[name]}/aim",
            rr.LineStrips2D(strips, colors=style.AIM, radii=0.6),
        )


def watch_gaze(feed: Feed, settings: GazeSettings) -> Callable[[GazeState, Frame | None], None]:
    """Make the `watch` of `run_gaze` that records and shows a head whose truth is unknown."""
    head, unknown = settings.calibration, np.full(3, np.nan)
    T_world_body = pose(t=[0.0, 0.0, style.EYE_HEIGHT_M])
    feed.always(log_gaze_styles, settings, T_world_body)
    count, phase = 0, ""

    def watch(state: GazeState, frame: Frame | None) -> None:
        nonlocal count, phase
        if frame is None:
            return
        if not count and state.geometry is not None:
            feed.always(log_seen_styles, head, state.geometry.state)
        eyes = {
            f"{eye}_eye": T_world_body
            @ base_pose_in_body(head, eye, frame.neck_angles)
            @ eye_pose(head.kinematics, eye, frame.eye_angles)
            for eye in EYES
        }
        observed = Observed(frame.time_s, count, eyes, {}, unknown, {}, None)
        if state.phase.value != phase:
            phase = state.phase.value
            feed.always(log_states, frame.time_s, count, {"gaze": phase})
        # Copies, since a driver may write its next images into the same arrays.
        images = {name: np.array(image) for name, image in frame.images.items()}
        feed(log_gaze, settings, state, replace(frame, images=images), observed)
        count += 1

    return watch


def log_states(
    rec: rr.RecordingStream, time_s: float, index: int, lanes: Mapping[str, str]
) -> None:
    """Record the states of parts of the experiment that have changed, by lane."""
    set_time(rec, time_s, index)
    for lane, name in lanes.items():
        rec.log(f"doing/{lane}", rr.StateChange(state=name))


def _log_positions(
    rec: rr.RecordingStream, settings: GazeSettings, state: GazeState, observed: Observed
) -> None:
    """Record estimates, their errors and the hand; curves break where they are not known."""
    truth, unknown = observed.position, np.full(3, np.nan)
    fused = unknown if state.track is None else state.track.position
    estimates = {"error/fused": fused, "error/by_one_frame": state.measured}
    trails = {"trail": fused, "estimate": fused}
    if observed.hand is not None:
        estimates["hand/distance"] = trails["hand_trail"] = observed.hand
    for entity, position in estimates.items():
        error_m = np.linalg.norm((unknown if position is None else position) - truth)
        rec.log(entity, rr.Scalars(1e3 * error_m))
    for k, axis in enumerate(style.AXIS_COLOURS):
        rec.log(f"position/{axis}", rr.Scalars(fused[k]))
        rec.log(f"position/true_{axis}", rr.Scalars(truth[k]))
    for eye, error_px in observed.errors_px.items():
        rec.log(f"gaze_error/{eye}", rr.Scalars(error_px))
    for name, position in trails.items():
        if np.isfinite(position).all():
            rec.log(f"world/gaze/{name}", rr.Points3D.from_fields(positions=[position]))


def _log_axes(
    rec: rr.RecordingStream, settings: GazeSettings, state: GazeState, readings: Array
) -> None:
    """Record the axes of the narrow cameras, up to the object's distance where that is known."""
    strips = []
    for T in _narrow_cameras(settings, readings).values():
        length = 1.0
        if state.track is not None:
            length = float(np.linalg.norm(state.track.position - T[:3, 3]))
        strips.append([T[:3, 3], T[:3, 3] + length * T[:3, 2]])
    rec.log("world/gaze/axes", rr.LineStrips3D(strips, colors=style.RAY, radii=-1.5))


def _narrow_cameras(settings: GazeSettings, readings: Array) -> dict[Side, Array]:
    """Compute the pose (4, 4) of each narrow camera in frame body, at readings (j,)."""
    head = settings.calibration
    return {
        eye: base_pose_in_body(head, eye, readings)
        @ camera_pose_in_base(head, cameras.narrow, readings[settings.readings])
        for eye, cameras in settings.eyes.items()
    }


def aims(settings: GazeSettings, state: GazeState, frame: Frame) -> dict[str, Array]:
    """Compute the target pixel (2,) of the object in each camera.

    In the narrow image it is the principal point; in the wide image of another camera the pixel of
    Eqs. 18-19 for the estimated depth, or its limit at infinity while there is no estimate.
    """
    head = settings.calibration
    readings = np.concatenate([frame.neck_angles, frame.eye_angles])
    found = {}
    for eye, T in _narrow_cameras(settings, readings).items():
        cameras = settings.eyes[eye]
        found[cameras.narrow] = head.camera(cameras.narrow).intrinsics.matrix[:2, 2]
        if cameras.wide == cameras.narrow:
            continue
        depth = 0.0
        if state.track is not None:
            depth = float(transform(inverse(T), state.track.position)[2])
        depth = depth if depth > 0 else np.inf
        found[cameras.wide] = ideal_wide_pixel(head, eye, depth, cameras=cameras)
    return found


def log_gaze_styles(rec: rr.RecordingStream, settings: GazeSettings, T_world_body: Array) -> None:
    """Record names and colours of curves and marks, and the pose (4, 4) of frame body."""
    curves: dict[str, tuple[str, tuple[int, int, int]]] = {
        "error/by_one_frame": ("one frame", style.PAPER),
        "error/fused": ("fused", style.ESTIMATE),
        "hand/distance": ("hand from the object", style.HAND),
    }
    for axis, colour in style.AXIS_COLOURS.items():
        label = "x = depth" if axis == "x" else axis
        curves[f"position/true_{axis}"] = f"{label}, truth", style.PALE[axis]
        curves[f"position/{axis}"] = label, colour
    for eye, colours in style.EYE_COLOURS.items():
        curves[f"gaze_error/{eye}"] = f"{eye} eye", colours[0]
    for joint, color in style.joint_colours(
        settings.joints, settings.calibration.neck.names
    ).items():
        name = joint.replace("_", " ").removeprefix("neck ")
        curves[_joint(settings, joint, "command_")] = f"{name}, commanded", style.pale(color)
        curves[_joint(settings, joint)] = name, color
    for entity, (name, color) in curves.items():
        line = rr.SeriesLines(names=name, colors=color, widths=1.5, aggregation_policy="MinMax")
        rec.log(entity, line, static=True)
    names, colors = zip(*style.STATE_COLOURS.items(), strict=True)
    rec.log("doing/gaze", rr.StateConfiguration(values=names, colors=colors), static=True)
    rec.log("world/gaze", placed(T_world_body), static=True)
    log_points_style(rec, "world/gaze/trail", 1.5, style.OLD)
    log_points_style(rec, "world/gaze/estimate", 6.0, style.ESTIMATE)
    log_points_style(rec, "world/gaze/hand_trail", 1.5, style.HAND)


def _joint(settings: GazeSettings, joint: str, kind: str = "") -> str:
    part = "neck" if joint in settings.joints[settings.neck] else "eyes"
    entity = re.sub(r"[^A-Za-z0-9_]", "_", joint)
    return f"{part}/{kind}{entity}"
