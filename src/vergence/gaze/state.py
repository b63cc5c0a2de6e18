"""Settings and state of the gaze controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.gaze.commands import HeadCommand, JointLimits, hold
from vergence.gaze.kalman import InnovationRatio, MotionModel, Track
from vergence.gaze.roles import EyeCameras, check_roles, default_roles
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES, Side
from vergence.geometry.neck import NECK_JOINTS, check_named
from vergence.self_calibration.sequence import Geometry, SeenGeometry, initial_seen_geometry
from vergence.vision.detector import Detection, Detector, pixel_or_nan
from vergence.vision.sphere import sphere_detector


class GazePhase(StrEnum):
    """What the gaze is doing."""

    SACCADE = "saccade"
    """The eyes are on their way to where the object was seen; images on the way are not used."""
    PURSUIT = "pursuit"
    """The eyes follow a moving object."""
    FIXATION = "fixation"
    """The eyes rest on an object that does not move."""
    LOST = "lost"
    """The object has not been seen for a while: the eyes wait where it went, then search."""


@dataclass(frozen=True, eq=False)
class GazeSettings:
    """The head, what it looks at, and the parameters of its gaze controller.

    VergenceError where the head does not have what the settings ask for.
    """

    calibration: HeadCalibration
    objects: Mapping[str, Detector] = field(default_factory=lambda: {"sphere": sphere_detector()})
    """By name, what finds each object that can be looked at; the first one is looked at until
    `look_at` chooses otherwise."""
    roles: Mapping[Side, EyeCameras] | None = None
    """By eye, the cameras to use; None: `default_roles` of the calibration. An eye without an entry
    is not moved, and not used."""
    geometry: Geometry = "joints"
    """What tells how the eyes stand when the object is located: the joint readings, or these and
    the calibration as corrected by what both wide images show. Steering is the same, but for when
    an object counts as moving."""
    limits: JointLimits = field(default_factory=JointLimits)
    use_neck: bool = False
    """Whether the neck shares in a gaze shift."""
    joint_std_rad: float = 1e-3
    """Standard deviation of a joint reading, with all errors that the two eyes do not share."""
    servo_lag_s: float = 0.0
    """Time constant with which joints follow their set points; up to 3 ms it may be left at 0."""
    command_std_rad: float = 2e-4
    """Standard deviation of a joint angle about its set point."""
    motion: MotionModel = field(default_factory=MotionModel)
    """How the object is expected to move."""
    saccade_rad: float = 0.12
    """Error from which a correction is a saccade: half the way to the edge of the fovea."""
    settle_s: float = 0.02
    """Time from the end of a saccade's set points until the eye rests."""
    moving_rad_s: float = 0.02
    """Angular speed from which an object is pursued, not fixated: a pixel of the fovea a frame."""
    lost_s: float = 0.2
    """Time without a measurement after which the object counts as lost."""
    search_s: float = 0.6
    """Time from the loss to the search: objects reappear near where they went."""
    dwell_s: float = 0.3
    """Time at each direction of a search, once the eyes rest there."""
    initial_depth_m: float = 1.0
    """Assumed depth of an object that only one eye sees."""
    aim_gate_rad: float = 0.1
    """Angle between the ray of a single eye and the aim from which the aim is given up."""
    central_share: float = 0.6
    """Central part of the narrow images, as a share of width and height, within which they alone
    are requested; an object beyond it makes the controller request the wide images too."""
    stuck_rad: float = 0.06
    """Difference between reading and command from which a resting joint counts as stuck; gains
    that are wrong by a tenth cause less."""
    comfort_rad: tuple[float, float] = (0.20, 0.04)
    """Hysteresis of the neck: mean eye angles at which it begins and stops to follow."""
    neck_gain_hz: float = 3.0
    """Neck speed per mean eye angle."""
    neck_speed_rad_s: float = 1.5
    """Greatest speed of a neck joint."""
    neck_acceleration_rad_s2: float = 6.0
    """Greatest acceleration of a neck joint."""

    def __post_init__(self) -> None:
        if self.roles is not None:
            check_roles(self.calibration, self.roles)
        if not self.objects:
            raise VergenceError(
                "There is no object to look at: `objects` needs a detector by name."
            )
        for name, detect in self.objects.items():
            if not callable(detect):
                raise VergenceError(
                    f"The detector of {name!r} must be a function of image, camera and pixel, "
                    f"found {type(detect).__name__}."
                )
        if self.limits.joints != self.joints:
            raise VergenceError(
                f"The limits are those of {', '.join(self.limits.joints)}, but the joints of this "
                f"head are {', '.join(self.joints)}: give `joint_limits(..., joints=...)`."
            )
        if not 0 <= self.servo_lag_s < np.inf:
            raise VergenceError(
                f"servo_lag_s is a time of 0 s or more, found {self.servo_lag_s:g} s."
            )
        if self.geometry not in get_args(Geometry):
            raise VergenceError(
                f"The geometry is {' or '.join(map(repr, get_args(Geometry)))}, found "
                f"{self.geometry!r}."
            )
        if self.geometry == "seen" and len(self.eyes) < len(EYES):
            raise VergenceError(
                f"A geometry that both eyes see needs both; the gaze uses the "
                f"{', '.join(self.eyes)} eye only."
            )
        check_named(self.calibration.neck)
        if self.use_neck and not self.calibration.neck.names:
            raise VergenceError(
                "A neck that shares in gaze shifts has one or more of the joints "
                f"{', '.join(NECK_JOINTS)}, and the calibration must describe them; it has 0 neck "
                "joints."
            )

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints of a posture: the neck's, then the readings of the eyes."""
        return (*NECK_JOINTS, *self.calibration.kinematics.readings)

    @cached_property
    def eyes(self) -> Mapping[Side, EyeCameras]:
        """The cameras by eye and role, for the eyes that are used."""
        roles = default_roles(self.calibration) if self.roles is None else self.roles
        return {eye: roles[eye] for eye in EYES if eye in roles}

    @cached_property
    def wide(self) -> tuple[str, ...]:
        """Names of the cameras that look around, one of each eye."""
        return tuple(cameras.wide for cameras in self.eyes.values())

    @cached_property
    def narrow(self) -> tuple[str, ...]:
        """Names of the cameras in which the object is to be centred, one of each eye."""
        return tuple(cameras.narrow for cameras in self.eyes.values())

    @cached_property
    def cameras(self) -> tuple[str, ...]:
        """Names of all cameras that are used, each once: the wide ones, then the narrow ones."""
        return tuple(dict.fromkeys((*self.wide, *self.narrow)))


@dataclass(frozen=True, eq=False)
class GazeState:
    """All that the controller remembers and reports."""

    phase: GazePhase
    since_s: float
    """Time at which the phase began."""
    commands: tuple[HeadCommand, ...]
    """The latest is in force; the others give the set points at the times of earlier frames."""
    cameras: tuple[str, ...]
    """Cameras whose images are requested next."""
    target: str | Array
    """What is looked at: the name of an object, or a point (3,) [m] in frame body."""
    frame_s: float = -np.inf
    """Time stamp of the latest new frame."""
    seen_s: float = -np.inf
    """Time stamp of the latest frame in which an eye saw the object."""
    landing_s: float = -np.inf
    """Time at which the latest saccade is over; earlier images are not used."""
    detections: Mapping[str, Detection | None] = field(default_factory=dict)
    """The object by camera searched in the latest frame; None: not found."""
    measured: Array | None = None
    """(3,) [m] stereo estimate of the latest frame alone, in frame body."""
    by_joints: Array | None = None
    """(3,) [m] the same by the joint readings, where the geometry is seen; None: no estimate."""
    track: Track | None = None
    """Estimate over time from joint readings, corrected where the geometry is seen; in frame body
    (frame head without a neck)."""
    aim: Track | None = None
    """Estimate over time from commands instead of readings, for control: without the readings'
    noise, which would make the eyes tremble, but subject to the errors of the joints' gains."""
    innovation_ratio: InnovationRatio = field(default_factory=InnovationRatio)
    """Observed over stated variance of the measurements of `track`."""
    aim_innovation_ratio: InnovationRatio = field(default_factory=InnovationRatio)
    """Observed over stated variance of the measurements of `aim`."""
    geometry: SeenGeometry | None = None
    """By what both eyes see, after the latest frame; None: `geometry` of the settings is joints."""
    stuck: tuple[str, ...] = ()
    """Names of the joints that do not follow their commands."""
    searched: int = 0
    """Number of directions searched since the object was lost."""
    neck_turning: bool = False
    """Whether the neck is following the eyes."""
    neck_rate: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) velocity of the neck's set points [rad/s]."""

    @property
    def command(self) -> HeadCommand:
        """The command in force."""
        return self.commands[-1]

    @property
    def pixels(self) -> Mapping[str, Array]:
        """(2,) pixel of the object by camera searched in the latest frame, NaN: not found."""
        return {name: pixel_or_nan(found) for name, found in self.detections.items()}


def initial_gaze_state(
    settings: GazeSettings,
    posture: ArrayLike,
    time_s: float,
    *,
    geometry: SeenGeometry | None = None,
) -> GazeState:
    """Return the state of a head that rests at set points (j,) [rad] and has not seen anything.

    It will look at the first object of the settings; see `look_at`. A geometry is what an earlier
    run has learned, where the settings ask for the geometry that is seen; None: nothing.
    VergenceError if the posture is not one of this head, or not finite.
    """
    command = hold(posture, settings.limits, time_s)
    target = next(iter(settings.objects))
    if settings.geometry == "seen" and geometry is None:
        left, right = settings.wide
        geometry = initial_seen_geometry(settings.calibration, cameras=(left, right))
    return GazeState(
        GazePhase.LOST,
        time_s,
        (command,),
        settings.cameras,
        target,
        geometry=geometry if settings.geometry == "seen" else None,
    )


def look_at(settings: GazeSettings, state: GazeState, target: str | ArrayLike) -> GazeState:
    """Return the state that looks at another object, or at a point, from the next step on.

    A point is looked at by the calibration and the joints' set points alone: images do not matter,
    and nothing is searched for. What was estimated of the object before is forgotten.

    Args:
        settings: with the objects that can be looked at.
        state: the present one.
        target: the name of an object, or a point (3,) [m] in frame body.

    Raises:
        VergenceError: there is no object of this name, or the point is not three finite numbers, or
            is the origin of frame body.
    """
    if isinstance(target, str):
        if target not in settings.objects:
            known = ", ".join(settings.objects)
            raise VergenceError(f"No object is called {target!r}; the settings have: {known}.")
    else:
        target = np.array(target, float)
        if target.shape != (3,) or not (np.isfinite(target).all() and target.any()):
            raise VergenceError(
                "A point to look at has three finite coordinates [m] in frame body, and is not its "
                f"origin; found {target.tolist()}."
            )
    return replace(
        state,
        target=target,
        cameras=settings.cameras,
        detections={},
        measured=None,
        track=None,
        aim=None,
        innovation_ratio=InnovationRatio(),
        aim_innovation_ratio=InnovationRatio(),
    )
