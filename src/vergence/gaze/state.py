"""What the gaze controller is told, and what it remembers and says of itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from vergence.arrays import Array
from vergence.gaze.commands import Command, Limits, stay
from vergence.gaze.kalman import Track
from vergence.gaze.scatter import Scatter
from vergence.geometry.head import HeadCalibration

NARROW, WIDE = ("left_narrow", "right_narrow"), ("left_wide", "right_wide")


class Phase(StrEnum):
    """What the gaze is doing."""

    SACCADE = "saccade"
    """Under way to where the object was seen; images on the way are not used."""
    PURSUIT = "pursuit"
    FIXATION = "fixation"
    LOST = "lost"
    """Not seen for a while: waiting where it went, then searching."""


@dataclass(frozen=True, eq=False)
class Settings:
    """The head and how to use it."""

    calibration: HeadCalibration
    limits: Limits = field(default_factory=Limits)
    use_neck: bool = False
    """Whether the neck shares in a gaze shift."""
    pixel_std_px: float = 0.1
    """Of the object's position in an image."""
    joint_std_rad: float = 1e-3
    """Of a joint reading, with all that the two eyes do not share."""
    sent_std_rad: float = 2e-4
    """Of a joint against where it was sent."""
    jerk_density: float = 1.0
    """Of the object [m^2/s^5]: an acceleration of 1 m/s^2 more or less in a second, with which what
    moves at 0.3 m/s turns round in 0.6 s. Less would lag behind such turns."""
    speed_std_m_s: float = 0.3
    """Of an object that is seen for the first time."""
    acceleration_std_m_s2: float = 1.0
    """Likewise."""
    saccade_rad: float = 0.12
    """Error from which a correction is a saccade: half the way to the edge of the fovea."""
    settle_s: float = 0.02
    """From the end of a saccade's set points until the eye stands."""
    moving_rad_s: float = 0.02
    """Angular speed from which an object is pursued, not fixated: a pixel of the fovea a frame."""
    lost_s: float = 0.2
    """Without a measurement until the object counts as lost."""
    search_s: float = 0.6
    """Lost, until a search begins: things reappear near where they went."""
    dwell_s: float = 0.3
    """At each place of a search, once the eyes stand there."""
    first_depth_m: float = 1.0
    """Assumed of what only one eye sees."""
    astray_rad: float = 0.1
    """Between the sight of one eye and the aim, from which the aim is given up."""
    outer: float = 0.6
    """Share of the narrow image beyond which the wide images are asked for too."""
    surprise_limit: float = 60.0
    """Squared distance at which a measurement begins a new track: 3 in the mean."""
    stuck_rad: float = 0.06
    """Difference between reading and command at which a resting joint counts as stuck; gains
    that are off by a tenth stay below."""
    comfort_rad: tuple[float, float] = (0.20, 0.04)
    """Mean eye angle at which the neck begins to follow, and at which it is content."""
    neck_gain_hz: float = 3.0
    """Neck speed per mean eye angle."""
    neck_speed_rad_s: float = 1.5
    neck_acceleration_rad_s2: float = 6.0


@dataclass(frozen=True, eq=False)
class State:
    """All that the controller remembers, and what it says of itself."""

    phase: Phase
    since_s: float
    """When the phase began."""
    commands: tuple[Command, ...]
    """The latest is in force; the others tell where the joints were sent at earlier frames."""
    cameras: tuple[str, ...]
    """Whose images it wants next."""
    frame_s: float = -np.inf
    """Time stamp of the latest frame that was new."""
    seen_s: float = -np.inf
    """Time stamp of the latest frame that showed the object to an eye."""
    landing_s: float = -np.inf
    """When the latest saccade is over: images from before are not used."""
    pixels: Mapping[str, Array] = field(default_factory=dict)
    """By camera that was searched in the latest frame: (2,) px, NaN where it was not found."""
    measured: Array | None = None
    """(3,) [m] in frame body: the stereo estimate of the latest frame alone."""
    measured_covariance: Array | None = None
    """(3, 3) of it."""
    track: Track | None = None
    """The estimate over time, in frame body (frame head, where the head has no neck)."""
    aim: Track | None = None
    """The same from commands instead of readings, for control: without the readings' noise, which
    would make the eyes tremble, but as wrong as the joints' gains."""
    scatter: Scatter = field(default_factory=Scatter)
    """Of the measurements by readings: the track weighs them by it."""
    aim_scatter: Scatter = field(default_factory=Scatter)
    """Of those by commands."""
    stuck: tuple[str, ...] = ()
    """Joints that do not follow."""
    searched: int = 0
    """Places that were looked to since it was lost."""
    neck_turning: bool = False
    neck_rate: Array = field(default_factory=lambda: np.zeros(3))

    @property
    def command(self) -> Command:
        """The command in force."""
        return self.commands[-1]


def start(settings: Settings, posture: Array, time_s: float) -> State:
    """Return the state of a head that rests at set points (7,) [rad] and has seen nothing."""
    command = stay(posture, settings.limits, time_s)
    return State(Phase.LOST, time_s, (command,), (*WIDE, *NARROW))
