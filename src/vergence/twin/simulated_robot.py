"""The twin as a head that a gaze controller can drive, and what only the twin can say of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.calibration.sequential.sequential import calibrate
from vergence.data.dataset import Frame
from vergence.gaze.commands import EYES_4, HEAD_JOINTS, Command, Limits, setpoint, stay
from vergence.gaze.controller import NARROW, Settings
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES
from vergence.geometry.se3 import inverse, transform
from vergence.paper.replay import see
from vergence.twin.calibration_errors import inject_calibration_error
from vergence.twin.calibration_sequence import capture_views, plan
from vergence.twin.head import Twin

FRAME_S = 0.033
"""Between frames: 30 Hz, in whole milliseconds, since the physics steps in them."""
_REST_READINGS = 30


def calibrated(twin: Twin, seed: int) -> Settings:
    """Calibrate the twin by the paper's method, and return what a controller needs of it.

    Args:
        twin: the head, with 2.8 mm lenses.
        seed: of the places at which the board is held.
    """
    views = capture_views(twin, plan(twin.nominal, seed))
    found = calibrate(views, wide_lens=twin.profile.calibration.wide_lens, neck=twin.nominal.neck)
    head = inject_calibration_error(found.head, twin.profile.by_hand, "2.8mm")
    twin.restart(0)
    # What a driver can find out for itself: how much the readings of resting joints scatter.
    rest = np.array([twin.capture(()).eye_angles for _ in range(_REST_READINGS)])
    floor = 5e-5  # more would make the filter of a perfect head lag behind what it sees
    scatter = float(rest.std(axis=0, ddof=1).mean())
    return Settings(calibration=head, joint_std_rad=float(np.hypot(floor, scatter)))


@dataclass(frozen=True)
class Delivery:
    """What becomes of frames between the camera and the controller."""

    period_s: float = FRAME_S
    latency_s: float = 0.0
    """From the moment of an image until the controller has it; less than the period."""
    all_every: int = 0
    """Of so many frames one has the images of all cameras, whether they were asked for or not:
    for who looks on, recording or not, so that looking on changes nothing. 0: none."""


class TwinHead:
    """The twin behind the `motion.Head` protocol, with an object that may move.

    Frame by frame the physics goes on, the object is put where it is at that time, and a frame is
    taken. The path of the object is in world coordinates, from where the left eye's base is at
    time zero, so that it stays where it is when the neck turns.

    The servo of a real eye is closed on its own sensor, so that commands are as wrong as readings:
    gain and offset of the profile are undone on the way to the simulated joint, which knows its
    true angle. Noise is not: a servo averages over it.
    """

    def __init__(
        self,
        twin: Twin,
        run: int,
        path: Callable[[float], Array | None],
        *,
        limits: Limits | None = None,
        delivery: Delivery | None = None,
    ):
        """Restart the twin.

        Args:
            twin: the head.
            run: its number, for the noise.
            path: where the object is (3,) [m] at a time; None: it is hidden.
            limits: of the joints.
            delivery: of the frames.
        """
        self.twin, self.path = twin, path
        self.delivery = Delivery() if delivery is None else delivery
        twin.restart(run)
        self._T_world_start = twin.T_world_lbase()
        limits = Limits() if limits is None else limits
        self._command = stay(np.zeros(len(HEAD_JOINTS)), limits, twin.time_s)
        self._next_s, self._number = twin.time_s, 0
        joints = twin.profile.joints
        self._gain = 1 + np.array(joints.gain_percent) / 100
        self._offset = np.radians(joints.offset_deg)

    def now_s(self) -> float:
        """Return the simulated time."""
        return self.twin.time_s

    def command(self, command: Command) -> None:
        """Obey a command from now on."""
        self._command = command

    def read(self, cameras: Sequence[str]) -> Frame | None:
        """Go on to the next frame, and take it with the images of these cameras."""
        self._advance(self._next_s)
        self._next_s = round(self._next_s + self.delivery.period_s, 6)
        self.place()
        every = self.delivery.all_every
        show_all = every > 0 and self._number % every == 0
        self._number += 1
        frame = self.twin.capture(tuple(self.twin.truth.cameras) if show_all else tuple(cameras))
        self._advance(frame.time_s + self.delivery.latency_s)
        return frame

    def _advance(self, until_s: float) -> None:
        command = self._command

        def servo(time_s: float) -> Array:
            wanted = setpoint(command, time_s)
            wanted[EYES_4] = (wanted[EYES_4] - self._offset) / self._gain
            return wanted

        self.twin.advance(until_s, servo)

    def place(self) -> None:
        """Put the object where it is now."""
        where = self.path(self.twin.time_s)
        if where is not None:
            T_lbase_start = inverse(self.twin.T_world_lbase()) @ self._T_world_start
            where = transform(T_lbase_start, where)
        self.twin.place_object(where)


def foveal_errors(twin: Twin, believed: HeadCalibration) -> Array:
    """Return how far (2,) [px] the object truly is from the centre of the two narrow images, now.

    The centre is the principal point as the controller believes it to be: the true one is not to
    be seen in an image. Infinity where the object is behind a camera.
    """
    eyes = twin.true_angles()[None, EYES_4]
    found = []
    for name in NARROW:
        pixel = see(twin.truth, name, eyes, twin.true_object())[0]
        centre = believed.camera(name).intrinsics.matrix[:2, 2]
        found.append(np.linalg.norm(pixel - centre))
    return np.nan_to_num(np.array(found), nan=np.inf)


def in_both_foveas(twin: Twin) -> bool:
    """Return whether the object's centre truly is within both narrow images, now."""
    eyes = twin.true_angles()[None, EYES_4]
    for eye in EYES:
        camera = twin.truth.camera(f"{eye}_narrow").intrinsics
        pixel = see(twin.truth, f"{eye}_narrow", eyes, twin.true_object())[0]
        if not (
            np.abs(2 * pixel + 1 - [camera.width, camera.height]) < [camera.width, camera.height]
        ).all():
            return False
    return True
