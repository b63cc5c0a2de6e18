"""A head before a person with a board, whose images are drawn: a driver as a user would write."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drawn_card import draw_card, sample_slopes
from guided_capture import HeadWithoutImages, simulated
from simulated_recording import BOARD, POINTS
from vergence.data.dataset import Frame
from vergence.geometry.board import Board
from vergence.geometry.head import camera_pose_in_base
from vergence.geometry.se3 import inverse, pose
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
        self._width_m = BOARD.square_m * self._picture.shape[1] / SQUARE
        self._slopes = {n: sample_slopes(m.intrinsics) for n, m in self.truth.cameras.items()}

    @classmethod
    def drawn(cls, seed: int) -> "tuple[DrawnHead, CaptureSettings]":
        """Make a head and the settings of its capture."""
        bare, settings = simulated(seed, 0.006)
        head = cls(bare.truth, replace(bare.noise, joint_rad=0.0005), seed)
        head.prepare(settings)
        return head, settings

    def read(self, cameras: Sequence[str]) -> Frame:
        """Draw the images of a frame."""
        frame, images = super().read(cameras), {}
        for name in cameras:
            mounted = self.truth.camera(name)
            T = self.T_lbase_board
            T_base_target = T if mounted.eye == "left" else self.truth.T_rbase_lbase @ T
            T_cam_target = inverse(camera_pose_in_base(self.truth, name, self.joints))
            T_cam_card = T_cam_target @ T_base_target @ pose(t=POINTS.mean(axis=0))
            if T_cam_card[2, 3] < 0.1:  # behind the camera
                images[name] = np.full((*mounted.intrinsics.size[::-1], 3), 128, np.uint8)
                continue
            images[name] = draw_card(
                mounted.intrinsics,
                self._picture,
                T_cam_card,
                self._width_m,
                noise=self.rng,
                blur_px=0.6,
                slopes=self._slopes[name],
            )
        return replace(frame, images=images)

    def by_images(self, frame: Frame, board: Board, width_px: float):
        """Find the board in the drawn images."""
        return find_board(frame, board, width_px)

    def close(self) -> None: ...


def open_drawn() -> DrawnHead:
    """Open the driver."""
    head, _ = DrawnHead.drawn(1)
    return head
