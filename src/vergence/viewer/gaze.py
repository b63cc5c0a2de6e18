"""Record the behaviour of a gaze controller: its images, its commands and its estimates.

Images and postures are logged frame by frame (`log_gaze_frame`), curves and trails of many
frames at once (`log_gaze_series`). In addition to the entities of every recording there are

    /world/<side>_eye/<camera>/aim  a long cross at the target position of the object
    /world/gaze                     frame body, with the axes, the estimate, the truth, the hand
    /doing/<lane>                   state of the gaze and of other parts of the experiment
    /gaze_error/left, right         true distance of the object from the narrow image's centre [px]
    /position/x, y, z, true_x, ...  estimate and truth [m], in frame body
    /error/fused, by_one_frame      distance of the estimates from the truth [mm]
    /error/by_joints                by the joints alone, where the geometry is seen (`viewer.seen`)
    /hand/distance                  distance of the hand, by its encoders, from the object [mm]
    /eyes/<joint>, command_<joint>  readings and commands of the eyes [rad]
    /neck/<joint>, command_<joint>  readings and commands of the neck [rad]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import rerun as rr

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.gaze.commands import EYE_READINGS, HEAD_JOINTS, NECK, setpoints_at
from vergence.gaze.foveation import ideal_wide_pixel
from vergence.gaze.state import GazeSettings, GazeState
from vergence.geometry.head import HeadCalibration, T_base_cam, T_body_base
from vergence.geometry.kinematics import EYES, Side
from vergence.geometry.se3 import inverse, transform
from vergence.viewer import style
from vergence.viewer.frame import log_frame, time_columns
from vergence.viewer.layout import camera_entities
from vergence.viewer.seen import log_learned, log_matches
from vergence.viewer.shapes import log_points_style, placed


@dataclass(frozen=True, eq=False)
class Moment:
    """State of the controller at one moment, with the ground truth that an observer has."""

    time_s: float
    """Time in the recording."""
    lanes: Mapping[str, str]
    """By lane: the state of the gaze or of another part of the experiment."""
    readings: Array
    """(j,) joint readings [rad]."""
    commanded: Array
    """(j,) commanded joint angles [rad], at the moment of the image."""
    axes: Array
    """(E, 2, 3) by eye: the centre of the camera to be centred and a point on its axis, in frame
    body. E is 2, or 1 for a head that uses one eye."""
    fused: Array
    """(3,) filtered position of the object, in frame body; NaN: no estimate."""
    one_frame: Array
    """(3,) position by stereo from this frame alone, in frame body; NaN: no estimate."""
    by_joints: Array
    """(3,) the same by the joint readings, where the geometry is seen; NaN: no estimate."""
    truth: Array
    """(3,) true position of the object, in frame body; NaN: unknown, or the object is hidden."""
    errors_px: Array
    """(E,) by eye: true distance of the object from the centre of the image to be centred."""
    hand: Array
    """(3,) position of the hand, in frame body; NaN: there is none."""


def moment(
    settings: GazeSettings,
    state: GazeState,
    frame: Frame,
    time_s: float,
    *,
    lanes: Mapping[str, str],
    truth: Array,
    errors_px: Array,
    hand: Array | None,
) -> Moment:
    """Return the moment of a frame, from the controller's state and the observer's truth.

    The state is that after the frame; lanes come in addition to the phase of the gaze.
    """
    readings = np.concatenate([frame.neck_angles, frame.eye_angles])
    nowhere = np.full(3, np.nan)
    return Moment(
        time_s=time_s,
        lanes={"gaze": state.phase.value, **lanes},
        readings=readings,
        commanded=setpoints_at(state.commands, frame.time_s),
        axes=_axes(settings, readings, state),
        fused=nowhere if state.track is None else state.track.position,
        one_frame=nowhere if state.measured is None else state.measured,
        by_joints=nowhere if state.by_joints is None else state.by_joints,
        truth=truth,
        errors_px=errors_px,
        hand=nowhere if hand is None else hand,
    )


def _cameras(settings: GazeSettings, readings: Array) -> dict[Side, Array]:
    """Return by eye the pose (4, 4) of the camera to be centred in frame body, at readings (j,)."""
    head = settings.calibration
    return {
        eye: T_body_base(head, eye, readings)
        @ T_base_cam(head, cameras.narrow, readings[EYE_READINGS])
        for eye, cameras in settings.eyes.items()
    }


def _axes(settings: GazeSettings, readings: Array, state: GazeState) -> Array:
    """Return Moment.axes; an axis ends at the object's distance where that is known."""
    found = []
    for T in _cameras(settings, readings).values():
        length = style.AXIS_M
        if state.track is not None:
            length = float(np.linalg.norm(state.track.position - T[:3, 3]))
        found.append([T[:3, 3], T[:3, 3] + length * T[:3, 2]])
    return np.array(found)


def aims(settings: GazeSettings, state: GazeState, frame: Frame) -> dict[str, Array]:
    """Return by camera the target pixel (2,) of the object.

    In the image to be centred that is the principal point; in the wide image of another camera the
    pixel of Eqs. 18-19 for the estimated depth, or its limit at infinity while there is none.
    """
    head = settings.calibration
    readings = np.concatenate([frame.neck_angles, frame.eye_angles])
    found = {}
    for eye, T in _cameras(settings, readings).items():
        cameras = settings.eyes[eye]
        found[cameras.narrow] = head.camera(cameras.narrow).intrinsics.matrix[:2, 2]
        if cameras.wide == cameras.narrow:
            continue
        depth = np.inf
        if state.track is not None:
            depth = float(transform(inverse(T), state.track.position)[2])
        depth = depth if depth > 0 else np.inf
        found[cameras.wide] = ideal_wide_pixel(head, eye, depth, cameras=cameras)
    return found


def log_gaze_frame(
    rec: rr.RecordingStream,
    settings: GazeSettings,
    state: GazeState,
    frame: Frame,
    *,
    time_s: float,
    index: int,
    pictures: bool,
    body_poses: Mapping[str, Array],
    truth: Mapping[str, Array],
) -> None:
    """Record a posture, and the images with the object's target, detected and true positions.

    Images that were not searched get no mark of a detection.

    Args:
        rec: the recording.
        settings: of the controller.
        state: of the controller after the frame.
        frame: the frame.
        time_s: in the recording.
        index: number of the frame.
        pictures: whether the images are recorded.
        body_poses: by name, poses (4, 4) in the world.
        truth: by camera, the true pixel (2,) of the object.
    """
    log_frame(
        rec,
        settings.calibration,
        time_s=time_s,
        index=index,
        frame=frame if pictures else None,
        body_poses=body_poses,
        detected=state.pixels,
        truth=truth,
    )
    geometry = state.geometry
    if geometry is not None and geometry.updated_s == frame.time_s:
        log_learned(rec, settings.calibration, geometry.state)
    if not pictures:
        return
    if geometry is not None and geometry.latest is not None and geometry.time_s == frame.time_s:
        log_matches(rec, settings.calibration, geometry.latest)
    for name, pixel in aims(settings, state, frame).items():
        if name in frame.images:
            height, width = frame.images[name].shape[:2]
            u, v = pixel + 0.5
            strips = [[(0, v), (width, v)], [(u, 0), (u, height)]]
            rec.log(f"{camera_entities(settings.calibration)[name]}/aim", rr.LineStrips2D(strips))


def log_gaze_styles(rec: rr.RecordingStream, head: HeadCalibration, T_world_body: Array) -> None:
    """Record names and colours of curves and marks, and the pose (4, 4) of frame body."""
    curves: dict[str, tuple[str, tuple[int, int, int]]] = {}
    for axis, colour in style.AXIS_COLOURS.items():
        label = "x = depth" if axis == "x" else axis
        curves[f"position/true_{axis}"] = f"{label}, truth", style.PALE[axis]
        curves[f"position/{axis}"] = label, colour
    for eye, colours in style.EYE_COLOURS.items():
        curves[f"gaze_error/{eye}"] = f"{eye} eye", colours[0]
    curves["error/by_joints"] = "one frame by the joints", style.OLD
    curves["error/by_one_frame"] = "one frame", style.PAPER
    curves["error/fused"] = "fused", style.ESTIMATE
    curves["hand/distance"] = "hand from the object", style.HAND
    for joint, color in style.HEAD_JOINT_COLOURS.items():
        name = joint.replace("_", " ").removeprefix("neck ")
        pale = tuple(round(0.45 * level + 0.55 * 255) for level in color)
        curves[_joint(joint, "command_")] = f"{name}, commanded", (pale[0], pale[1], pale[2])
        curves[_joint(joint)] = name, color
    for entity, (name, color) in curves.items():
        line = rr.SeriesLines(names=name, colors=color, widths=1.5, aggregation_policy="MinMax")
        rec.log(entity, line, static=True)
    names, colors = zip(*style.STATE_COLOURS.items(), strict=True)
    rec.log("doing/gaze", rr.StateConfiguration(values=names, colors=colors), static=True)
    for entity in camera_entities(head).values():
        cross = rr.LineStrips2D.from_fields(colors=style.AIM, radii=0.6)
        rec.log(f"{entity}/aim", cross, static=True)
    rec.log("world/gaze", placed(T_world_body), static=True)
    log_points_style(rec, "world/gaze/trail", 1.5, style.OLD)
    log_points_style(rec, "world/gaze/estimate", 6.0, style.ESTIMATE)
    log_points_style(rec, "world/gaze/hand_trail", 1.5, style.HAND)
    rays = rr.LineStrips3D.from_fields(colors=style.RAY, radii=-1.5)
    rec.log("world/gaze/axes", rays, static=True)


def _joint(joint: str, kind: str = "") -> str:
    return f"{'neck' if joint in HEAD_JOINTS[NECK] else 'eyes'}/{kind}{joint}"


def log_gaze_series(
    rec: rr.RecordingStream,
    moments: Sequence[Moment],
    *,
    eyes: Sequence[Side] = EYES,
    joints: Sequence[str] = HEAD_JOINTS,
    first: int = 0,
    lanes: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """Record curves, trails and states of moments, which are in order of time.

    Of a long run parts can be recorded: `first` is then the number of the first moment, and `lanes`
    are those of the moment before. `eyes` are those that are used, E of them; `joints` are the
    names of the j joints of a posture.
    """
    if not moments:
        return
    time_s, index = np.array([m.time_s for m in moments]), first + np.arange(len(moments))
    fused, one_frame, by_joints, truth, hand, errors = (
        np.array([getattr(m, name) for m in moments])
        for name in ("fused", "one_frame", "by_joints", "truth", "hand", "errors_px")
    )
    series: dict[str, Array] = {
        "error/fused": 1e3 * np.linalg.norm(fused - truth, axis=1),
        "error/by_one_frame": 1e3 * np.linalg.norm(one_frame - truth, axis=1),
        "error/by_joints": 1e3 * np.linalg.norm(by_joints - truth, axis=1),
        "hand/distance": 1e3 * np.linalg.norm(hand - truth, axis=1),
    }
    for k, axis in enumerate(style.AXIS_COLOURS):
        series |= {f"position/{axis}": fused[:, k], f"position/true_{axis}": truth[:, k]}
    for k, eye in enumerate(eyes):
        series[f"gaze_error/{eye}"] = errors[:, k]
    for k, joint in enumerate(joints):
        series[_joint(joint)] = np.array([m.readings[k] for m in moments])
        series[_joint(joint, "command_")] = np.array([m.commanded[k] for m in moments])
    for entity, values in series.items():
        if np.isfinite(values).any():
            times = time_columns(time_s, index)  # with NaN, at which a curve breaks
            rec.send_columns(entity, times, rr.Scalars.columns(scalars=values))
    for points, names in ((fused, ("trail", "estimate")), (hand, ("hand_trail",))):
        good = np.isfinite(points).all(axis=1)
        for name in names if good.any() else ():
            times = time_columns(time_s[good], index[good])
            rec.send_columns(
                f"world/gaze/{name}", times, rr.Points3D.columns(positions=points[good])
            )
    strips = np.array([m.axes for m in moments]).reshape(-1, 2, 3)
    rays = rr.LineStrips3D.columns(strips=list(strips)).partition(np.full(len(moments), len(eyes)))
    rec.send_columns("world/gaze/axes", time_columns(time_s, index), rays)
    _log_lanes(rec, moments, first, lanes)


def _log_lanes(
    rec: rr.RecordingStream, moments: Sequence[Moment], first: int, before: Mapping[str, str]
) -> None:
    for index, m in enumerate(moments, start=first):
        for lane in {*before, *m.lanes}:
            if before.get(lane) != m.lanes.get(lane):
                rec.set_time("sim_time", duration=m.time_s)
                rec.set_time("frame", sequence=index)
                rec.log(f"doing/{lane}", rr.StateChange(state=m.lanes.get(lane, "")))
        before = m.lanes
