"""The twin before a person who holds the board where he is asked to, for guided capture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from vergence.arrays import Array
from vergence.data.dataset import Frame
from vergence.files import write_json
from vergence.geometry.se3 import pose
from vergence.live.capture import CaptureState
from vergence.twin.calibration_sequence import BOARD, board_as_given
from vergence.twin.evaluation import TRUTH, Truth
from vergence.twin.head import Twin
from vergence.twin.record import describe_twin
from vergence.twin.sensors import with_sensors
from vergence.twin.simulated_robot import SimulatedHead

MOVE_S, AGAIN_S = 2.0, 4.0
"""Time in which the person moves the board, and after which he tries again: assumed [s]."""
ERROR_M, ERROR_RAD = 0.03, float(np.radians(10))
"""Root mean square distance [m] and turn [rad] from where he is asked to hold it: assumed."""
BEHIND = pose(t=[-1.0, 0.0, 0.0])
"""Where the board is first, in the left eye's base: out of sight."""


class Person:
    """Holds a board where he is asked to, roughly, and tries again after a while."""

    def __init__(self, seed: int):
        """Begin with the board out of sight; the seed is that of the errors."""
        self._rng = np.random.default_rng([seed, 9])
        self._from, self._to, self._wanted = BEHIND, BEHIND, BEHIND
        self._begin_s, self._arrives_s = 0.0, 0.0

    def ask(self, T_lbase_target: Array, board_stays: bool, time_s: float) -> None:
        """Ask for the board at a pose (4, 4) in the left eye's base, or where it is now."""
        new = bool((T_lbase_target != self._wanted).any())
        if board_stays or (not new and time_s < self._arrives_s + AGAIN_S):
            return
        self._wanted, self._from = T_lbase_target, self.board(time_s)
        shift = self._rng.normal(0, ERROR_M / np.sqrt(3), 3)
        turn = Rotation.from_rotvec(self._rng.normal(0, ERROR_RAD / np.sqrt(3), 3))
        R = turn.as_matrix() @ T_lbase_target[:3, :3]
        self._to = pose(R, T_lbase_target[:3, 3] + shift)
        self._begin_s, self._arrives_s = time_s, time_s + MOVE_S

    def follow(self, state: CaptureState, time_s: float) -> None:
        """Hold the board where the guide of a capture asks for it."""
        if state.sweep is None:
            view = state.asked[0]
            self.ask(view.T_lbase_target, view.board_stays, time_s)

    def board(self, time_s: float) -> Array:
        """Compute where the board is (4, 4) at a time."""
        part = float(np.clip((time_s - self._begin_s) / MOVE_S, 0.0, 1.0))
        both = Rotation.from_matrix(np.array([self._from[:3, :3], self._to[:3, :3]]))
        t = (1 - part) * self._from[:3, 3] + part * self._to[:3, 3]
        return pose(Slerp([0.0, 1.0], both)(part).as_matrix(), t)


class TwinBeforePerson(SimulatedHead):
    """The twin as a driver that describes its head, and a person before it."""

    frame_s = 0.1
    """Ten frames a second suffice to see that a board is at rest, and are rendered as quickly."""

    def __init__(self, twin: Twin, seed: int):
        """Restart the twin."""
        super().__init__(twin, 1, lambda _: None)
        self.limits = twin.limits
        board = board_as_given(twin.profile)
        self.description = describe_twin(twin.nominal, board, "Captured on the twin.")
        self.person, self._seed = Person(seed), seed

    def read(self, cameras: Sequence[str]) -> Frame | None:
        """Advance to the next frame; see `SimulatedHead`."""
        self.twin.place_board(self.person.board(self.now_s()))
        return super().read(cameras)

    def follow(self, state: CaptureState, frame: Frame) -> None:
        """Let the person follow the guide of a capture."""
        self.person.follow(state, self.now_s())

    def close(self) -> None:
        """Leave the twin as it is; who made it closes it."""

    def write_truth(self, folder: Path) -> None:
        """Write the true head into the folder of a dataset, for evaluation."""
        twin, joints = self.twin, self.twin.profile.joints
        truth = Truth(
            head=with_sensors(twin.truth, joints),
            time_offset_s=joints.delay_ms * 1e-3,
            eye_angles=np.empty((0, len(twin.truth.kinematics.readings))),
            T_lbase_target={},
            board=BOARD,
            seed=self._seed,
            lens=twin.head.lens,
            profile=twin.profile,
        )
        write_json(truth, folder / TRUTH)
