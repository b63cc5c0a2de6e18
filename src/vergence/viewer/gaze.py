"""Record a gaze controller: its images, its commands and its estimates.

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

Images and postures are logged frame by frame, curves and trails of many frames at once.
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
from vergence.viewer.layouts import camera_entities
from vergence.viewer.recording import log_curve, log_frame, set_time, time_columns
from vergence.viewer.seen import log_learned, log_matches
from vergence.viewer.shapes import log_points_style, placed


@dataclass(frozen=True, eq=False)
class Moment:
    """State of a controller after a frame, and the ground truth. Positions are in frame body [m];
    NaN: there is none, or it is not known."""

    time_s: float
    """Time in the recording."""
    lanes: Mapping[str, str]
    """State of the gaze and of other parts of the experiment, by lane."""
    readings: Array
    """(j,) joint readings [rad]."""
    commanded: Array
    """(j,) commanded joint angles [rad], at the moment of the image."""
    axes: Array
    """(E, 2, 3) by eye in use: centre of the narrow camera, and a point on its axis."""
    fused: Array
    """(3,) filtered position of the object."""
    one_frame: Array
    """(3,) position by stereo from this frame alone."""
    by_joints: Array
    """(3,) the same by the joint readings, where the geometry is seen."""
    truth: Array
    """(3,) true position of the object."""
    errors_px: Array
    """(E,) by eye in use: true distance of the object from the centre of the narrow image."""
    hand: Array
    """(3,) position of the hand."""


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
    """Return the moment of a frame; `lanes` are those of other parts than the gaze."""

    def known(position: Array | None) -> Array:
        return np.full(3, np.nan) if position is None else position

    readings = np.concatenate([frame.neck_angles, frame.eye_angles])
    fused = known(None if state.track is None else state.track.position)
    axes = []
    for T in _narrow_cameras(settings, readings).values():
        length = np.nan_to_num(np.linalg.norm(fused - T[:3, 3]), nan=style.AXIS_M)
        axes.append([T[:3, 3], T[:3, 3] + length * T[:3, 2]])
    return Moment(
        time_s=time_s,
        lanes={"gaze": state.phase.value, **lanes},
        readings=readings,
        commanded=setpoints_at(state.commands, frame.time_s),
        axes=np.array(axes),
        fused=fused,
        one_frame=known(state.measured),
        by_joints=known(state.by_joints),
        truth=truth,
        errors_px=errors_px,
        hand=known(hand),
    )


def _narrow_cameras(settings: GazeSettings, readings: Array) -> dict[Side, Array]:
    """Return by eye the pose (4, 4) of the narrow camera in frame body, at readings (j,)."""
    head = settings.calibration
    return {
        eye: T_body_base(head, eye, readings)
        @ T_base_cam(head, cameras.narrow, readings[EYE_READINGS])
        for eye, cameras in settings.eyes.items()
    }


def aims(settings: GazeSettings, state: GazeState, frame: Frame) -> dict[str, Array]:
    """Return by camera the target pixel (2,) of the object.

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
    """Record a posture, and images with the object's positions.

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
    head, geometry = settings.calibration, state.geometry
    log_frame(
        rec,
        head,
        time_s=time_s,
        index=index,
        frame=frame if pictures else None,
        body_poses=body_poses,
        detected=state.pixels,
        truth=truth,
    )
    if geometry is not None and geometry.updated_s == frame.time_s:
        log_learned(rec, head, geometry.state)
    if not pictures:
        return
    if geometry is not None and geometry.latest is not None and geometry.time_s == frame.time_s:
        log_matches(rec, head, geometry.latest)
    for name, pixel in aims(settings, state, frame).items():
        if name in frame.images:
            height, width = frame.images[name].shape[:2]
            u, v = pixel + 0.5
            strips = [[(0, v), (width, v)], [(u, 0), (u, height)]]
            rec.log(f"{camera_entities(head)[name]}/aim", rr.LineStrips2D(strips))


def log_gaze_styles(rec: rr.RecordingStream, head: HeadCalibration, T_world_body: Array) -> None:
    """Record names and colours of curves and marks, and the pose (4, 4) of frame body."""
    curves: dict[str, tuple[str, tuple[int, int, int]]] = {
        "error/by_joints": ("one frame by the joints", style.OLD),
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
    for joint, color in style.HEAD_JOINT_COLOURS.items():
        name = joint.replace("_", " ").removeprefix("neck ")
        curves[_joint(joint, "command_")] = f"{name}, commanded", style.pale(color)
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
    """Record curves, trails and states of moments in order of time.

    A long run is recorded in parts: `first` is the number of the first moment, and `lanes` are
    those of the moment before. `eyes` are the E eyes in use, `joints` the names of the j joints.
    """
    if not moments:
        return
    time_s, index = np.array([m.time_s for m in moments]), first + np.arange(len(moments))
    times = time_columns(time_s, index)
    fused, one_frame, by_joints, truth, hand, errors, readings, commanded = (
        np.array([getattr(m, name) for m in moments])
        for name in ("fused", "one_frame", "by_joints", "truth", "hand", "errors_px", "readings",
                     "commanded")
    )  # fmt: skip
    series: dict[str, Array] = {
        "error/fused": 1e3 * np.linalg.norm(fused - truth, axis=1),
        "error/by_one_frame": 1e3 * np.linalg.norm(one_frame - truth, axis=1),
        "error/by_joints": 1e3 * np.linalg.norm(by_joints - truth, axis=1),
        "hand/distance": 1e3 * np.linalg.norm(hand - truth, axis=1),
    }
    for k, axis in enumerate(style.AXIS_COLOURS):
        series |= {f"position/{axis}": fused[:, k], f"position/true_{axis}": truth[:, k]}
    series |= {f"gaze_error/{eye}": errors[:, k] for k, eye in enumerate(eyes)}
    for k, joint in enumerate(joints):
        series |= {_joint(joint): readings[:, k], _joint(joint, "command_"): commanded[:, k]}
    for entity, values in series.items():
        if np.isfinite(values).any():  # at NaN a curve breaks
            log_curve(rec, entity, times, values)
    for name, points in {"trail": fused, "estimate": fused, "hand_trail": hand}.items():
        good = np.isfinite(points).all(axis=1)
        if good.any():
            columns = rr.Points3D.columns(positions=points[good])
            rec.send_columns(f"world/gaze/{name}", time_columns(time_s[good], index[good]), columns)
    strips = np.array([m.axes for m in moments]).reshape(-1, 2, 3)
    rays = rr.LineStrips3D.columns(strips=list(strips)).partition(np.full(len(moments), len(eyes)))
    rec.send_columns("world/gaze/axes", times, rays)
    for k, m in enumerate(moments, start=first):
        for lane in {*lanes, *m.lanes}:
            if lanes.get(lane) != m.lanes.get(lane):
                set_time(rec, m.time_s, k)
                rec.log(f"doing/{lane}", rr.StateChange(state=m.lanes.get(lane, "")))
        lanes = m.lanes
