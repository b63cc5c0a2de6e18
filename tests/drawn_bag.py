"""A head that looks at a board, drawn, as bags of ROS hold it: no MuJoCo."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recordings import picture
from vergence.arrays import Array
from vergence.geometry.board import Chessboard
from vergence.geometry.camera import pinhole
from vergence.geometry.head import R_EYE_CAM, HeadCalibration, MountedCamera, camera_pose_in_base
from vergence.geometry.kinematics import EYES
from vergence.geometry.se3 import inverse, pose, rotation
from vergence.recordings.bag import message, write_bag
from vergence.recordings.recording import JointSample, Message

BOARD = Chessboard(columns=7, rows=6, square_m=0.03)
SIZE = 320, 240
START_NS = 1_700_000_000_123_456_789
IMAGE_NS, JOINT_NS = 100_000_000, 10_300_000
"""Periods of images and of readings [ns]."""
See = Callable[[HeadCalibration, str, Array], np.ndarray]
TOPICS = {"left_wide": "/stereo/left/image_raw", "right_wide": "/stereo/right/image_raw"}
MAP = """
[cameras.left_wide]
eye = "left"
images = "/stereo/left/image_raw"

[cameras.right_wide]
eye = "right"
images = "/stereo/right/image_raw"

[board]
kind = "chessboard"
columns = 7
rows = 6
square_m = 0.03

[joints]
left_pan = { column = "l_eye_pan", unit = "deg" }
left_tilt = { column = "l_eye_tilt", unit = "deg" }
right_pan = { column = "/pans/joint_states:r_eye_pan", unit = "deg", sign = -1 }
right_tilt = { column = "r_eye_tilt", unit = "deg" }
"""
"""The map of such a bag."""


def two_eyes() -> HeadCalibration:
    """Return a head with two cameras of little resolution that err in their mounting."""
    cameras = {
        f"{eye}_wide": MountedCamera(
            eye=eye,
            intrinsics=pinhole(*SIZE, 260.0),
            T_eye_cam=pose(rotation(turn) @ R_EYE_CAM, [0.02, 0.001, 0.01]),
        )
        for eye, turn in zip(EYES, ([0.01, -0.02, 0.015], [-0.015, 0.01, 0.02]), strict=True)
    }
    return HeadCalibration(cameras=cameras, T_rbase_lbase=pose(t=[0, 0.07, 0]))


@dataclass(frozen=True)
class Session:
    """What a head does: a list of rests, between which eyes and board move."""

    angles: Array
    """(R, 4) joint angles of each rest [rad]."""
    T_lbase_target: Array
    """(R, 4, 4) pose of the board in each rest."""
    rest_ns: int = 600_000_000
    move_ns: int = 300_000_000

    @property
    def period_ns(self) -> int:
        return self.rest_ns + self.move_ns

    @property
    def end_ns(self) -> int:
        return self.period_ns * len(self.angles) - self.move_ns

    def _blend(self, t_ns: int) -> tuple[int, int, float]:
        k = min(t_ns // self.period_ns, len(self.angles) - 1)
        part = max(0.0, (t_ns - k * self.period_ns - self.rest_ns) / self.move_ns)
        return k, min(k + 1, len(self.angles) - 1), part

    def angles_at(self, t_ns: int) -> Array:
        """Return joint angles (4,) some time after the start."""
        a, b, part = self._blend(t_ns)
        return (1 - part) * self.angles[a] + part * self.angles[b]

    def board_at(self, t_ns: int) -> Array:
        """Return the pose of the board in the left base."""
        a, b, part = self._blend(t_ns)
        T = self.T_lbase_target[b if part > 0.5 else a].copy()
        T[:3, 3] = (1 - part) * self.T_lbase_target[a, :3, 3] + part * self.T_lbase_target[b, :3, 3]
        return T


def usual(straight: int = 12, turned: int = 22, *, seed: int = 0) -> Session:
    """Return boards at many places before straight eyes, then one board and turning eyes."""
    rng = np.random.default_rng(seed)
    base = pose(R_EYE_CAM, [0.4, 0.06, 0.07])  # the board's face, its first corner up and left
    poses, angles = [], []
    for _ in range(straight):
        poses.append(pose(t=rng.normal(0, [0.03, 0.02, 0.02])) @ base @ pose(rotation(
            rng.uniform(-0.5, 0.5, 3) * [1, 1, 0.5])))  # fmt: skip
        angles.append(rng.normal(0, 0.005, 4))
    for _ in range(turned):
        poses.append(base @ pose(rotation([0.2, 0.25, 0.1])))
        pan, tilt = rng.uniform(-0.2, 0.2), rng.uniform(-0.15, 0.15)
        angles.append(np.array([pan, tilt, pan, tilt]) + rng.normal(0, 0.02, 4))
    return Session(np.array(angles), np.array(poses))


def draw(head: HeadCalibration, camera: str, angles: Array, T_lbase_target: Array) -> np.ndarray:
    """Draw a camera's grey image (H, W) of the board."""
    mounted = head.cameras[camera]
    T_lbase_base = np.eye(4) if mounted.eye == "left" else inverse(head.T_rbase_lbase)
    T = inverse(T_lbase_base @ camera_pose_in_base(head, camera, angles)) @ T_lbase_target
    H = mounted.intrinsics.matrix @ T[:3, [0, 1, 3]] @ np.diag([BOARD.square_m] * 2 + [1])
    return picture(BOARD, H, SIZE)[0]


def messages(
    session: Session, head: HeadCalibration, *, see: See | None = None, noise: float = 1.0
) -> list[Message]:
    """Return what the head records: angles in degrees, pans and tilts on two topics.

    Images are received 20 ms after their stamp, joints 2 ms. `see` draws other things than the
    board.
    """
    rng, found = np.random.default_rng(0), []
    for t in range(0, session.end_ns + 1, IMAGE_NS):
        for camera, topic in TOPICS.items():
            if see is None:
                image = draw(head, camera, session.angles_at(t), session.board_at(t))
            else:
                image = see(head, camera, session.angles_at(t))
            noisy = image + rng.normal(0, noise, image.shape)
            image = np.round(noisy).clip(0, 255).astype(np.uint8)
            received_ns = START_NS + t + 20_000_000
            found.append(message(topic, START_NS + t, image, received_ns=received_ns))
    for t in range(-3 * JOINT_NS, session.end_ns + 3 * JOINT_NS, JOINT_NS):
        angles = np.degrees(session.angles_at(max(0, t)))
        pan = {"l_eye_pan": angles[0], "r_eye_pan": -angles[2], "jaw": 3.0}
        tilt = {"r_eye_tilt": angles[3], "l_eye_tilt": angles[1]}
        for topic, values in (("/pans/joint_states", pan), ("/tilts/joint_states", tilt)):
            sample = JointSample(tuple(values), np.array([*values.values()]))
            received_ns = START_NS + t + 2_000_000
            found.append(message(topic, START_NS + t, sample, received_ns=received_ns))
    return sorted(found, key=lambda each: each.received_ns)


def write_mcap(path: Path, content: list[Message]) -> None:
    """Write messages into a single file, as robots record that have no ROS."""
    write_bag(path.with_suffix(".bag"), content)
    (file,) = path.with_suffix(".bag").glob("*.mcap")
    file.rename(path)
