"""Reach for what the eyes are on, and close the hand on it (the paper's Fig. 12).

Pure functions: `step` takes the state, a frame and where the hand is by its own encoders, and
returns the next state, which holds the commands to the head and to the hand. The eyes are the
business of `gaze`; nothing here moves them.

From afar the hand goes where the eyes see the object, as well as that is known: to a place below
it. There the eyes see the marker on the hand as well, and from then on the hand goes by the
difference between the two. Both are located by the same cameras at the same joint angles, so that
what is wrong with calibration, readings and the place of the arm is wrong for both alike, and
cancels the better the nearer they come. The fingers close when the object is within their
tolerance for all that is known of its place, which is decided from covariances alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.gaze.commands import EYES_4, Head
from vergence.gaze.controller import step as step_gaze
from vergence.gaze.kalman import Track, begin, predict, surprise, update
from vergence.gaze.observation import chain, posture_at_image
from vergence.gaze.state import NARROW, WIDE
from vergence.gaze.state import Phase as Gaze
from vergence.geometry.head import T_body_base
from vergence.geometry.se3 import transform
from vergence.reach.state import (
    Hand,
    HandCommand,
    HandReading,
    Phase,
    Settings,
    State,
    start,
    uncertainty,
)
from vergence.stereo.uncertainty import locate_both
from vergence.vision.sphere import find_sphere

__all__ = ["Hand", "HandCommand", "HandReading", "Phase", "Settings", "State", "grasp", "start"]

_ENGAGED = (Phase.REACH, Phase.UNSEEN, Phase.SERVO)
_LEEWAY_M = 0.03  # beyond reach, for a hand that is under way: it shall not waver at the border
_KEPT = 16


def grasp(
    head: Head,
    hand: Hand,
    settings: Settings,
    state: State,
    until_s: float,
    *,
    watch: Callable[[State, Frame | None], None] = lambda state, frame: None,
) -> State:
    """Run the control loop on a head and a hand until a time, or until something is held.

    Args:
        head: what looks.
        hand: what reaches.
        settings: of both.
        state: to go on from.
        until_s: when to stop.
        watch: is shown every state and the frame that led to it.
    """
    while head.now_s() < until_s and state.phase is not Phase.HELD:
        frame = head.read(state.cameras)
        state = step(settings, state, frame, hand.read(), head.now_s())
        head.command(state.gaze.command)
        hand.command(state.command)
        watch(state, frame)
    return state


def step(
    settings: Settings, state: State, frame: Frame | None, reading: HandReading, now_s: float
) -> State:
    """Return the next state: look, see the hand, decide, command.

    Args:
        settings: of head and hand.
        state: the present one.
        frame: the latest; None, one that was here before, or one older than that: nothing new.
        reading: where the hand is now.
        now_s: from when on commands can take effect.
    """
    before, gaze = state.gaze, step_gaze(settings.gaze, state.gaze, frame, now_s)
    readings = (*state.readings[1 - _KEPT :], reading)
    state = replace(state, gaze=gaze, readings=readings, marker=None)
    if frame is not None and gaze.frame_s > before.frame_s:
        state = _see(settings, state, frame, usable=frame.time_s >= before.landing_s)
    if now_s - state.together_s > settings.unseen_s:
        state = replace(state, target=None, apart_m=np.inf, inside=False)
    return _send(settings, _decide(settings, state, now_s), now_s)


def _see(settings: Settings, state: State, frame: Frame, *, usable: bool) -> State:
    """Find the marker in a frame, and fuse where the object is from it.

    Args:
        settings: of head and hand.
        state: after the gaze has seen the frame.
        frame: the frame.
        usable: whether the eyes stood where they were sent.
    """
    cameras = settings.gaze.calibration.cameras
    marker = {
        name: find_sphere(
            image, cameras[name].intrinsics, colour="blue", near=state.pixels.get(name)
        )
        for name, image in frame.images.items()
        if name in state.cameras
    }
    state = replace(state, pixels=marker)
    if not usable:
        return state
    for pair in (NARROW, WIDE):
        if not _shows_marker(state, pair):
            continue
        found = [_object_in(settings, state, frame, name) for name in pair]
        if np.isfinite(found).all():
            return _fuse(settings, state, frame, pair, found)
    return state


def _shows_marker(state: State, cameras: tuple[str, str]) -> bool:
    return all(np.isfinite(state.pixels.get(name, np.array(np.nan))).all() for name in cameras)


def _wanted(state: State) -> tuple[str, ...]:
    """Return the cameras to ask next: those of the gaze, and those that may show the hand."""
    if state.phase in (Phase.SEEK, Phase.TRACK):
        return state.gaze.cameras
    both = set(state.gaze.cameras) | set(NARROW)
    if not _shows_marker(state, NARROW):
        both |= set(WIDE)
    return tuple(name for name in (*WIDE, *NARROW) if name in both)


def _object_in(settings: Settings, state: State, frame: Frame, camera: str) -> Array:
    """Return the object (2,) px in an image that shows the marker.

    The gaze does not search all images that are there.
    """
    if camera in state.gaze.pixels:
        return state.gaze.pixels[camera]
    intrinsics = settings.gaze.calibration.camera(camera).intrinsics
    return find_sphere(frame.images[camera], intrinsics, near=state.pixels[camera])


def _fuse(
    settings: Settings, state: State, frame: Frame, cameras: tuple[str, str], seen: list[Array]
) -> State:
    """Bring the target up to a frame that shows object and marker to both eyes."""
    gaze = settings.gaze
    posture = posture_at_image(gaze, state.gaze, frame)
    things, markers, covariances = locate_both(
        gaze.calibration,
        (seen[0][None], seen[1][None]),
        (state.pixels[cameras[0]][None], state.pixels[cameras[1]][None]),
        posture[EYES_4][None],
        pixel_std_px=gaze.pixel_std_px,
        joint_std_rad=gaze.sent_std_rad,
        cameras=cameras,
    )
    if not np.isfinite(covariances).all():
        return state
    T = T_body_base(gaze.calibration, "left", chain(gaze, posture))
    thing, marker = transform(T, things[0]), transform(T, markers[0])
    covariance = T[:3, :3] @ covariances[0] @ T[:3, :3].T
    by_encoders = transform(_hand_at(state.readings, frame.time_s), settings.marker_hand)
    measured = by_encoders + thing - marker, covariance
    return replace(
        state,
        marker=marker,
        target=_updated(settings, state.target, frame.time_s, *measured),
        apart_m=float(np.linalg.norm(thing - marker)),
        together_s=frame.time_s,
    )


def _updated(
    settings: Settings, track: Track | None, time_s: float, point: Array, covariance: Array
) -> Track:
    """Return the track after a measurement (3,) with its covariance (3, 3)."""
    if track is not None:
        track = predict(track, time_s, jerk_density=settings.jerk_density)
        if surprise(track, point, covariance) < settings.surprise_limit:
            return update(track, point, covariance)
    return begin(
        time_s,
        point,
        covariance,
        speed_std_m_s=settings.gaze.speed_std_m_s,
        acceleration_std_m_s2=settings.gaze.acceleration_std_m_s2,
    )


def _hand_at(readings: tuple[HandReading, ...], time_s: float) -> Array:
    """Return the pose (4, 4) that the encoders had at a time: on a line, turned as it is now."""
    T = readings[-1].T_body_hand.copy()
    times = [reading.time_s for reading in readings]
    for k in range(3):
        T[k, 3] = np.interp(time_s, times, [reading.T_body_hand[k, 3] for reading in readings])
    return T


def _decide(settings: Settings, state: State, now_s: float) -> State:
    """Return the state in the phase that follows from what is known now."""
    phase, inside = _next(settings, state, now_s)
    since = state.since_s if phase is state.phase else now_s
    return replace(state, phase=phase, since_s=since, inside=inside)


def _next(settings: Settings, state: State, now_s: float) -> tuple[Phase, bool]:
    """Return the phase, and whether the hand may come up to the object."""
    if state.phase is Phase.CLOSE and not state.readings[-1].closed:
        return Phase.CLOSE, True
    if state.phase in (Phase.CLOSE, Phase.HELD):
        elsewhere = state.phase is Phase.HELD and state.target is not None
        if not elsewhere or _distance(settings, state, now_s) < settings.escaped_m:
            return Phase.HELD, True
    aim = state.gaze.aim
    if aim is None or state.gaze.phase is Gaze.LOST:
        return Phase.SEEK, False
    distance = np.linalg.norm(aim.position - settings.shoulder)
    leeway = _LEEWAY_M if state.phase in _ENGAGED else 0.0
    if distance > settings.reach_m + leeway:
        return Phase.TRACK, False
    if state.target is None:
        waiting = state.phase in (Phase.REACH, Phase.UNSEEN)
        arrived = np.linalg.norm(state.hand - state.command.goal) < settings.arrived_m
        overdue = state.phase is Phase.REACH and now_s - state.since_s > settings.waits_s
        if waiting and (state.phase is Phase.UNSEEN or (arrived and overdue)):
            return Phase.UNSEEN, False
        return Phase.REACH, False
    gap, covariance = gap_to_target(settings, state, now_s)
    std = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
    across = np.linalg.norm(gap - (gap @ settings.approach) * settings.approach)
    limit = 2 * settings.clear_m if state.inside else settings.clear_m - std
    inside = bool(across < limit)
    if inside and np.linalg.norm(gap) + settings.sigmas * std < settings.tolerance_m:
        return Phase.CLOSE, True
    return Phase.SERVO, inside


def _distance(settings: Settings, state: State, now_s: float) -> float:
    return float(np.linalg.norm(gap_to_target(settings, state, now_s)[0]))


def gap_to_target(settings: Settings, state: State, now_s: float) -> tuple[Array, Array]:
    """Return the way (3,) [m] from hand to object now, and its covariance (3, 3) [m^2].

    In the coordinates of the hand's encoders; the state must have a target.
    """
    assert state.target is not None
    target = predict(state.target, now_s, jerk_density=settings.jerk_density)
    covariance = uncertainty(settings, replace(state, target=target))
    return target.position - state.hand, covariance


def _send(settings: Settings, state: State, now_s: float) -> State:
    """Return the state with the command to the hand."""
    goal, velocity = settings.home, np.zeros(3)
    close = state.phase in (Phase.CLOSE, Phase.HELD)
    below = settings.standoff_m * settings.approach
    if state.target is not None and state.phase in (Phase.SERVO, Phase.CLOSE):
        target = predict(state.target, now_s, jerk_density=settings.jerk_density)
        goal = target.position if state.inside else target.position - below
        velocity = target.velocity
    elif state.phase in (Phase.CLOSE, Phase.HELD):
        goal = state.command.goal
    elif state.gaze.aim is not None and state.phase in (Phase.REACH, Phase.UNSEEN):
        aim = predict(state.gaze.aim, now_s, jerk_density=0.0)
        goal, velocity = aim.position - below, aim.velocity
    command = HandCommand(now_s, goal, velocity, close)
    return replace(state, command=command, cameras=_wanted(state))
