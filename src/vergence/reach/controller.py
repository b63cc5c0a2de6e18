"""Reach for the object that the eyes fixate, and close the hand on it (the paper's Fig. 12).

Pure functions: `step_reach` takes the state, a frame and the hand's reading, and returns the next
state, which holds the commands to the head and to the hand. The eyes are moved by `vergence.gaze`.

From a distance the hand moves to a standoff below the object, by the object's position in frame
body. There the eyes see the marker on the hand as well, and from then on the hand moves by the
difference between object and marker. Both are located by the same cameras at the same joint angles,
so that errors of the calibration, of the readings and of the arm's mounting are common to both, and
cancel the better the nearer they are. The fingers close when the object is within their tolerance
with sufficient confidence, which is decided from covariances alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.gaze.commands import EYE_READINGS, HeadDriver
from vergence.gaze.controller import step_gaze
from vergence.gaze.kalman import Track, fuse, predict
from vergence.gaze.observation import detect, posture_at_image
from vergence.gaze.seen_position import see_position
from vergence.gaze.state import GazePhase
from vergence.geometry.head import T_body_base
from vergence.geometry.se3 import transform
from vergence.reach.state import (
    HandCommand,
    HandDriver,
    HandReading,
    ReachPhase,
    ReachSettings,
    ReachState,
    target_covariance,
    with_reading,
)
from vergence.stereo.combination import locate_both
from vergence.vision.detector import Detection

_CLOSING = (ReachPhase.CLOSE, ReachPhase.HELD)
_ENGAGED = (ReachPhase.REACH, ReachPhase.UNSEEN, ReachPhase.SERVO)


def run_reach(
    head: HeadDriver,
    hand: HandDriver,
    settings: ReachSettings,
    state: ReachState,
    until_s: float,
    *,
    watch: Callable[[ReachState, Frame | None], None] = lambda state, frame: None,
) -> ReachState:
    """Run the control loop on a head and a hand until an object is held; return the last state.

    The loop ends at a time of the head's clock at the latest. `watch` is called with every state
    and the frame that led to it.
    """
    while head.now_s() < until_s and state.phase is not ReachPhase.HELD:
        frame = head.read(state.cameras)
        state = step_reach(settings, state, frame, hand.read(), head.now_s())
        head.command(state.gaze.command)
        hand.command(state.command)
        gaze = see_position(settings.gaze, state.gaze, frame)  # commands do not wait for it
        state = replace(state, gaze=gaze)
        watch(state, frame)
    return state


def step_reach(
    settings: ReachSettings,
    state: ReachState,
    frame: Frame | None,
    reading: HandReading,
    now_s: float,
) -> ReachState:
    """Return the next state: step the gaze, locate the hand, decide, command.

    Args:
        settings: of head and hand.
        state: the present one.
        frame: the latest; None, a repeated frame or an older one counts as no new frame.
        reading: of the hand, now.
        now_s: time from which the commands can take effect.

    Raises:
        VergenceError: the hand's reading is none; others are those of `step_gaze`.
    """
    before, gaze = state.gaze, step_gaze(settings.gaze, state.gaze, frame, now_s)
    state = replace(state, gaze=gaze, readings=with_reading(state.readings, reading))
    if frame is not None and gaze.frame_s > before.frame_s:
        state = _detect_marker(settings, state, frame)
        if frame.time_s >= before.landing_s:  # the eyes are at their set points
            state = _locate_target(settings, state, frame)
    if now_s - state.together_s > settings.unseen_s:
        state = replace(state, target=None, apart_m=np.inf, inside=False)
    phase, inside = _decide(settings, state, now_s)
    since = state.since_s if phase is state.phase else now_s
    state = replace(state, phase=phase, since_s=since, inside=inside)
    command = _command(settings, state, now_s)
    return replace(state, command=command, cameras=_cameras_to_request(settings, state))


def _detect_marker(settings: ReachSettings, state: ReachState, frame: Frame) -> ReachState:
    """Return the state with the marker's pixels in the requested images of a frame."""
    found = {
        name: detect(
            settings.gaze,
            settings.detect_marker,
            frame,
            name,
            _before(state, name),
            target="the hand's marker",
        )
        for name in frame.images
        if name in state.cameras
    }
    return replace(state, detections=found)


def _before(state: ReachState, camera: str) -> Array | None:
    """Return the marker's pixel (2,) in a camera's latest image; None: not found there."""
    found = state.detections.get(camera)
    return None if found is None else found.pixel


def _shows_marker(state: ReachState, cameras: tuple[str, ...]) -> bool:
    return all(state.detections.get(name) is not None for name in cameras)


def _cameras_to_request(settings: ReachSettings, state: ReachState) -> tuple[str, ...]:
    """Return the cameras whose images are needed next: for the gaze, and to find the hand."""
    if state.phase in (ReachPhase.SEEK, ReachPhase.TRACK):
        return state.gaze.cameras
    gaze = settings.gaze
    wanted = (*state.gaze.cameras, *gaze.narrow)
    if not _shows_marker(state, gaze.narrow):
        wanted += gaze.wide
    return tuple(name for name in gaze.cameras if name in wanted)


def _locate_target(settings: ReachSettings, state: ReachState, frame: Frame) -> ReachState:
    """Return the state with the target at a frame, if a pair of cameras shows object and marker."""
    for pair in dict.fromkeys((settings.gaze.narrow, settings.gaze.wide)):
        markers = [state.detections.get(name) for name in pair]
        if any(marker is None for marker in markers):
            continue
        objects = [_object(settings, state, frame, name) for name in pair]
        seen = [each for each in (*objects, *markers) if each is not None]
        if len(seen) == 4:
            return _fuse_target(settings, state, frame, (pair[0], pair[1]), seen)
    return state


def _object(
    settings: ReachSettings, state: ReachState, frame: Frame, camera: str
) -> Detection | None:
    """Return the object in an image; None: not found.

    Where the gaze has not searched for it, it is searched for around the marker, which is near it.
    """
    target = state.gaze.target
    if camera in state.gaze.detections or not isinstance(target, str):
        return state.gaze.detections.get(camera)
    detector, near = settings.gaze.objects[target], _before(state, camera)
    return detect(settings.gaze, detector, frame, camera, near, target=target)


def _fuse_target(
    settings: ReachSettings,
    state: ReachState,
    frame: Frame,
    cameras: tuple[str, str],
    seen: Sequence[Detection],
) -> ReachState:
    """Return the state after a measurement of the target, from one pair of images.

    The detections are those of the object, left and right, and of the marker, left and right.
    """
    calibration = settings.gaze.calibration
    posture = posture_at_image(settings.gaze, state.gaze, frame)
    pixels = np.array([each.pixel for each in seen]).reshape(2, 2, 1, 2)  # object or marker, eye
    stds = np.array([each.std_px for each in seen]).reshape(2, 2).max(axis=0)  # by eye
    objects, markers, covariances = locate_both(
        calibration,
        left=(pixels[0, 0], pixels[1, 0]),
        right=(pixels[0, 1], pixels[1, 1]),
        joints=posture[EYE_READINGS],
        pixel_std_px=np.repeat(stds, 2),
        joint_std_rad=settings.gaze.command_std_rad,
        cameras=cameras,
    )
    if not np.isfinite(covariances).all():
        return state
    T = T_body_base(calibration, "left", posture)
    object_body, marker_body = transform(T, objects[0]), transform(T, markers[0])
    marker_by_encoders = transform(_hand_at(state.readings, frame.time_s), settings.marker_hand)
    target = fuse(
        state.target,
        frame.time_s,
        marker_by_encoders + object_body - marker_body,
        T[:3, :3] @ covariances[0] @ T[:3, :3].T,
        motion=settings.motion,
    )
    return replace(
        state,
        target=target,
        apart_m=float(np.linalg.norm(object_body - marker_body)),
        together_s=frame.time_s,
    )


def _hand_at(readings: tuple[HandReading, ...], time_s: float) -> Array:
    """Return the hand's pose (4, 4) at a time: interpolated position, latest attitude."""
    T = readings[-1].T_body_hand.copy()
    times = [reading.time_s for reading in readings]
    for k in range(3):
        T[k, 3] = np.interp(time_s, times, [reading.T_body_hand[k, 3] for reading in readings])
    return T


def _decide(settings: ReachSettings, state: ReachState, now_s: float) -> tuple[ReachPhase, bool]:
    """Return the next phase, and whether the hand may leave the standoff for the object."""
    gap = np.full(3, np.inf)
    if state.target is not None:
        target = _predicted(settings, state.target, now_s)
        state, gap = replace(state, target=target), target.position - state.hand
    if state.phase is ReachPhase.CLOSE and not state.readings[-1].closed:
        return ReachPhase.CLOSE, True
    escaped = state.target is not None and np.linalg.norm(gap) >= settings.escaped_m
    if state.phase is ReachPhase.CLOSE or (state.phase is ReachPhase.HELD and not escaped):
        return ReachPhase.HELD, True
    approached = state.approached
    if approached is None or state.gaze.phase is GazePhase.LOST:
        return ReachPhase.SEEK, False
    distance = np.linalg.norm(approached.position - settings.shoulder)
    margin = settings.reach_margin_m if state.phase in _ENGAGED else 0.0
    if distance > settings.reach_m + margin:
        return ReachPhase.TRACK, False
    if state.target is None:
        arrived = np.linalg.norm(state.hand - state.command.goal) < settings.arrived_m
        overdue = state.phase is ReachPhase.REACH and now_s - state.since_s > settings.waits_s
        if state.phase is ReachPhase.UNSEEN or (arrived and overdue):
            return ReachPhase.UNSEEN, False
        return ReachPhase.REACH, False
    std = float(np.sqrt(np.linalg.eigvalsh(target_covariance(settings, state))[-1]))
    across = np.linalg.norm(gap - (gap @ settings.approach) * settings.approach)
    limit = 2 * settings.clear_m if state.inside else settings.clear_m - std
    inside = bool(across < limit)
    if inside and np.linalg.norm(gap) + settings.sigmas * std < settings.tolerance_m:
        return ReachPhase.CLOSE, True
    return ReachPhase.SERVO, inside


def _predicted(settings: ReachSettings, target: Track, now_s: float) -> Track:
    return predict(target, now_s, jerk_density=settings.motion.jerk_density)


def _command(settings: ReachSettings, state: ReachState, now_s: float) -> HandCommand:
    """Return the command to the hand."""
    goal, velocity = settings.home, np.zeros(3)
    below = settings.standoff_m * settings.approach
    if state.target is not None and state.phase in (ReachPhase.SERVO, ReachPhase.CLOSE):
        target = _predicted(settings, state.target, now_s)
        goal = target.position if state.inside else target.position - below
        velocity = target.velocity
    elif state.phase in _CLOSING:
        goal = state.command.goal
    elif state.approached is not None and state.phase in (ReachPhase.REACH, ReachPhase.UNSEEN):
        approached = predict(state.approached, now_s, jerk_density=0.0)
        goal, velocity = approached.position - below, approached.velocity
    return HandCommand(now_s, goal, velocity, close=state.phase in _CLOSING)
