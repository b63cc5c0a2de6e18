"""A head before a person with a board, whose images are drawn: a driver as a user would write."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from guided_capture import HeadWithoutImages, simulated
from simulated_recording import BOARD
from vergence.data.dataset import Frame
from vergence.gaze.commands import joint_limits
from vergence.geometry.board import Board
from vergence.geometry.camera import Camera
from vergence.geometry.head import camera_pose_in_base
from vergence.geometry.se3 import inverse
from vergence.live.capture import CaptureSettings
from vergence.live.stillness import find_board

SQUARE = 32
"""Picture elements along a square, of which a board has a white margin of half of one."""


def chessboard() -> np.ndarray:
    """Draw the board (H, W) with its margin."""
    squares = np.indices((BOARD.rows + 1, BOARD.columns + 1)).sum(axis=0) % 2
    picture = np.kron(np.where(squares, 230, 20), np.ones((SQUARE, SQUARE))).astype(np.uint8)
    return np.pad(picture, SQUARE // 2, constant_values=230)


class DrawnHead(HeadWithoutImages):
    """A head whose images show the board and nothing else."""

    def prepare(self, settings: CaptureSettings) -> None:
        """Prepare the drawing."""
        self.description, self._picture = settings.description, chessboard()

    @classmethod
    def drawn(cls, seed: int) -> "tuple[DrawnHead, CaptureSettings]":
        """Make a head and the settings of its capture."""
        bare, settings = simulated(seed, 0.006)
        cameras = {
            name: replace(m, intrinsics=replace(m.intrinsics, distortion=np.zeros(5)))
            for name, m in bare.truth.cameras.items()
        }
        truth = replace(bare.truth, cameras=cameras)
        head = cls(truth, replace(bare.noise, joint_rad=0.0005), seed)
        head.prepare(settings)
        return head, settings

    def read(self, cameras: Sequence[str]) -> Frame:
        """Draw the images of a frame."""
        frame, images = super().read(cameras), {}
        for name in cameras:
            mounted, T = self.truth.camera(name), self.T_lbase_board
            T_base_target = T if mounted.eye == "left" else self.truth.T_rbase_lbase @ T
            T_cam_target = inverse(camera_pose_in_base(self.truth, name, self.joints))
            images[name] = self._drawn(mounted.intrinsics, T_cam_target @ T_base_target)
        return replace(frame, images=images)

    def _drawn(self, camera: Camera, T_cam_target: np.ndarray) -> np.ndarray:
        """Draw a board (H, W, 3) as a camera without distortion sees it, with noise of 2 levels."""
        image = np.full((2 * camera.height, 2 * camera.width), 128, np.uint8)
        if T_cam_target[2, 3] > 0.1:  # before the camera
            # Picture elements, of which the first corner is between, to metres to twice the pixels.
            first = 1.5 * SQUARE - 0.5
            to_m = np.diag([BOARD.square_m / SQUARE, BOARD.square_m / SQUARE, 1.0])
            to_m[:2, 2] = -first * BOARD.square_m / SQUARE
            finer = np.array([[2, 0, 0.5], [0, 2, 0.5], [0, 0, 1.0]])
            H = finer @ camera.matrix @ T_cam_target[:3, [0, 1, 3]] @ to_m
            cv2.warpPerspective(
                self._picture, H, image.shape[::-1], image, cv2.INTER_LINEAR, cv2.BORDER_TRANSPARENT
            )
        small = cv2.resize(image, camera.size, interpolation=cv2.INTER_AREA)
        small = cv2.GaussianBlur(small, (0, 0), 0.6)
        noisy = small + self.rng.normal(0, 2, small.shape)
        return np.repeat(np.clip(noisy, 0, 255).astype(np.uint8)[..., None], 3, axis=2)

    def by_images(self, frame: Frame, board: Board, width_px: float):
        """Find the board in the drawn images."""
        return find_board(frame, board, width_px)

    def close(self) -> None: ...


def open_drawn() -> DrawnHead:
    """Open the driver."""
    head, _ = DrawnHead.drawn(1)
    return head


def two_limits() -> DrawnHead:
    """Open a driver that forgets two of four joints."""
    head = open_drawn()
    names = head.limits.joints[:2]
    reach, speed = dict.fromkeys(names, (-0.3, 0.3)), dict.fromkeys(names, 1.0)
    head.limits = joint_limits(reach, speed, joints=names)
    return head
