"""Fixate an object with a head that is there, and sum up what its cameras show of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.errors import VergenceError
from vergence.gaze.commands import HeadCommand, JointLimits
from vergence.gaze.controller import run_gaze
from vergence.gaze.foveation import best_pixels
from vergence.gaze.state import GazeSettings, GazeState, initial_gaze_state
from vergence.geometry.head import HeadCalibration, base_pose
from vergence.geometry.neck import Neck
from vergence.geometry.se3 import inverse, transform
from vergence.live.driver import Driver
from vergence.progress import Progress, silent
from vergence.self_calibration.calibrator import Geometry

SETTLE_S, LOST_S = 0.25, 0.5
"""Times for which images do not count after a motion, since lag of servos and latency of cameras
are unknown, and after which an object is lost, since USB cameras pause [s]."""
SETTLED_PX = 8.0
"""Distance below which the object is centred [px], as on the twin."""


Watch = Callable[[GazeState, Frame | None], None]
"""A function that gets each state and its frame, such as `viewer.gaze.watch_gaze` makes."""


@dataclass(frozen=True)
class Fixation:
    """What the cameras show of an object."""

    seconds: float
    """Length of the run."""
    found_s: float
    """Time in which an image showed the object."""
    final_px: dict[str, float]
    """By narrow or only camera: its last distance, as detected, from where it should be. NaN: not
    shown at the end."""
    settled_s: float | None
    """Time from its first image until all these stay within SETTLED_PX; None: they do not."""
    position_m: list[float] | None
    """Where it is in frame head; None: no two eyes showed it."""


class _EyesOnly:
    """A driver whose neck, if it has one, keeps its angles; calibration does not find necks."""

    def __init__(self, driver: Driver, limits: JointLimits, neck: Array):
        self._driver, self._limits, self._neck = driver, limits, neck
        self.now_s, self.read = driver.now_s, driver.read

    def command(self, command: HeadCommand) -> None:
        start, goal = np.append(self._neck, command.start), np.append(self._neck, command.goal)
        rate = np.append(0 * self._neck, command.rate)
        self._driver.command(HeadCommand(command.time_s, start, goal, rate, self._limits))


def fixate(
    driver: Driver,
    head: HeadCalibration,
    watched: Callable[[GazeSettings], Watch] = lambda settings: lambda state, frame: None,
    *,
    seconds: float,
    geometry: Geometry = "joints",
    progress: Progress = silent,
) -> Fixation:
    """Turn the eyes of a driver to the object that the gaze finds, and keep them on it.

    `watched` makes the function that gets each state and its frame, of the settings.
    VergenceError if calibration and driver are of different heads, or the object is never found.
    """
    about, limits = driver.description, driver.limits
    cameras = {name: (c.eye, c.width, c.height) for name, c in about.cameras.items()}
    wanted = {name: (c.eye, *c.intrinsics.size) for name, c in head.cameras.items()}
    joints, of_head = about.head_kinematics.readings, head.kinematics.readings
    if limits is None or not wanted.items() <= cameras.items() or joints != of_head:
        raise VergenceError(
            f"The calibration is of the cameras {wanted} and the readings {of_head}, the driver "
            f"has {cameras} and {joints}, with {'no' if limits is None else 'its'} limits; "
            "calibrate a recording of this driver."
        )
    head, eyes = replace(head, neck=Neck()), slice(len(about.neck_joints), None)
    of_eyes = JointLimits(limits.range_rad[eyes], limits.speed_rad_s[eyes], limits.joints[eyes])
    settings = GazeSettings(
        head,
        limits=of_eyes,
        geometry=geometry,
        saccade_rad=0.0,  # images wait after every motion
        settle_s=SETTLE_S,
        lost_s=LOST_S,
    )
    began_s = driver.now_s()
    while (frame := driver.read(settings.cameras)) is None:
        if driver.now_s() > began_s + seconds:
            raise VergenceError(f"The driver gave no frame within {seconds:g} s.")
    began_s, tenths = driver.now_s(), round(10 * seconds)
    seen: list[tuple[float, Mapping[str, Array]]] = []
    show = watched(settings)

    def watch(state: GazeState, frame: Frame | None) -> None:
        progress("tenths of a second", min(round(10 * (driver.now_s() - began_s)), tenths), tenths)
        if frame is not None:
            seen.append((frame.time_s, state.pixels))
        show(state, frame)

    state = initial_gaze_state(settings, frame.eye_angles, began_s)
    steered = _EyesOnly(driver, limits, frame.neck_angles)
    state = run_gaze(steered, settings, state, began_s + seconds, watch=watch)
    found = np.array([any(np.isfinite(uv).all() for uv in pixels.values()) for _, pixels in seen])
    if not found.any():
        raise VergenceError(
            f"The object was never found in {len(seen)} frames of {', '.join(settings.cameras)}; "
            f"the detector is for: {', '.join(settings.objects)}."
        )
    times = np.array([time_s for time_s, _ in seen])
    names, unknown = settings.narrow, np.full(3, np.nan)
    place = unknown if state.aim is None else state.aim.position
    place = transform(inverse(base_pose(head, "left")), place)
    _, wanted_px = best_pixels(settings, place)
    pixels = np.array([[each.get(name, unknown[:2]) for name in names] for _, each in seen])
    errors = np.linalg.norm(pixels - wanted_px, axis=-1)
    outside = np.flatnonzero(~(errors.max(axis=1) <= SETTLED_PX))
    settled = 0 if not len(outside) else int(outside[-1]) + 1
    return Fixation(
        seconds=seconds,
        found_s=float(found.mean() * seconds),
        final_px=dict(zip(names, errors[-1].tolist(), strict=True)),
        settled_s=float(times[settled] - times[found][0]) if settled < len(times) else None,
        position_m=None if state.track is None else state.track.position.tolist(),
    )
