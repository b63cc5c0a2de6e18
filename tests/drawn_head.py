"""A head that follows its set points, exactly by default, and draws its images: no MuJoCo."""

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from postures import LIMITS, NECK_JOINTS
from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.gaze.commands import HeadCommand, hold, setpoint, setpoints_at
from vergence.gaze.foveation import gaze_angles
from vergence.geometry.camera import pinhole, project
from vergence.geometry.head import (
    HeadCalibration,
    MountedCamera,
    base_pose_in_body,
    camera_pose_in_base,
)
from vergence.geometry.kinematics import EYES
from vergence.geometry.neck import Neck
from vergence.geometry.se3 import inverse, pose, rotation, transform

PERIOD_S = 1 / 30
_RADIUS_M = 0.02
_R_EYE_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def four_cameras() -> HeadCalibration:
    """Return a head like the model's: wide lenses that distort, narrow ones 30 mm below."""
    rng = np.random.default_rng(0)
    cameras = {}
    for eye in EYES:
        for lens, focal, z, k in (("wide", 280.0, 0.01, -0.12), ("narrow", 1200.0, -0.02, 0.0)):
            turn = rotation(rng.normal(0, 0.01, 3))
            cameras[f"{eye}_{lens}"] = MountedCamera(
                eye=eye,
                intrinsics=pinhole(640, 480, focal, (k, 0.02 * (k != 0), 0, 0, 0)),
                T_eye_cam=pose(turn @ _R_EYE_CAM, [0.02, 0, z]),
            )
    neck = Neck(
        axes=np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]),
        points_m=np.array([[0, 0, 0.07], [0, 0, 0.105], [0, 0, 0.14]]),
        head_m=np.array([0.06, 0, 0.2]),
        joints=NECK_JOINTS,
    )
    return HeadCalibration(cameras=cameras, T_rbase_lbase=pose(t=[0, 0.092, 0]), neck=neck)


class DrawnHead:
    """Behind the interface HeadDriver; the path of the object is in frame body, None: hidden.

    Faults are given as functions of the number of the frame or of the time.
    """

    def __init__(
        self,
        path: Callable[[float], Array | None],
        *,
        latency_s: float = 0.0,
        dropped: Callable[[int], bool] = lambda number: False,
        repeated: Callable[[int], bool] = lambda number: False,
        stuck: Callable[[float], Array | None] = lambda time_s: None,
        joint_noise_rad: float = 0.0,
        joint_gain: float = 1.0,
        joint_lag_s: float = 0.0,
        servo_lag_s: float = 0.0,
        period_s: float = PERIOD_S,
    ):
        self.calibration, self.path = four_cameras(), path
        self.latency_s, self.dropped, self.repeated = latency_s, dropped, repeated
        self.stuck, self.joint_lag_s = stuck, joint_lag_s
        self.servo_lag_s, self.period_s = servo_lag_s, period_s
        self.noise, self.gain = joint_noise_rad, joint_gain
        self.commands: list[HeadCommand] = [hold(np.zeros(7), LIMITS, -1.0)]
        self.number, self.time_s = -1, 0.0
        self.last: Frame | None = None
        self.rng = np.random.default_rng(0)
        self._blank = np.full((480, 640, 3), 90, np.uint8)

    def now_s(self) -> float:
        return self.time_s

    def command(self, command: HeadCommand) -> None:
        self.commands.append(command)

    def posture(self, time_s: float) -> Array:
        """Return the true joint angles (7,) [rad]; NaN in `stuck` means free."""
        angles = setpoints_at(self.commands, time_s)
        if self.servo_lag_s:  # of the first order
            ages = (np.arange(300) + 0.5) / 40
            times_s = time_s - self.servo_lag_s * ages
            sent = np.empty((len(ages), len(angles)))
            for command in self.commands:  # the last one before a time stays in force
                rows = (times_s >= command.time_s) | (command is self.commands[0])
                sent[rows] = setpoint(command, times_s[rows])
            angles = np.average(sent, axis=0, weights=np.exp(-ages))
        held = self.stuck(time_s)
        return angles if held is None else np.where(np.isnan(held), angles, held)

    def read(self, cameras: Sequence[str]) -> Frame | None:
        self.number += 1
        image_s = self.number * self.period_s
        self.time_s = image_s + self.latency_s
        if self.dropped(self.number):
            return None
        if self.repeated(self.number) and self.last is not None:
            return self.last
        joint_s = max(image_s - self.joint_lag_s, 0.0)
        reading = self.posture(joint_s)
        reading[-4:] = self.gain * reading[-4:] + self.rng.normal(0, self.noise, 4)
        self.last = Frame(
            image_s,
            joint_s,
            reading[-4:],
            reading[: len(self.calibration.neck.axes)],
            {name: self._draw(name, image_s) for name in cameras},
        )
        return self.last

    def in_camera(self, name: str, time_s: float, point: Array) -> Array:
        """Map a point (3,) [m] from frame body to frame cam."""
        angles, eye = self.posture(time_s), self.calibration.cameras[name].eye
        eyes = angles[-4:]
        T = base_pose_in_body(self.calibration, eye, angles)
        return transform(inverse(T @ camera_pose_in_base(self.calibration, name, eyes)), point)

    def _draw(self, name: str, time_s: float) -> np.ndarray:
        image, point = self._blank.copy(), self.path(time_s)
        if point is None:
            return image
        return self.dot(image, name, time_s, point, _RADIUS_M, (220, 20, 20))

    def dot(self, image, name: str, time_s: float, point: Array, radius_m, colour) -> np.ndarray:
        """Draw a sphere at a point (3,) [m] in frame body, if the camera sees it."""
        x, y, z = seen = self.in_camera(name, time_s, point)
        if z <= 0.05 or np.hypot(x, y) > 2 * z:
            return image
        camera = self.calibration.cameras[name].intrinsics
        with np.errstate(over="ignore"):
            centre = project(camera, seen)
        if not (np.abs(centre) < 2000).all():
            return image
        u, v, r = (round(float(x) * 16) for x in (*centre, camera.matrix[0, 0] * radius_m / z))
        return cv2.circle(image, (u, v), r, colour, -1, cv2.LINE_AA, 4)

    def errors_px(
        self, time_s: float, cameras: Sequence[str] = ("left_narrow", "right_narrow")
    ) -> Array:
        """Return the distances (2,) [px] of the object from the centres of images."""
        point, errors = self.path(time_s), []
        for name in cameras:
            camera, where = self.calibration.cameras[name].intrinsics, np.full(2, np.nan)
            if point is not None:
                where = project(camera, self.in_camera(name, time_s, point))
            errors.append(np.linalg.norm(where - camera.matrix[:2, 2]))
        return np.array(errors)


def point_at(pan_deg: float, tilt_deg: float, distance_m: float) -> Array:
    """Return a point (3,) [m] in frame body, in a direction from the resting head."""
    pan, tilt = np.radians([pan_deg, tilt_deg])
    ray = np.array([np.cos(pan) * np.cos(tilt), np.sin(pan) * np.cos(tilt), -np.sin(tilt)])
    return four_cameras().neck.head_m + distance_m * ray


def straight_to(point_body: Array) -> Array:
    """Return the eye angles (4,) [rad] to a point when the neck is straight."""
    head = four_cameras()
    T = inverse(base_pose_in_body(head, "left", np.zeros(3)))
    return gaze_angles(head, transform(T, point_body))
