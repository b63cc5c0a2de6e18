"""Reachy Mini, through its maker's package: one camera on a head that pans, tilts and rolls."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from importlib import import_module

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.data.description import DatasetCamera, DatasetReading, Description, EyeJoint
from vergence.errors import VergenceError
from vergence.gaze.commands import HeadCommand, hold, joint_limits, setpoint
from vergence.geometry.board import Chessboard

AXES = {"pan": (0.0, 0.0, 1.0), "tilt": (0.0, 1.0, 0.0), "roll": (1.0, 0.0, 0.0)}
"""Axes of the head's turn, from the body outwards; the package computes it from the motors."""
RANGE_RAD = {"pan": (-0.5, 0.5), "tilt": (-0.35, 0.35), "roll": (-0.25, 0.25)}
"""Ranges that the platform reaches together while the body stays [rad]; tried on its model."""
SPEED_RAD_S = 2.0
"""Maximum speed of the set points [rad/s], for a heavy head: assumed."""
BOARD = Chessboard(columns=9, rows=6, square_m=0.03)
"""The board to show, by its inner corners and the side of a square [m]."""
PERIOD_S, FAILED_S = 0.01, 3.0
"""Time between set points, half that of the package's control loop; and time without an image after
which the camera has failed [s]."""


class ReachyMiniHead:
    """The driver of the robot that the package finds."""

    def __init__(self) -> None:
        """Connect to the robot. VergenceError if package, robot or camera are missing."""
        try:
            package = import_module("reachy_mini")
            self._robot = package.ReachyMini(automatic_body_yaw=False)
        except Exception as error:  # of the many packages that it needs
            missing = "Reachy Mini, or its package (pip install reachy_mini), does not answer"
            raise VergenceError(f"{missing}: {error}") from None
        height, width, _ = self._image().shape
        joints = [EyeJoint(name, np.array(axis), {name: 1.0}) for name, axis in AXES.items()]
        self.description = Description(
            cameras={"camera": DatasetCamera("left", width=width, height=height)},
            board=BOARD,
            kinematics={"left": tuple(joints)},
            readings={name: DatasetReading("rad") for name in AXES},
        )
        speeds = dict.fromkeys(AXES, SPEED_RAD_S)
        self.limits = joint_limits(RANGE_RAD, speeds, joints=tuple(AXES))
        self._command = hold(self._angles(), self.limits, self.now_s())
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    def _image(self) -> np.ndarray:
        until_s = self.now_s() + FAILED_S
        while (image := self._robot.media.get_frame()) is None:
            if self.now_s() > until_s:
                raise VergenceError("Reachy Mini's camera gives no images.")
            time.sleep(PERIOD_S)
        return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)

    def _angles(self) -> Array:
        R = self._robot.get_current_head_pose()[:3, :3]
        return Rotation.from_matrix(R).as_euler("ZYX")

    def _follow(self) -> None:
        while not self._stopped.wait(PERIOD_S):
            pose = np.eye(4)  # the head in the middle of its platform
            turn = Rotation.from_euler("ZYX", setpoint(self._command, self.now_s()))
            pose[:3, :3] = turn.as_matrix()
            self._robot.set_target_head_pose(pose)

    def now_s(self) -> float:
        """Read the clock of images and poses [s]."""
        return time.monotonic()

    def read(self, cameras: Sequence[str]) -> Frame:
        """Wait for the next image, and read the head's pose. VergenceError if the camera fails."""
        image, image_s = self._image(), self.now_s()
        angles, joint_s = self._angles(), self.now_s()
        return Frame(image_s, joint_s, angles, np.empty(0), dict.fromkeys(cameras, image))

    def command(self, command: HeadCommand) -> None:
        """Follow a command from now on."""
        self._command = command

    def close(self) -> None:
        """Stop the head where it is, and release the robot."""
        self._stopped.set()
        self._thread.join()
        self._robot.set_target_head_pose(self._robot.get_current_head_pose())
        self._robot.__exit__(None, None, None)
