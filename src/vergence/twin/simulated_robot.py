"""The twin as a robot that controllers drive: head, hand and object, and their true errors.

Before an experiment it is calibrated, or learns its geometry from images of the room alone.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from copy import copy

import mujoco
import numpy as np

from vergence.accuracy.motions import SLOWEST_S
from vergence.accuracy.motions import eye_angles as motion_angles
from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.gaze.commands import (
    HeadCommand,
    JointLimits,
    hold,
    joint_limits,
    setpoint,
)
from vergence.gaze.state import GazeSettings
from vergence.geometry.head import base_pose
from vergence.geometry.kinematics import EYE_JOINTS, Kinematics
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import inverse, transform
from vergence.progress import Progress, silent
from vergence.self_calibration.calibrator import VisualGeometry, update_geometry
from vergence.twin.calibration_errors import inject_calibration_error
from vergence.twin.calibration_sequence import paper_calibration, straight_neck
from vergence.twin.hand import SimulatedHand
from vergence.twin.head import Twin
from vergence.twin.model import NECK_JOINTS
from vergence.twin.sensors import gains_and_offsets, sensor_columns

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

    The twin must have 2.8 mm lenses. The seed is that of the board's poses; progress is called
    after each view.
    """
    found = paper_calibration(
        twin, seed, progress=lambda _, done, total: progress("calibrating, 2.8mm lens", done, total)
    )
    head = inject_calibration_error(found.head, twin.profile.by_hand, "2.8mm")
    twin.restart(0)
    # A real driver can measure this too: the standard deviation of the readings at rest. Thirty of
    # each of four joints tell it to 7 %.
    rest = np.array([twin.capture(()).eye_angles for _ in range(30)])
    floor = 5e-5  # more would make the filter of a perfect head lag behind what it sees
    std = float(rest.std(axis=0, ddof=1).mean())
    return GazeSettings(
        calibration=head,
        limits=twin_limits(twin.truth.kinematics),
        reading_std=float(np.hypot(floor, std)),
    )


def look_around(twin: Twin, cameras: Sequence[str], *, run: int) -> Iterator[Frame]:
    """Yield frames of LOOK_S of quick divergent motion, in which vergence changes.

    The number of the run determines the noise.
    """
    twin.restart(run)

    def command(time_s: float) -> Array:
        return straight_neck(motion_angles("divergent", FASTER * np.array(time_s - _SETTLE_S)))

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


def twin_limits(kinematics: Kinematics) -> JointLimits:
    """Compute the limits of readings from those of the hinges that they turn."""
    names = [*NECK_JOINTS, *EYE_JOINTS]
    model = JointLimits(
        np.radians([(-30, 40), (-30, 30), (-50, 50), (-35, 35), (-30, 30), (-35, 35), (-30, 30)]),
        np.array([3.0] * 3 + [10.0] * 4),
        tuple(names),
    )
    rows = [model.joints.index(EYE_JOINTS[k]) for k in sensor_columns(kinematics)]
    names = [*NECK_JOINTS, *kinematics.readings]
    order = [*range(len(NECK_JOINTS)), *rows]
    farther = 1 / np.append(np.ones(len(NECK_JOINTS)), kinematics.gear_ratios)
    ranges = model.range_rad[order] * farther[:, None]
    return joint_limits(
        dict(zip(names, map(tuple, ranges.tolist()), strict=True)),
        dict(zip(names, (model.speed_rad_s[order] * farther).tolist(), strict=True)),
        joints=names,
    )


class SimulatedHead:
    """The twin behind the interface `HeadDriver`, with an object that may move.

    From frame to frame the physics advances, the object is placed on its path, and a frame is
    taken. The path is fixed in the world, so that the object does not follow the neck.

    The servo of a real eye is closed on its own sensor, so that commands have the same errors as
    readings: the gain and offset of the error profile are undone on the way to the simulated joint,
    which knows its true angle. Noise is not undone, because a servo averages over it.
    """

    hand: SimulatedHand | None = None
    """A hand that the cameras see, or None."""

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
        kinematics = twin.truth.kinematics
        self._limits = twin_limits(kinematics)
        self._command = hold(np.zeros(len(self._limits.joints)), self._limits, twin.time_s)
        self._next_s, self._number = twin.time_s, 0
        self._gain, self._offset = gains_and_offsets(twin.profile.joints, kinematics)

    def now_s(self) -> float:
        """Read the simulated clock [s]."""
        return self.twin.time_s

    def command(self, command: HeadCommand) -> None:
        """Follow a command from now on."""
        self._command = command

    def read(self, cameras: Sequence[str]) -> Frame | None:
        """Advance to the next frame, and return it with the images of these cameras."""
        self.twin.advance(self._next_s, self._servo)
        self._next_s = round(self._next_s + FRAME_S, 6)
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
    """Compute the object's distances (E,) [px] from the principal points of the calibration.

    Infinite where the object is behind a camera.
    """
    cameras = settings.calibration.cameras
    centres = [cameras[name].intrinsics.matrix[:2, 2] for name in settings.narrow]
    offsets = true_pixels(twin, settings) - centres
    errors = np.array([np.linalg.norm(offset) for offset in offsets], float)
    return np.nan_to_num(errors, nan=np.inf)


def in_all_foveas(twin: Twin, settings: GazeSettings) -> bool:
    """Tell whether the object's centre is within all these images."""
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
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
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
