"""Reach for the object that the eyes fixate, and close the hand on it (the paper's Fig. 12).

`step_reach` is a pure function of settings, state, frame, hand reading and time. It steps the gaze
controller, too.

From a distance the hand moves to a standoff below the object. There the eyes see the marker on the
hand, and from then on the hand moves by the difference between object and marker. Errors of the
calibration, the readings and the arm's mounting are common to both, and cancel as the two approach
each other. The fingers close when the covariances make sure that the object is between them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.errors import VergenceError
from vergence.gaze.commands import HeadDriver
from vergence.gaze.controller import step_gaze
from vergence.gaze.hand import HandCommand, HandDriver, HandReading, append_reading, hand_at
from vergence.gaze.kalman import MotionModel, Track, fuse, predict
from vergence.gaze.observation import detect, posture_at_image, update_track
from vergence.gaze.state import GazePhase, GazeSettings, GazeState, initial_gaze_state
from vergence.geometry.head import base_pose_in_body, without_accuracy
from vergence.geometry.se3 import transform
from vergence.self_calibration.calibrator import VisualGeometry
from vergence.stereo.uncertainty import combination
from vergence.vision.detector import Detection, Detector
from vergence.vision.sphere import sphere_detector


class ReachPhase(StrEnum):
    """What the hand is doing."""

    SEEK = "seek"
    """The eyes do not see the object; the hand waits at home, outside the images."""
    TRACK = "track"
    """The eyes follow the object, which is out of reach; the hand waits at home."""
    REACH = "reach"
    """The hand moves to a standoff below the object, and waits there until its marker is seen."""
    SERVO = "servo"
    """The eyes see object and marker, and the hand moves by the difference between them."""
    CLOSE = "close"
    """The object is between the fingers with sufficient confidence; the fingers close."""
    HELD = "held"
    """The fingers are closed, and the eyes do not see the object elsewhere."""


@dataclass(frozen=True, eq=False)
class ReachSettings:
    """The head, the hand, and the parameters of the reach controller.

    Raises VergenceError if the gaze uses one eye only.
    """

    gaze: GazeSettings
    detect_marker: Detector = field(default_factory=lambda: sphere_detector("blue"))
    """Detector of the marker on the hand; the default is that of this project's model."""
    marker_hand: Array = field(default_factory=lambda: np.array([-0.026, 0.0, -0.052]))
    """(3,) centre of the marker in frame hand [m]; the default is that of this project's model."""
    home: Array = field(default_factory=lambda: np.array([0.25, -0.25, -0.10]))
    """(3,) where the hand waits, by its encoders [m]: below the field of view."""
    shoulder: Array = field(default_factory=lambda: np.array([-0.02, -0.16, -0.08]))
    """(3,) centre of the arm's workspace [m]."""
    reach_m: float = 0.85
    """Radius of the arm's workspace."""
    reach_margin_m: float = 0.03
    """Hysteresis of that radius for a hand that is on its way."""
    approach: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    """(3,) unit vector along which the hand approaches: from below, clear of the lines of sight."""
    standoff_m: float = 0.12
    """Distance from the object at which the hand waits until its marker is seen: more than the
    errors of arm and calibration together."""
    clearance_m: float = 0.012
    """Clearance across the approach: slightly less than open fingers leave around an object."""
    tolerance_m: float = 0.010
    """Distance of the object from the grasp's centre within which the fingers close on it."""
    sigmas: float = 2.5
    """Standard deviations that must lie within the tolerance for the hand to close: 99 %."""
    relative_error: float = 0.03
    """Systematic error of the measured difference between object and marker, as a share of their
    distance, from the calibration and the attitude of the hand."""
    motion: MotionModel = field(default_factory=lambda: MotionModel(jerk_density=0.04))
    """Motion of an object that a person holds out: its acceleration changes by 0.2 m/s^2 in 1 s."""
    lost_s: float = 0.3
    """Time without a measurement of the target after which it is lost."""
    escaped_m: float = 0.03
    """Distance of an object from the closed hand above which it is not held."""

    def __post_init__(self) -> None:
        if len(self.gaze.eyes) < 2:
            raise VergenceError(
                f"Reaching needs depth, and so a camera in each eye; the gaze uses the "
                f"{', '.join(self.gaze.eyes)} eye only."
            )


@dataclass(frozen=True, eq=False)
class ReachState:
    """All that the reach controller remembers and reports."""

    phase: ReachPhase
    since_s: float
    """Time at which the phase began."""
    gaze: GazeState
    """State of the gaze controller."""
    command: HandCommand
    """The command in force."""
    readings: tuple[HandReading, ...]
    """The latest readings of the hand, the newest last."""
    cameras: tuple[str, ...]
    """Cameras whose images are requested next."""
    detections: Mapping[str, Detection | None] = field(default_factory=dict)
    """The marker by camera searched in the latest frame; None: not found."""
    target: Track | None = None
    """Object in the coordinates of the hand's encoders: the measured difference between object and
    marker, added to the marker by the encoders. None: not measured lately."""
    separation_m: float = np.inf
    """Distance from object to marker at the latest measurement of the target."""
    aligned: bool = False
    """Whether the hand may leave the standoff for the object."""

    @property
    def object(self) -> Array | None:
        """(3,) [m] object in frame body by the eyes, estimated over time."""
        return None if self.gaze.track is None else self.gaze.track.position

    @property
    def approach_track(self) -> Track | None:
        """The object's track by which the hand approaches before its marker is seen.

        The noise of readings would shake the hand.
        """
        seen = self.gaze.geometry is not None and self.gaze.track is not None
        return self.gaze.track if seen else self.gaze.aim

    @property
    def hand(self) -> Array:
        """(3,) [m] hand in frame body by its encoders."""
        return self.readings[-1].T_body_hand[:3, 3]


def initial_reach_state(
    settings: ReachSettings,
    posture: Array,
    reading: HandReading,
    time_s: float,
    *,
    geometry: VisualGeometry | None = None,
) -> ReachState:
    """Start at rest with the head at set points (j,) [rad]; see `initial_gaze_state`."""
    gaze = initial_gaze_state(settings.gaze, posture, time_s, geometry=geometry)
    readings = append_reading((), reading)
    rest = HandCommand(time_s, readings[-1].T_body_hand[:3, 3], np.zeros(3))
    return ReachState(ReachPhase.SEEK, time_s, gaze, rest, readings, gaze.cameras)


def run_reach(
    head: HeadDriver,
    hand: HandDriver,
    settings: ReachSettings,
    state: ReachState,
    until_s: float,
    *,
    watch: Callable[[ReachState, Frame | None], None] = lambda state, frame: None,
) -> ReachState:
    """Run the control loop until an object is held or a time; `watch` gets each state and frame."""
    while head.now_s() < until_s and state.phase is not ReachPhase.HELD:
        frame = head.read(state.cameras)
        state = step_reach(settings, state, frame, hand.read(), head.now_s())
        head.command(state.gaze.command)
        hand.command(state.command)
        state = replace(state, gaze=update_track(settings.gaze, state.gaze, frame))
        watch(state, frame)
    return state


def step_reach(
    settings: ReachSettings,
    state: ReachState,
    frame: Frame | None,
    reading: HandReading,
    now_s: float,
) -> ReachState:
    """Run one step of the reach controller: step the gaze, locate the hand, decide, command.

    See `step_gaze` for frame and time. Raises VergenceError for an invalid reading or frame.
    """
    before, gaze = state.gaze, step_gaze(settings.gaze, state.gaze, frame, now_s)
    state = replace(state, gaze=gaze, readings=append_reading(state.readings, reading))
    if frame is not None and gaze.frame_s > before.frame_s:
        state = _detect_marker(settings, state, frame)
        if frame.time_s >= before.landing_s:  # the eyes are at their set points
            state = _measure_target(settings, state, frame)
    target = None
    if state.target is not None and now_s - state.target.time_s <= settings.lost_s:
        target = predict(state.target, now_s, jerk_density=settings.motion.jerk_density)
    else:
        state = replace(state, target=None, separation_m=np.inf, aligned=False)
    phase, aligned = _decide(settings, state, target)
    since_s = state.since_s if phase is state.phase else now_s
    state = replace(state, phase=phase, since_s=since_s, aligned=aligned)
    command = _command(settings, state, target, now_s)
    return replace(state, command=command, cameras=_cameras_to_request(settings, state))


def _detect_marker(settings: ReachSettings, state: ReachState, frame: Frame) -> ReachState:
    """Detect the marker in the requested images of a frame."""
    gaze, detector, earlier = settings.gaze, settings.detect_marker, state.detections
    found = {
        name: detect(gaze, detector, frame, name, earlier, target="the hand's marker")
        for name in frame.images
        if name in state.cameras
    }
    return replace(state, detections=found)


def _cameras_to_request(settings: ReachSettings, state: ReachState) -> tuple[str, ...]:
    """Select the cameras that the gaze needs next, and those that find the marker."""
    if state.phase in (ReachPhase.SEEK, ReachPhase.TRACK):
        return state.gaze.cameras
    gaze = settings.gaze
    wanted = (*state.gaze.cameras, *gaze.narrow)
    if any(state.detections.get(name) is None for name in gaze.narrow):
        wanted += gaze.wide
    return tuple(name for name in gaze.cameras if name in wanted)


def _measure_target(settings: ReachSettings, state: ReachState, frame: Frame) -> ReachState:
    """Update the target if a pair of cameras shows object and marker, the narrow pair first."""
    calibration = settings.gaze.calibration
    for cameras in dict.fromkeys((settings.gaze.narrow, settings.gaze.wide)):
        markers = [state.detections.get(name) for name in cameras]
        if any(marker is None for marker in markers):
            continue
        objects = [_detect_near_marker(settings, state, frame, name) for name in cameras]
        found = [each for each in (*objects, *markers) if each is not None]
        if len(found) < 4:
            continue
        pixels = np.array([each.pixel for each in found]).reshape(2, 2, 2)  # object, marker; eye
        stds = np.array([each.std_px for each in found]).reshape(2, 2).max(axis=0)  # by eye
        posture = posture_at_image(settings.gaze, state.gaze, frame)
        # Both at the same readings: their noise is in both, and cancels as far as they are near.
        difference, covariance = combination(
            without_accuracy(calibration),
            weights=np.array([1.0, -1.0]),
            left=pixels[:, 0],
            right=pixels[:, 1],
            joints=posture[settings.gaze.readings],
            pixel_std_px=np.repeat(stds, 2),
            reading_std=settings.gaze.command_std_rad,
            cameras=(cameras[0], cameras[1]),
        )
        if not np.isfinite(covariance).all():
            return state
        T = base_pose_in_body(calibration, "left", posture)
        difference = T[:3, :3] @ difference
        marker = transform(hand_at(state.readings, frame.time_s), settings.marker_hand)
        covariance = T[:3, :3] @ covariance @ T[:3, :3].T
        target = fuse(
            state.target, frame.time_s, marker + difference, covariance, motion=settings.motion
        )
        return replace(state, target=target, separation_m=float(np.linalg.norm(difference)))
    return state


def _detect_near_marker(
    settings: ReachSettings, state: ReachState, frame: Frame, camera: str
) -> Detection | None:
    """Detect the object around the marker in an image that the gaze has not searched."""
    target = state.gaze.target
    if camera in state.gaze.detections or not isinstance(target, str):
        return state.gaze.detections.get(camera)
    detector = settings.gaze.objects[target]
    return detect(settings.gaze, detector, frame, camera, state.detections, target=target)


def target_std_m(settings: ReachSettings, state: ReachState, target: Track) -> float:
    """Compute the target's largest standard deviation [m], with the systematic error."""
    variance = np.linalg.eigvalsh(target.covariance[:3, :3])[-1]
    return float(np.hypot(np.sqrt(variance), settings.relative_error * state.separation_m))


def _decide(
    settings: ReachSettings, state: ReachState, target: Track | None
) -> tuple[ReachPhase, bool]:
    """Choose the next phase, and whether the hand may leave the standoff for the object."""
    gap = np.zeros(3) if target is None else target.position - state.hand
    if state.phase is ReachPhase.CLOSE:
        return (ReachPhase.HELD if state.readings[-1].closed else ReachPhase.CLOSE), True
    if state.phase is ReachPhase.HELD and np.linalg.norm(gap) < settings.escaped_m:
        return ReachPhase.HELD, True
    approach_track = state.approach_track
    if approach_track is None or state.gaze.phase is GazePhase.LOST:
        return ReachPhase.SEEK, False
    on_the_way = state.phase in (ReachPhase.REACH, ReachPhase.SERVO)
    limit_m = settings.reach_m + (settings.reach_margin_m if on_the_way else 0.0)
    if np.linalg.norm(approach_track.position - settings.shoulder) > limit_m:
        return ReachPhase.TRACK, False
    if target is None:
        return ReachPhase.REACH, False
    std_m = target_std_m(settings, state, target)
    across_m = np.linalg.norm(gap - (gap @ settings.approach) * settings.approach)
    clearance_m = settings.clearance_m
    aligned = bool(across_m < (2 * clearance_m if state.aligned else clearance_m - std_m))
    if aligned and np.linalg.norm(gap) + settings.sigmas * std_m < settings.tolerance_m:
        return ReachPhase.CLOSE, True
    return ReachPhase.SERVO, aligned


def _command(
    settings: ReachSettings, state: ReachState, target: Track | None, now_s: float
) -> HandCommand:
    """Command the hand: to the target, to the standoff below the object, or home."""
    goal, velocity = settings.home, np.zeros(3)
    below = settings.standoff_m * settings.approach
    closes = state.phase in (ReachPhase.CLOSE, ReachPhase.HELD)
    if target is not None and state.phase in (ReachPhase.SERVO, ReachPhase.CLOSE):
        goal = target.position if state.aligned else target.position - below
        velocity = target.velocity
    elif closes:
        goal = state.command.goal
    elif state.approach_track is not None and state.phase is ReachPhase.REACH:
        approached = predict(state.approach_track, now_s, jerk_density=0.0)
        goal, velocity = approached.position - below, approached.velocity
    return HandCommand(now_s, goal, velocity, close=closes)
