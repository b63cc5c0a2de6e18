"""Closed-loop gaze: find an object, turn to it, keep it on the fovea, know where it is.

Pure functions: `step` takes the state, a frame and the time, and returns the next state, which
holds the command for the joints. All that it knows comes from frames and from its own commands.

One law serves all phases. Where the object appears in an eye's image, seen from where that eye was
sent at the moment of the image, gives the direction to it, and the depth of the track the point;
the angles that centre the point are the goal. For the narrow image this is a closed loop, whose
goal is the present posture once the error is zero, whatever the gains of the joints; for the wide
image it is Eqs. 18-19. On top of it goes how the angles to the tracked point change, with its
velocity and with the motion of the neck: the feed-forward of smooth pursuit, and the
vestibulo-ocular reflex.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.gaze.commands import (
    EYES_4,
    HEAD_JOINTS,
    NECK,
    Command,
    Head,
    commanded,
    setpoint,
    stay,
)
from vergence.gaze.foveation import eye_angles_to, gaze_angles
from vergence.gaze.kalman import Track
from vergence.gaze.observation import (
    EYE_ANGLES,
    aim_by_one_eye,
    best_camera,
    chain,
    measure,
    posture_at_image,
    rays_to,
    see,
)
from vergence.gaze.state import NARROW, WIDE, Phase, Settings, State, start
from vergence.geometry.head import T_body_base
from vergence.geometry.kinematics import EYES, Side
from vergence.geometry.se3 import inverse, transform

__all__ = ["NARROW", "WIDE", "Phase", "Settings", "State", "look", "start", "step"]

_RATE_STEP_S = 1e-3
_SEARCH_RAD = np.array(
    [(0, 0), (0.5, 0), (-0.5, 0), (-0.5, 0.3), (0.5, 0.3), (0.5, -0.3), (-0.5, -0.3)]
)
"""Pan and tilt of the places to which a search looks, one after the other."""


def look(
    head: Head,
    settings: Settings,
    state: State,
    until_s: float,
    *,
    watch: Callable[[State, Frame | None], None] = lambda state, frame: None,
) -> State:
    """Run the control loop on a head until a time of its clock.

    Args:
        head: what is controlled.
        settings: of the controller.
        state: to go on from.
        until_s: when to stop.
        watch: is shown every state and the frame that led to it.
    """
    while head.now_s() < until_s:
        frame = head.read(state.cameras)
        state = step(settings, state, frame, head.now_s())
        head.command(state.command)
        watch(state, frame)
    return state


def step(settings: Settings, state: State, frame: Frame | None, now_s: float) -> State:
    """Return the next state: see, estimate, decide, command.

    Args:
        settings: of the controller.
        state: the present one.
        frame: the latest; None, one that was here before, or one older than that: nothing new.
        now_s: from when on the command can take effect, not before the frame's time stamp.
    """
    if frame is None or frame.time_s <= state.frame_s:
        return _without_news(settings, state, now_s)
    state = see(settings, state, frame)
    if frame.time_s < state.landing_s:
        return replace(state, cameras=(*WIDE, *NARROW))
    posture = posture_at_image(settings, state, frame)
    rays = rays_to(settings, state, posture)
    if not rays:
        return _without_news(settings, state, now_s)
    state = measure(settings, state, frame, posture)
    state = replace(aim_by_one_eye(settings, state, posture, rays), seen_s=frame.time_s)
    return _follow(settings, state, frame, rays, now_s)


def _in_left_base(settings: Settings, points_body: Array, neck: Array) -> Array:
    """Map points (..., 3) from frame body into the left eye's base at neck angles (..., 3)."""
    T_lbase_body = inverse(T_body_base(settings.calibration, "left", chain(settings, neck)))
    return transform(T_lbase_body, points_body)


def _follow(
    settings: Settings,
    state: State,
    frame: Frame,
    rays: Mapping[Side, tuple[Array, Array]],
    now_s: float,
) -> State:
    """Return the state with the command that brings the object onto both foveas, and keeps it."""
    calibration, posture = settings.calibration, posture_at_image(settings, state, frame)
    aim = state.aim
    assert aim is not None  # what is seen by one eye at least has been aimed at
    start_now = setpoint(state.command, now_s)
    neck_then = posture[NECK]
    neck_now = neck_then + start_now[NECK] - commanded(state.commands, frame.time_s)[NECK]
    version = gaze_angles(calibration, _in_left_base(settings, aim.position, neck_now))
    state = _turn_neck(settings, state, version, now_s)
    moments = np.array([frame.time_s, now_s, now_s + _RATE_STEP_S])
    velocity = aim.velocity * _is_moving(settings, aim)
    points = aim.position + (moments - frame.time_s)[:, None] * velocity
    necks = np.stack([neck_then, neck_now, neck_now + _RATE_STEP_S * state.neck_rate])
    points_lbase = _in_left_base(settings, points, necks)
    then, now, soon = gaze_angles(calibration, points_lbase)
    goal, rate = now.copy(), (soon - now) / _RATE_STEP_S
    aim_lbase = points_lbase[0]
    aim_base = {"left": aim_lbase, "right": transform(calibration.T_rbase_lbase, aim_lbase)}
    for eye, (centre, ray) in rays.items():
        away = aim_base[eye] - centre
        along = np.linalg.norm(away) / np.linalg.norm(ray)
        seen = eye_angles_to(calibration, eye, centre + along * ray)
        goal[EYE_ANGLES[eye]] = seen + (now - then)[EYE_ANGLES[eye]]
    return _send(settings, state, goal, rate, now_s)


def _turn_neck(settings: Settings, state: State, eyes: Array, now_s: float) -> State:
    """Choose the neck's speed: the eyes have gone ahead, the neck makes them comfortable.

    Args:
        settings: of the controller.
        state: the present one.
        eyes: (4,) angles of the eyes to the object.
        now_s: the time.
    """
    if not settings.use_neck or not np.isfinite(eyes).all():
        return state
    away = np.array([eyes[[1, 3]].mean(), 0.0, eyes[[0, 2]].mean()])  # pitch, roll, yaw
    begins, ends = settings.comfort_rad
    turning = np.abs(away).max() > (ends if state.neck_turning else begins)
    wanted = np.zeros(3)
    if turning:
        top = settings.neck_speed_rad_s
        wanted = np.clip(settings.neck_gain_hz * away, -top, top)
    change = settings.neck_acceleration_rad_s2 * min(now_s - state.command.time_s, 0.1)
    rate = state.neck_rate + np.clip(wanted - state.neck_rate, -change, change)
    at = setpoint(state.command, now_s)[NECK]
    lower, upper = settings.limits.set_rad[NECK].T
    blocked = np.isin(HEAD_JOINTS[NECK], state.stuck)
    blocked |= ((at >= upper) & (rate > 0)) | ((at <= lower) & (rate < 0))
    return replace(state, neck_turning=bool(turning), neck_rate=np.where(blocked, 0.0, rate))


def _send(settings: Settings, state: State, goal: Array, rate: Array, now_s: float) -> State:
    """Return the state with a command for the eyes and the neck, and the phase it means."""
    at = setpoint(state.command, now_s)
    goal = np.where(np.isfinite(goal), goal, at[EYES_4])
    rate = np.where(np.isfinite(rate), rate, 0.0)
    lower, upper = settings.limits.set_rad[EYES_4].T
    distance = np.abs(np.clip(goal, lower, upper) - at[EYES_4])
    foveal = all(best_camera(state.pixels, eye) == f"{eye}_narrow" for eye in EYES)
    landing = state.landing_s
    if distance.max() > settings.saccade_rad or state.phase is Phase.LOST:
        phase = Phase.SACCADE
        landing = now_s + (distance / settings.limits.speed_rad_s[EYES_4]).max() + settings.settle_s
    elif not foveal or (goal < lower).any() or (goal > upper).any():  # the neck is to come
        phase = Phase.SACCADE
    else:
        moving = state.aim is not None and _is_moving(settings, state.aim)
        phase = Phase.PURSUIT if moving else Phase.FIXATION
    command = Command(
        now_s,
        at,
        np.concatenate([at[NECK], goal]),
        np.concatenate([state.neck_rate, rate]),
        settings.limits,
    )
    inner = foveal and phase is not Phase.SACCADE and _well_inside(settings, state)
    return replace(
        state,
        phase=phase,
        since_s=state.since_s if phase is state.phase else now_s,
        commands=(*state.commands[-15:], command),
        landing_s=landing,
        cameras=NARROW if inner else (*WIDE, *NARROW),
    )


def _is_moving(settings: Settings, track: Track) -> bool:
    """Return whether a point moves across the line of sight from the origin."""
    distance = np.linalg.norm(track.position)
    across = np.linalg.norm(np.cross(track.position / distance, track.velocity))
    return bool(across > settings.moving_rad_s * distance)


def _well_inside(settings: Settings, state: State) -> bool:
    """Return whether the object is so far from the edge that the wide images can be spared."""
    for name in NARROW:
        camera = settings.calibration.camera(name).intrinsics
        size = np.array([camera.width, camera.height])
        off = np.abs(2 * state.pixels[name] + 1 - size) / size
        if not (off < settings.outer).all():
            return False
    return True


def _without_news(settings: Settings, state: State, now_s: float) -> State:
    """Return the state when there is no new frame, or none that shows the object."""
    state = replace(state, cameras=(*WIDE, *NARROW))
    if state.phase is not Phase.LOST:
        if now_s - max(state.seen_s, state.landing_s) < settings.lost_s:
            return state  # the command in force goes on, and stops by itself
        still = stay(setpoint(state.command, now_s), settings.limits, now_s)
        return replace(
            state,
            phase=Phase.LOST,
            searched=0,
            since_s=now_s,
            commands=(*state.commands[-15:], still),
            track=None,
            aim=None,
            measured=None,
            measured_covariance=None,
            neck_rate=np.zeros(3),
            neck_turning=False,
        )
    if now_s < state.since_s + settings.search_s or now_s < state.landing_s + settings.dwell_s:
        return state
    pan, tilt = _SEARCH_RAD[state.searched % len(_SEARCH_RAD)]
    neck = np.array([0.0, 0.0, pan * settings.use_neck])
    goal = np.concatenate([neck, np.tile([pan, tilt], 2)])
    at = setpoint(state.command, now_s)
    command = Command(now_s, at, goal, np.zeros(len(HEAD_JOINTS)), settings.limits)
    landing = now_s + (np.abs(goal - at) / settings.limits.speed_rad_s).max() + settings.settle_s
    return replace(
        state,
        commands=(*state.commands[-15:], command),
        landing_s=landing,
        searched=state.searched + 1,
    )
