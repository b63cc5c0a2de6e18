"""Closed-loop gaze control: find an object, turn the eyes to it, and keep it on both foveas.

`step_gaze` is a pure function of settings, state, frame and time.

One control law serves all phases. The object's pixel in an eye's image, with that eye's set points
at the time of the image, gives the direction to the object, and the track gives its depth. The goal
is the posture that centres this point; in the wide image this implements Eqs. 18-19. The goal moves
at the rate at which the angles to the tracked point change: the feed-forward of smooth pursuit, and
the vestibulo-ocular reflex.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.data.table import MAX_DELAY_S
from vergence.gaze.commands import (
    HeadCommand,
    HeadDriver,
    hold,
    setpoint,
    setpoints_at,
)
from vergence.gaze.foveation import gaze_angles, solve_fixation
from vergence.gaze.kalman import Track
from vergence.gaze.observation import (
    Rays,
    aim_at_assumed_depth,
    detect_object,
    measure_object,
    object_rays,
    posture_at_image,
    update_track,
)
from vergence.gaze.state import GazePhase, GazeSettings, GazeState
from vergence.geometry.head import base_pose_in_body, dead_bands
from vergence.geometry.kinematics import eye_turn, readings_to_turn
from vergence.geometry.se3 import inverse, transform

_SEARCH_RAD = np.array(
    [(0, 0), (0.5, 0), (-0.5, 0), (-0.5, 0.3), (0.5, 0.3), (0.5, -0.3), (-0.5, -0.3)]
)
"""Pan and tilt of the directions of a search, in this order. A neck that takes part pans as far."""


def run_gaze(
    head: HeadDriver,
    settings: GazeSettings,
    state: GazeState,
    until_s: float,
    *,
    watch: Callable[[GazeState, Frame | None], None] = lambda state, frame: None,
) -> GazeState:
    """Run the control loop until a time of the head's clock; `watch` gets each state and frame."""
    while head.now_s() < until_s:
        frame = head.read(state.cameras)
        state = step_gaze(settings, state, frame, head.now_s())
        head.command(state.command)
        state = update_track(settings, state, frame)  # steering does not wait for it
        watch(state, frame)
    return state


def step_gaze(
    settings: GazeSettings, state: GazeState, frame: Frame | None, now_s: float
) -> GazeState:
    """Run one step of the gaze controller: detect, estimate, decide, command.

    `run_gaze` calls it in a loop; docs/own_driver.md has a driver.

    Args:
        settings: of the head and its controller.
        state: the present one.
        frame: the latest; None, a repeated frame or an older one counts as no new frame.
        now_s: time from which the command can take effect, not before the frame's time stamp.

    Raises VergenceError if the frame is not one of this head and its clock.
    """
    if frame is None or frame.time_s <= state.frame_s:
        if not isinstance(state.target, str):
            return state  # a given point needs no images
        return _wait_or_search(settings, state, now_s)
    state = detect_object(settings, state, frame, now_s)
    if frame.time_s < state.landing_s:
        return replace(state, cameras=settings.cameras)
    posture = posture_at_image(settings, state, frame)
    if not isinstance(state.target, str):
        aim = Track(frame.time_s, np.concatenate([state.target, np.zeros(6)]), np.zeros((9, 9)))
        state = replace(state, aim=aim, seen_s=frame.time_s)
        return _follow(settings, state, posture, {}, now_s)
    rays = object_rays(settings, state, posture)
    if not rays:
        return _wait_or_search(settings, state, now_s)
    state = measure_object(settings, state, frame, posture)
    state = replace(aim_at_assumed_depth(settings, state, posture, rays), seen_s=frame.time_s)
    return _follow(settings, state, posture, rays, now_s)


def _in_left_base(settings: GazeSettings, points_body: Array, neck: Array) -> Array:
    """Map points (..., 3) [m] from frame body into the left eye's base at neck angles (..., n)."""
    return transform(inverse(base_pose_in_body(settings.calibration, "left", neck)), points_body)


def _follow(
    settings: GazeSettings, state: GazeState, posture: Array, rays: Rays, now_s: float
) -> GazeState:
    """Command the posture that keeps the aim on both foveas.

    Aim, posture (j,) [rad] and rays are those at the time of the image.
    """
    calibration, aim, image_s = settings.calibration, state.aim, state.frame_s
    assert aim is not None  # `aim_at_assumed_depth` sets it if there is no measurement
    neck_then = posture[settings.neck]
    moved = setpoint(state.command, now_s) - setpoints_at(state.commands, image_s)
    neck_now = neck_then + moved[settings.neck]
    if settings.use_neck:
        aim_now = _in_left_base(settings, aim.position, neck_now)
        eyes_now = gaze_angles(calibration, aim_now, cameras=settings.narrow)
        state = _turn_neck(settings, state, eyes_now, now_s)
    step_s = 1e-3  # of the finite difference for the rate of the eyes
    moments = np.array([image_s, now_s, now_s + step_s])
    velocity = aim.velocity * _is_moving(settings, state)
    # Set points lead the object by the lag of the servos.
    ahead_s = moments - image_s + np.array([0.0, 1.0, 1.0]) * settings.servo_lag_s
    points = aim.position + ahead_s[:, None] * velocity
    necks = np.stack([neck_then, neck_now, neck_now + step_s * state.neck_rate])
    left = _in_left_base(settings, points, necks)
    points_base = {"left": left, "right": transform(calibration.T_rbase_lbase, left)}
    targets = {}
    for eye, cameras in settings.eyes.items():
        sighted = points_base[eye][0]
        if eye in rays:
            centre, ray = rays[eye]
            sighted = centre + np.linalg.norm(sighted - centre) / np.linalg.norm(ray) * ray
        targets[cameras.narrow] = np.vstack([points_base[eye], sighted])
    then, now, soon, to_sighted = solve_fixation(calibration, targets)
    goal = now + to_sighted - then
    return _move_eyes(settings, state, goal, (soon - now) / step_s, now_s)


def _turn_neck(settings: GazeSettings, state: GazeState, eyes: Array, now_s: float) -> GazeState:
    """Compute the neck's velocity from the eyes' readings (r,) [rad] that centre the object."""
    kinematics = settings.calibration.kinematics
    turns = [eye_turn(kinematics, eye, eyes) for eye in settings.eyes]
    if not np.isfinite(turns).all():
        return state
    _, tilt, pan = np.mean(turns, axis=0)
    away = settings.calibration.neck.axes @ np.array([0.0, tilt, pan])
    start_rad, stop_rad = settings.comfort_rad
    turning = np.abs(away).max() > (stop_rad if state.neck_rate.any() else start_rad)
    top = settings.neck_speed_rad_s
    wanted = np.clip(settings.neck_gain_hz * away, -top, top) if turning else np.zeros(len(away))
    at = setpoint(state.command, now_s)[settings.neck]
    lower, upper = settings.limits.setpoint_range_rad[settings.neck].T
    # Slow enough to stop at the end of the range with half the braking, which covers a frame.
    braking = settings.neck_acceleration_rad_s2 * np.maximum([at - lower, upper - at], 0)
    wanted = np.clip(wanted, -np.sqrt(braking[0]), np.sqrt(braking[1]))
    change = settings.neck_acceleration_rad_s2 * min(now_s - state.command.time_s, 0.1)
    rate = state.neck_rate + np.clip(wanted - state.neck_rate, -change, change)
    blocked = np.isin(settings.joints[settings.neck], state.stuck)
    blocked |= ((at >= upper) & (rate > 0)) | ((at <= lower) & (rate < 0))
    return replace(state, neck_rate=np.where(blocked, 0.0, rate))


def _move_eyes(
    settings: GazeSettings, state: GazeState, goal: Array, rate: Array, now_s: float
) -> GazeState:
    """Command eyes and neck, and set the phase.

    The eyes' target readings (r,) [rad] now, NaN: stay, move at a rate (r,) [rad/s], NaN: zero.
    """
    at = setpoint(state.command, now_s)
    goal = np.where(np.isfinite(goal), goal, at[settings.readings])
    rate = np.where(np.isfinite(rate), rate, 0.0)
    lower, upper = settings.limits.setpoint_range_rad[settings.readings].T
    distance = np.abs(np.clip(goal, lower, upper) - at[settings.readings])
    on_point = not isinstance(state.target, str)  # images do not show the error of the gaze
    foveal = on_point or all(state.detections.get(name) is not None for name in settings.narrow)
    landing = state.landing_s
    if distance.max() > settings.saccade_rad or state.phase is GazePhase.LOST:
        phase = GazePhase.SACCADE
        takes_s = (distance / settings.limits.speed_rad_s[settings.readings]).max()
        landing = now_s + takes_s + settings.settle_s
    elif not foveal or (goal < lower).any() or (goal > upper).any():  # until the neck follows
        phase = GazePhase.SACCADE
    else:
        phase = GazePhase.PURSUIT if _is_moving(settings, state) else GazePhase.FIXATION
    if phase is GazePhase.FIXATION:  # eyes do not follow within the backlash, and would hunt
        still = distance < dead_bands(settings.calibration)
        goal, rate = np.where(still, at[settings.readings], goal), np.where(still, 0.0, rate)
    command = HeadCommand(
        now_s,
        at,
        np.concatenate([at[settings.neck], goal]),
        np.concatenate([state.neck_rate, rate]),
        settings.limits,
    )
    narrow_suffices = phase is not GazePhase.SACCADE and state.geometry is None and not on_point
    return _send(
        state,
        command,
        phase=phase,
        since_s=state.since_s if phase is state.phase else now_s,
        landing_s=landing,
        cameras=settings.narrow if narrow_suffices else settings.cameras,
    )


def _send(state: GazeState, command: HeadCommand, **changes: Any) -> GazeState:
    """Put a command in force, and change other fields of the state.

    Earlier commands are kept as long as an image may be late.
    """
    first = sum(each.time_s <= command.time_s - MAX_DELAY_S for each in state.commands)
    commands = (*state.commands[max(first - 1, 0) :], command)
    return replace(state, commands=commands, **changes)


def _is_moving(settings: GazeSettings, state: GazeState) -> bool:
    """Test whether the object moves across the line of sight from frame body's origin.

    The commands decide, unless the speed by the readings is below a quarter of theirs: joints that
    lag behind their set points make an object at rest seem to move.
    """
    if state.aim is None:
        return False
    speed = _angular_speed(state.aim)
    by_readings = speed if state.track is None else _angular_speed(state.track)
    return speed > settings.moving_rad_s and by_readings > 0.25 * speed


def _angular_speed(track: Track) -> float:
    """Compute the angular speed of a tracked point about frame body's origin [rad/s]."""
    distance = np.linalg.norm(track.position)
    return float(np.linalg.norm(np.cross(track.position / distance, track.velocity)) / distance)


def _wait_or_search(settings: GazeSettings, state: GazeState, now_s: float) -> GazeState:
    """Continue without an image of the object: wait, then stop and forget it, then search."""
    state = replace(state, cameras=settings.cameras)
    at = setpoint(state.command, now_s)
    if state.phase is not GazePhase.LOST:
        if now_s - max(state.seen_s, state.landing_s) < settings.lost_s:
            return state  # the command in force continues, and stops after its hold time
        return _send(
            state,
            hold(at, settings.limits, now_s),
            phase=GazePhase.LOST,
            searched=0,
            since_s=now_s,
            track=None,
            aim=None,
            measured=None,
            neck_rate=np.zeros(len(settings.calibration.neck.axes)),
        )
    if now_s < state.since_s + settings.search_s or now_s < state.landing_s + settings.dwell_s:
        return state
    pan, tilt = _SEARCH_RAD[state.searched % len(_SEARCH_RAD)]
    neck = at[settings.neck]
    if settings.use_neck:
        neck = settings.calibration.neck.axes @ np.array([0.0, 0.0, pan])
    eyes = readings_to_turn(settings.calibration.kinematics, np.array([0.0, tilt, pan]))
    goal = np.concatenate([neck, eyes])
    command = HeadCommand(now_s, at, goal, np.zeros(len(goal)), settings.limits)
    landing = now_s + (np.abs(goal - at) / settings.limits.speed_rad_s).max() + settings.settle_s
    return _send(state, command, landing_s=landing, searched=state.searched + 1)
