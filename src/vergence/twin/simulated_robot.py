"""The twin as a robot that controllers drive: head, hand and object, and their true errors.

Before an experiment it is calibrated, or learns its geometry from images of the room alone.
"""

# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from copy import copy

import mujoco
import numpy as np

from vergence.accuracy.motions import PERIOD_S, SLOWEST_S, eye_readings
from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.gaze.commands import HeadCommand, hold, setpoint
from vergence.gaze.foveation import best_pixels
from vergence.gaze.state import GazeSettings
from vergence.geometry.head import HeadCalibration, base_pose
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import inverse, transform
from vergence.progress import Progress, silent
from vergence.self_calibration.calibrator import VisualGeometry, update_geometry
from vergence.twin.calibration_errors import inject_calibration_error
from vergence.twin.calibration_sequence import paper_calibration, within
from vergence.twin.hand import SimulatedHand
from vergence.twin.head import Twin
from vergence.twin.sensors import gains_and_offsets

FRAME_S = 0.033
"""Frame period: 30 Hz, in whole milliseconds, because the physics steps in them."""
LOOK_S, LOOK_STEP_S = 5.0, 0.1
"""Duration of looking around, and period of its images [s]."""
FASTER = SLOWEST_S["divergent"] / LOOK_S
"""Speed of the eyes relative to the paper's figures. Each joint passes through its range once, at
45 degrees a second or less: new postures are more informative than more images."""
_SETTLE_S = 1.0  # before the motion, for the simulated servos to reach its start


def calibrate_twin(twin: Twin, seed: int, progress: Progress = silent) -> GazeSettings:
    """Calibrate the twin by the paper's method, and return the settings of a gaze controller.

    The seed is that of the board's poses; progress is called after each view.
    """
    lens = twin.head.lens
    task = f"calibrating, {lens} lens" if lens else "calibrating"
    found = paper_calibration(
        twin, seed, progress=lambda _, done, total: progress(task, done, total)
    )
    head = inject_calibration_error(found.head, twin.profile.by_hand)
    twin.restart(0)
    # A real driver can measure this too: the standard deviation of the readings at rest. Thirty of
    # each joint tell it to 7 to 13 %.
    rest = np.array([twin.capture(()).eye_angles for _ in range(30)])
    floor = 5e-5  # more would make the filter of a perfect head lag behind what it sees
    std = float(rest.std(axis=0, ddof=1).mean())
    return GazeSettings(head, limits=twin.limits, reading_std=float(np.hypot(floor, std)))


def divergent_motion(twin: Twin) -> Callable[[float], Array]:
    """Make the function that gives the postures (j,) of a divergent motion within the limits."""
    kinematics, ranges = twin.nominal.kinematics, twin.limits.setpoint_range_rad
    ranges = ranges[len(twin.nominal.neck.axes) :]
    period_s = np.arange(0.0, PERIOD_S["divergent"], 0.5)
    amplitude = np.abs(eye_readings(kinematics, "divergent", period_s)).max(axis=0)

    def posture(time_s: float) -> Array:
        readings = eye_readings(kinematics, "divergent", np.array(time_s))
        return twin.posture(within(ranges, readings, amplitude))

    return posture


def look_around(twin: Twin, cameras: Sequence[str], *, run: int) -> Iterator[Frame]:
    """Yield frames of LOOK_S of quick divergent motion; the run's number determines the noise."""
    twin.restart(run)
    motion = divergent_motion(twin)

    def command(time_s: float) -> Array:
        return motion(FASTER * (time_s - _SETTLE_S))

    twin.advance(_SETTLE_S / 2, command(_SETTLE_S))
    for time_s in np.arange(0.0, LOOK_S, LOOK_STEP_S):
        twin.advance(round(_SETTLE_S + time_s, 3), command)
        yield twin.capture(cameras)


def learn_by_looking(
    twin: Twin, geometry: VisualGeometry, *, run: int, progress: Progress = silent
) -> VisualGeometry:
    """Update a geometry while the twin looks around; see `look_around`."""
    total = len(np.arange(0.0, LOOK_S, LOOK_STEP_S))
    for done, frame in enumerate(look_around(twin, geometry.state.cameras, run=run), start=1):
        geometry = update_geometry(geometry, frame)
        progress("looking around", done, total)
    return geometry


class SimulatedHead:
    """The twin behind the interface `HeadDriver`, with an object that may move.

    The object's path is fixed in the world, so that it does not follow the neck. A real servo is
    closed on its sensor, so that commands have the errors of readings: gain and offset of the
    profile are undone on the way to the simulated joint. Noise is not, since a servo averages it.
    """

    hand: SimulatedHand | None = None
    """A hand that the cameras see, or None."""
    frame_s = FRAME_S
    """Period of the frames [s], in whole milliseconds."""

    def __init__(
        self,
        twin: Twin,
        run: int,
        path_head: Callable[[float], Array | None],
        *,
        all_cameras_every: int = 0,
    ):
        """Restart the twin; the number of the run determines the noise.

        `path_head` gives the position (3,) [m] of the object at a time, in frame head as it is at
        the start; None: the object is hidden. Every Nth frame has the images of all cameras,
        recorded or not: an observer must not change what the controller receives. 0: no frame has.
        """
        self.twin, self.path_head = twin, path_head
        self._all_cameras_every = all_cameras_every
        twin.restart(run)
        self._T_world_start = twin.T_world_lbase()
        self._T_lbase_head = inverse(base_pose(twin.truth, "left"))
        self._command = hold(twin.rest(), twin.limits, twin.time_s)
        self._next_s, self._number = twin.time_s, 0
        self._gain, self._offset = gains_and_offsets(twin.profile.joints, twin.truth.kinematics)

    def now_s(self) -> float:
        """Read the simulated clock [s]."""
        return self.twin.time_s

    def command(self, command: HeadCommand) -> None:
        """Follow a command from now on."""
        self._command = command

    def read(self, cameras: Sequence[str]) -> Frame | None:
        """Advance to the next frame, and return it with the images of these cameras."""
        self.twin.advance(self._next_s, self._servo)
        self._next_s = round(self._next_s + self.frame_s, 6)
        where = self.path_head(self.twin.time_s)
        if where is not None:
            T_lbase_start = inverse(self.twin.T_world_lbase()) @ self._T_world_start
            where = transform(T_lbase_start, transform(self._T_lbase_head, where))
        self.twin.place_object(where)
        if self.hand is not None:
            self.hand.place()
        if self._all_cameras_every and self._number % self._all_cameras_every == 0:
            cameras = tuple(self.twin.truth.cameras)
        self._number += 1
        return self.twin.capture(cameras)

    def _servo(self, time_s: float) -> Array:
        """Compute the angles (j,) [rad] that the simulated joints are sent to at a time."""
        wanted = setpoint(self._command, time_s)
        readings = slice(-len(self._gain), None)
        wanted[readings] = (wanted[readings] - self._offset) / self._gain
        return wanted


def true_pixels(twin: Twin, settings: GazeSettings) -> Array:
    """Project the object into the narrow or only camera of each of the E eyes in use, (E, 2)."""
    eyes, where = twin.true_readings(), twin.true_object()
    return np.array([project_point(twin.truth, name, eyes, where) for name in settings.narrow])


def foveal_errors(twin: Twin, settings: GazeSettings) -> Array:
    """Compute the object's distances (E,) [px] from where the calibration would have it.

    Infinite where the object is behind a camera.
    """
    return foveal_errors_at(twin.truth, settings, twin.true_readings(), twin.true_object())


def foveal_errors_at(
    truth: HeadCalibration, settings: GazeSettings, readings: Array, where: Array
) -> Array:
    """Compute `foveal_errors` of an object (3,) [m] in the left eye's base at readings (r,).

    NaN for an object that is NaN.
    """
    if np.isnan(where).any():
        return np.full(len(settings.narrow), np.nan)
    wanted = best_pixels(settings, where[None])[1][0]
    seen = np.array([project_point(truth, name, readings, where) for name in settings.narrow])
    errors = np.array([np.linalg.norm(offset) for offset in seen - wanted], float)
    return np.nan_to_num(errors, nan=np.inf)


def reachable(twin: Twin, settings: GazeSettings, places_head: Array) -> np.ndarray:
    """Test (N,) to which places (N, 3) [m] in frame head the eyes can turn, and see them there."""
    places = transform(inverse(base_pose(settings.calibration, "left")), places_head)
    readings, pixels = best_pixels(settings, places)
    lower, upper = twin.limits.setpoint_range_rad[settings.readings].T
    sizes = [settings.calibration.camera(name).intrinsics.size for name in settings.narrow]
    margin = 0.1 * np.array(sizes)
    seen = ((pixels > margin) & (pixels < sizes - margin)).all(axis=(1, 2))
    return seen & ((readings >= lower) & (readings <= upper)).all(axis=1)


def in_all_foveas(twin: Twin, settings: GazeSettings) -> bool:
    """Test whether the object's centre is within all these images."""
    return all(
        ((pixel > -0.5) & (pixel + 0.5 < twin.truth.camera(name).intrinsics.size)).all()
        for name, pixel in zip(settings.narrow, true_pixels(twin, settings), strict=True)
    )


def unoccluded(twin: Twin, places_head: Array, *, margin_m: float) -> np.ndarray:
    """Test (N,) which places (N, 3) [m] in frame head all cameras of the head at rest see.

    The room must not occlude a margin around each place either.
    """
    model = copy(twin.model)
    data = mujoco.MjData(model)
    data.qpos[:] = twin.rest_qpos()
    mujoco.mj_forward(model, data)
    # Rays are tested against group 5 only: the world's own geoms, which are the room.
    model.geom_group[:] = np.where(model.geom_bodyid == 0, 5, 0)
    groups = np.array([0, 0, 0, 0, 0, 1], np.uint8)
    places_lbase = transform(inverse(base_pose(twin.truth, "left")), places_head)
    places = transform(twin.T_world_lbase(), places_lbase)
    found = np.ones(len(places), bool)
    for camera in twin.truth.cameras:
        start = data.cam_xpos[model.camera(camera).id]
        for k, place in enumerate(places):
            away = place - start
            distance = float(np.linalg.norm(away))
            across = np.linalg.svd(away[None])[2][1:]  # two directions around the place
            for off in (np.zeros(3), *across, *-across):
                ray = away + margin_m * off
                ray /= np.linalg.norm(ray)
                geom = np.zeros((1, 1), np.int32)
                hit = mujoco.mj_ray(model, data, start, ray, groups, 1, -1, geom)
                found[k] &= not 0 <= hit < distance + margin_m
    return found
