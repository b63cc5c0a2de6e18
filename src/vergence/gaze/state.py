"""Settings and state of the gaze controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from vergence.arrays import Array
from vergence.gaze.commands import HeadCommand, JointLimits, hold
from vergence.gaze.kalman import InnovationRatio, MotionModel, Track
from vergence.geometry.head import HeadCalibration

NARROW, WIDE = ("left_narrow", "right_narrow"), ("left_wide", "right_wide")


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
    """The head and the parameters of its gaze controller."""

    calibration: HeadCalibration
    limits: JointLimits = field(default_factory=JointLimits)
    use_neck: bool = False
    """Whether the neck shares in a gaze shift."""
    pixel_std_px: float = 0.1
    """Standard deviation of the object's position in an image."""
    joint_std_rad: float = 1e-3
    """Standard deviation of a joint reading, with all errors that the two eyes do not share."""
    command_std_rad: float = 2e-4
    """Standard deviation of a joint angle about its set point."""
    motion: MotionModel = field(default_factory=MotionModel)
    """Of the object."""
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
    frame_s: float = -np.inf
    """Time stamp of the latest new frame."""
    seen_s: float = -np.inf
    """Time stamp of the latest frame in which an eye saw the object."""
    landing_s: float = -np.inf
    """Time at which the latest saccade is over; earlier images are not used."""
    pixels: Mapping[str, Array] = field(default_factory=dict)
    """(2,) pixel of the object by camera searched in the latest frame, NaN where not found."""
    measured: Array | None = None
    """(3,) [m] stereo estimate of the latest frame alone, in frame body."""
    track: Track | None = None
    """Estimate over time from joint readings, in frame body (frame head without a neck)."""
    aim: Track | None = None
    """Estimate over time from commands instead of readings, for control: without the readings'
    noise, which would make the eyes tremble, but subject to the errors of the joints' gains."""
    innovation_ratio: InnovationRatio = field(default_factory=InnovationRatio)
    """Of the measurements of `track`."""
    aim_innovation_ratio: InnovationRatio = field(default_factory=InnovationRatio)
    """Of the measurements of `aim`."""
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


def initial_gaze_state(settings: GazeSettings, posture: Array, time_s: float) -> GazeState:
    """Return the state of a head that rests at set points (7,) [rad] and has not seen anything."""
    command = hold(posture, settings.limits, time_s)
    return GazeState(GazePhase.LOST, time_s, (command,), (*WIDE, *NARROW))
