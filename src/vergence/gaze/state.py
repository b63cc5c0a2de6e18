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
from vergence.gaze.commands import HeadCommand, JointLimits, hold, posture_joints, usual_limits
from vergence.gaze.kalman import MotionModel, Track
from vergence.geometry.head import (
    HeadCalibration,
    cameras_of,
    lenses_of,
    main_camera,
    narrow_camera,
)
from vergence.geometry.kinematics import EYES, Side, check_moves
from vergence.self_calibration.calibrator import Geometry, VisualGeometry, initial_visual_geometry
from vergence.vision.detector import Detection, Detector, pixel_or_nan
from vergence.vision.sphere import sphere_detector


class GazePhase(StrEnum):
    """What the eyes are doing."""

    SACCADE = "saccade"
    """They turn to the object ballistically; images taken on the way are not used."""
    PURSUIT = "pursuit"
    """They follow a moving object."""
    FIXATION = "fixation"
    """They rest on an object that does not move."""
    LOST = "lost"
    """No image has shown the object for a while: the eyes wait where it went, then search."""


@dataclass(frozen=True)
class EyeCameras:
    """The cameras of one eye by role; an eye with one camera has it in both roles."""

    wide: str
    """Name of the camera in which an object is searched for."""
    narrow: str
    """Name of the camera that is turned until the object is at its principal point."""


def default_roles(calibration: HeadCalibration) -> dict[Side, EyeCameras]:
    """Assign roles to a head's cameras, for each eye that has a camera.

    The wide role goes to the eye's main camera, the narrow role to the one that sees least.
    """
    roles: dict[Side, EyeCameras] = {}
    for eye in EYES:
        if lenses := lenses_of(calibration, eye):
            roles[eye] = EyeCameras(wide=main_camera(lenses), narrow=narrow_camera(lenses))
    return roles


@dataclass(frozen=True, eq=False)
class GazeSettings:
    """The head, what it looks at, and the parameters of its gaze controller.

    Raises VergenceError if the head lacks what the settings ask for.
    """

    calibration: HeadCalibration
    objects: Mapping[str, Detector] = field(default_factory=lambda: {"sphere": sphere_detector()})
    """Detectors of the objects to look at, by name. The first is the target until `look_at` sets
    another one."""
    roles: Mapping[Side, EyeCameras] | None = None
    """Cameras to use, by eye; None: `default_roles`. An eye without an entry does not move."""
    geometry: Geometry = "joints"
    """How the object is located: from the joint readings, or from a head geometry that is corrected
    by what both wide images show."""
    limits: JointLimits = None  # type: ignore[assignment]
    """Ranges and speeds of the joints; None: `usual_limits`."""
    use_neck: bool = False
    """Whether the neck takes part in gaze shifts."""
    reading_std: float = 1e-3
    """Standard deviation of a joint reading, with all errors that the eyes do not share."""
    servo_lag_s: float = 0.0
    """Time constant with which joints follow their set points; below 3 ms, 0 is good enough."""
    command_std_rad: float = 2e-4
    """Standard deviation of a joint angle about its set point."""
    motion: MotionModel = field(default_factory=MotionModel)
    """Motion model of the object."""
    saccade_rad: float = 0.12
    """Error above which a correction is a saccade: half the way to the edge of the fovea."""
    settle_s: float = 0.02
    """Time from the end of a saccade's set points until the eye rests."""
    moving_rad_s: float = 0.02
    """Angular speed above which an object is pursued: one pixel of the fovea a frame."""
    lost_s: float = 0.2
    """Time without a measurement after which the object is lost."""
    search_s: float = 0.6
    """Time from the loss to the search: objects reappear near where they went."""
    dwell_s: float = 0.3
    """Time at each direction of a search, once the eyes rest there."""
    initial_depth_m: float = 1.0
    """Assumed depth of an object that one eye sees."""
    aim_gate_rad: float = 0.1
    """Angle between the ray of one eye and the aim above which the aim is reset."""
    stuck_rad: float = 0.06
    """Difference between reading and command above which a resting joint is stuck. A gain error of
    a tenth causes less."""
    comfort_rad: tuple[float, float] = (0.20, 0.04)
    """Hysteresis of the neck: mean eye angles at which it starts and stops to follow."""
    neck_gain_hz: float = 3.0
    """Neck speed per mean eye angle."""
    neck_speed_rad_s: float = 1.5
    """Maximum speed of a neck joint."""
    neck_acceleration_rad_s2: float = 6.0
    """Maximum acceleration of a neck joint."""

    def __post_init__(self) -> None:
        check_moves(self.calibration.kinematics, "Gaze control")
        if self.limits is None:
            object.__setattr__(self, "limits", usual_limits(self.calibration))
        for eye, cameras in (self.roles or {}).items():
            there = cameras_of(self.calibration, eye)
            if not {cameras.wide, cameras.narrow} <= set(there):
                raise VergenceError(
                    f"The {eye} eye has {', '.join(there) or 'no camera'}; found the roles wide: "
                    f"{cameras.wide!r}, narrow: {cameras.narrow!r}."
                )
        if not self.eyes:
            raise VergenceError(f"Give `roles` for one or both of {', '.join(EYES)}; found none.")
        if not self.objects:
            raise VergenceError("`objects` needs a detector by name, found no object to look at.")
        if self.limits.joints != self.joints:
            raise VergenceError(
                f"The limits are those of {', '.join(self.limits.joints)}, but the joints of this "
                f"head are {', '.join(self.joints)}: give `joint_limits(..., joints=...)`."
            )
        if self.geometry not in get_args(Geometry):
            known = " or ".join(map(repr, get_args(Geometry)))
            raise VergenceError(f"The geometry is {known}, found {self.geometry!r}.")
        if self.geometry == "seen" and len(self.eyes) < len(EYES):
            raise VergenceError(
                f"Geometry {self.geometry!r} needs images of both eyes; the gaze uses the "
                f"{', '.join(self.eyes)} eye only."
            )
        if self.use_neck and not self.calibration.neck.names:
            raise VergenceError(
                "use_neck needs a calibration with a neck; this one has 0 neck joints."
            )

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints of a posture: the neck's, then the readings of the eyes."""
        return posture_joints(self.calibration)

    @property
    def neck(self) -> slice:
        """Columns of the neck in a posture (..., j)."""
        return slice(0, len(self.calibration.neck.axes))

    @property
    def readings(self) -> slice:
        """Columns of the eyes' readings in a posture (..., j)."""
        return slice(len(self.calibration.neck.axes), None)

    @cached_property
    def eyes(self) -> Mapping[Side, EyeCameras]:
        """The cameras by eye and role, for the eyes that are used."""
        roles = default_roles(self.calibration) if self.roles is None else self.roles
        return {eye: roles[eye] for eye in EYES if eye in roles}

    @cached_property
    def wide(self) -> tuple[str, ...]:
        """Names of the cameras that search, one of each eye."""
        return tuple(cameras.wide for cameras in self.eyes.values())

    @cached_property
    def narrow(self) -> tuple[str, ...]:
        """Names of the cameras in which the object is centred, one of each eye."""
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
    """Time stamp of the latest frame that shows the object."""
    landing_s: float = -np.inf
    """Time at which the latest saccade ends; earlier images are not used."""
    detections: Mapping[str, Detection | None] = field(default_factory=dict)
    """The object by camera searched in the latest frame; None: not found."""
    measured: Array | None = None
    """(3,) [m] stereo estimate from the latest frame alone, in frame body."""
    track: Track | None = None
    """Estimate over time from joint readings or the seen geometry, in frame body, to report."""
    aim: Track | None = None
    """Estimate over time from commands, for control: without the noise of readings."""
    geometry: VisualGeometry | None = None
    """Head geometry after the latest frame, if the settings' geometry is "seen"."""
    stuck: tuple[str, ...] = ()
    """Names of the joints that do not follow their commands."""
    searched: int = 0
    """Number of directions searched since the object was lost."""
    neck_rate: Array = field(default_factory=lambda: np.empty(0))
    """(n,) velocity of the neck's set points [rad/s]."""

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
    geometry: VisualGeometry | None = None,
) -> GazeState:
    """Start at rest at set points (j,) [rad], with the first object of the settings as target.

    `geometry` is what an earlier run has learned; it is used if the settings' geometry is "seen".
    """
    if settings.geometry != "seen":
        geometry = None
    elif geometry is None:
        left, right = settings.wide
        geometry = initial_visual_geometry(settings.calibration, cameras=(left, right))
    return GazeState(
        GazePhase.LOST,
        time_s,
        (hold(posture, settings.limits, time_s),),
        settings.cameras,
        next(iter(settings.objects)),
        geometry=geometry,
        neck_rate=np.zeros(len(settings.calibration.neck.axes)),
    )


def look_at(settings: GazeSettings, state: GazeState, target: str | ArrayLike) -> GazeState:
    """Set another target from the next step on, and discard the estimates of the previous one.

    The target is the name of an object, or a point (3,) [m] in frame body, or VergenceError.
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
    )
