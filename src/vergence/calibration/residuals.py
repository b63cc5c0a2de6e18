"""What a calibration measures: corners, readings, poses of a target, and priors.

A corner P passes through `p_cam = T_cam_eye T_eye_base(u) T_base_lbase T_lbase_target P`, and then
through the lens. Shared unknowns are "head" (in the order of `geometry.parameters`), "boards"
(T_lbase_target of each placement) and "board_scale". Latent are the readings u [rad] without noise
or, for measured eye poses, their errors. Poses change by the increment of `se3.boxplus`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vergence.arrays import Array
from vergence.calibration.postures import Index, Postures
from vergence.estimation.residual import Residual, Rows
from vergence.estimation.variables import Variables
from vergence.geometry.batches import product, times
from vergence.geometry.eye_motion import eye_linearised
from vergence.geometry.head import MountedCamera
from vergence.geometry.kinematics import EYES, joint_names
from vergence.geometry.parameters import (
    camera_columns,
    lens_vector,
)
from vergence.geometry.projection import (
    by_pose_of_points,
    camera_pose,
    project_at,
    project_with_jacobians,
)
from vergence.geometry.se3 import boxminus, cross, hat, inverse

CORNERS = "corners"
"""Noise level of one coordinate of a corner, in a typical image [px]."""
TARGETS = "target poses"
"""Noise level of measured poses of a target, relative to their stated deviations."""
TARGET_TURNS, TARGET_SHIFTS = "target rotations", "target translations"
"""Noise levels [rad], [m] where no deviations are stated."""


@dataclass(frozen=True, eq=False)
class Detections:
    """M detections of a target by C cameras."""

    cameras: tuple[str, ...]
    """(C,) all cameras of the head."""
    eye: Index
    """(C,) 0 for the left eye, 1 for the right one."""
    camera: Index
    """(M,), in ascending order."""
    board: Index
    """(M,) placement of the target."""
    posture: Index
    """(M,)."""
    postures: Postures

    @property
    def eyes(self) -> Index:
        """(M,) the eye that made each detection, 0 or 1."""
        return self.eye[self.camera]

    @property
    def views(self) -> Index:
        """(M,)."""
        return self.postures.view[self.posture]

    def of_camera(self, c: int) -> slice:
        """Find which detections are those of a camera."""
        first, end = np.searchsorted(self.camera, [c, c + 1])
        return slice(first, end)

    def eye_poses(self, x: Variables) -> Array:
        """Compute T_base_eye (M, 4, 4)."""
        return self.postures.eye_poses(x)[self.eyes, self.posture]

    def eye_jacobians(self, x: Variables) -> tuple[list[Array], Array]:
        """Compute the derivatives of the eye poses.

        By the errors of the joints, for each eye (M, 6, a), and by the latent unknowns (M, 6, n).
        """
        kinematics, read = x["head"].kinematics, self.postures.T_base_eye_read
        if read is None:
            readings = self.postures.head_readings(x)
            linear = [
                eye_linearised(kinematics, eye, own)
                for eye, own in zip(EYES, readings, strict=True)
            ]
            by_readings = np.stack([linear[0][2], linear[1][2]])[self.eyes, self.posture]
            columns = self.postures.columns[self.posture][:, None, :]
            by_latent = np.take_along_axis(by_readings, columns, axis=2)
            of_other = self.postures.own == 1 - self.eyes[:, None]
            by_latent = np.where(of_other[:, None], 0.0, by_latent)
            return [each[1][self.posture] for each in linear], by_latent
        by_latent = left_jacobian(x.latent.value)[self.posture]
        M = len(self.posture)
        return [np.zeros((M, 6, len(joint_names(kinematics, eye)))) for eye in EYES], by_latent


def left_jacobian(xi: Array) -> Array:
    """Compute J (B, 6, 6) with boxplus(T, xi + d) = boxplus(boxplus(T, xi), J d)."""
    jacobian = np.tile(np.eye(6), (len(xi), 1, 1))
    term = jacobian[:, :3, :3].copy()
    for k in range(2, 12):  # the series of SO(3), for turns well below 1 rad
        term = term @ hat(xi[:, :3]) / k
        jacobian[:, :3, :3] += term
    return jacobian


@dataclass(frozen=True, eq=False, kw_only=True)
class Reprojection(Residual):
    """Corners of boards in images."""

    detections: Detections
    pixels: Array
    """(M, K, 2), 0 where a corner is not seen."""
    seen: NDArray[np.bool_]
    """(M, K)."""
    points: Array
    """(K, 3) the corners in frame target [m]."""
    noise_scale: Array
    """(M,) noise of the corners of an image relative to a typical one."""
    systematic_px: float = 0.0
    """Least smooth errors that all images of a camera share."""
    level: str = CORNERS
    together: int = 2
    weighs_rows: bool = True
    element: Index = field(init=False)

    def __post_init__(self) -> None:
        vars(self).update(element=self.detections.posture)

    def in_left_base(self, x: Variables) -> tuple[Array, Array]:
        """Place corners (M, K, 3) from the board's origin, and in the left eye's base frame."""
        T = x["boards"][self.detections.board]
        turned = x["board_scale"] * self.points @ np.swapaxes(T[:, :3, :3], 1, 2)
        return turned, turned + T[:, None, :3, 3]

    def error(self, x: Variables) -> Array:
        """Compute projected minus seen pixels (M, 2 K); NaN if not in front of the camera."""
        T, (_, points) = self.detections.eye_poses(x), self.in_left_base(x)
        head, projected = x["head"], np.empty_like(self.pixels)
        for c, mounted in enumerate(head.cameras.values()):
            mine = self.detections.of_camera(c)
            projected[mine] = project_at(mounted, head.T_rbase_lbase, T[mine], points[mine])
        errors = np.where(self.seen[..., None], projected - self.pixels, 0.0)
        return errors.reshape(len(errors), -1)

    def rows(self, x: Variables) -> Rows:
        """Compute the derivatives; the lens with the most coefficients sets their number."""
        head, detections, (M, K) = x["head"], self.detections, self.seen.shape
        columns = [camera_columns(head, name) for name in detections.cameras]
        s = max(map(len, columns)) + 7
        T, (turned, points) = detections.eye_poses(x), self.in_left_base(x)
        by_axes, by_eye_latent = detections.eye_jacobians(x)
        shared, latent = np.zeros((M, K, 2, s)), np.empty((M, K, 2, by_eye_latent.shape[-1]))
        index = np.zeros((M, s), dtype=np.intp)
        for c, mounted in enumerate(head.cameras.values()):
            mine = detections.of_camera(c)
            J = project_with_jacobians(mounted, head.T_rbase_lbase, T[mine][:, None], points[mine])
            end = 0
            for part in (
                J.by_lens,
                J.by_T_eye_cam,
                J.by_T_rbase_lbase,
                product(J.by_T_base_eye, by_axes[detections.eye[c]][mine][:, None]),
                by_pose_of_points(J.by_point, turned[mine]),
                times(J.by_point, turned[mine])[..., None] / x["board_scale"],
            ):
                shared[mine, ..., end : end + part.shape[-1]] = part
                end += part.shape[-1]
            latent[mine] = product(J.by_T_base_eye, by_eye_latent[mine][:, None])
            index[mine, :end] = target_columns(x, columns[c], detections.board[mine])
        shared[~self.seen], latent[~self.seen] = 0.0, 0.0
        return Rows(shared.reshape(M, 2 * K, s), index, latent.reshape(M, 2 * K, -1))


def target_columns(x: Variables, of_head: np.ndarray, board: Index) -> Index:
    """List the columns (M, a + 7): a parameters of the head, the board's pose, and its size."""
    head = np.broadcast_to(x.columns("head")[of_head], (len(board), len(of_head)))
    pose = x.columns("boards")[6 * board[:, None] + np.arange(6)]
    return np.concatenate([head, pose, np.tile(x.columns("board_scale"), (len(board), 1))], axis=1)


@dataclass(frozen=True, eq=False, kw_only=True)
class TargetPoses(Residual):
    """Measured poses of a target, as devices that track a body give them."""

    detections: Detections
    T_cam_target: Array
    """(M, 4, 4)."""
    whitening: Array
    """(M, 6, 6): turns errors, rotation [rad] and then translation [m] along the camera's axes,
    into independent ones of unit variance."""
    seen: NDArray[np.bool_]
    """(M, 6): false for poses that are left out."""
    level: str | tuple[str, ...] = TARGETS
    element: Index = field(init=False)

    def __post_init__(self) -> None:
        vars(self).update(element=self.detections.posture)

    def expected(self, x: Variables) -> Array:
        """Compute T_cam_target (M, 4, 4) by the unknowns."""
        head, d = x["head"], self.detections
        T_base_eye, boards = d.eye_poses(x), x["boards"][d.board]
        expected = np.empty_like(boards)
        for c, mounted in enumerate(head.cameras.values()):
            mine = d.of_camera(c)
            T = camera_pose(mounted, head.T_rbase_lbase, T_base_eye[mine])
            expected[mine] = inverse(T) @ boards[mine]
        return expected

    def error(self, x: Variables) -> Array:
        """Compute expected minus measured poses (M, 6) in stated standard deviations."""
        off = boxminus(self.expected(x), self.T_cam_target)
        return np.where(self.seen, (self.whitening @ off[..., None])[..., 0], 0.0)

    def rows(self, x: Variables) -> Rows:
        """Compute the derivatives by the mounting, the bases, the joints and the target."""
        head, d, M = x["head"], self.detections, len(self.whitening)
        names = list(head.cameras)
        columns = [camera_columns(head, name) for name in names]
        s = max(map(len, columns)) + 7
        T, boards = d.eye_poses(x), x["boards"][d.board]
        by_axes, by_eye_latent = d.eye_jacobians(x)
        shared, latent = np.zeros((M, 6, s)), np.zeros((M, 6, by_eye_latent.shape[-1]))
        index = np.zeros((M, s), dtype=np.intp)
        for c, mounted in enumerate(head.cameras.values()):
            mine = d.of_camera(c)
            by_camera, by_eye, between, by_board = target_pose_jacobians(
                mounted, head.T_rbase_lbase, T[mine], boards[mine]
            )
            lens, width = len(lens_vector(mounted.intrinsics)), len(columns[c]) + 7
            by_joints = by_eye @ by_axes[d.eye[c]][mine]
            parts = [by_camera, between, by_joints, by_board]
            shared[mine, :, lens : width - 1] = np.concatenate(parts, axis=-1)
            latent[mine] = by_eye @ by_eye_latent[mine]
            index[mine, :width] = target_columns(x, columns[c], d.board[mine])
        return Rows(self._whitened(x, shared), index, self._whitened(x, latent))

    def _whitened(self, x: Variables, rows: Array) -> Array:
        """Compute derivatives (M, 6, n) of the errors, by those of the increments of poses.

        The rotation of an error changes by the inverse of the left Jacobian of SO(3), here to the
        fourth order in an error that is far below 1 rad.
        """
        turn = boxminus(self.expected(x), self.T_cam_target)[:, :3]
        K, square = hat(turn), (turn**2).sum(axis=-1)[:, None, None]
        inner = rows.copy()
        inner[:, :3] += (-K / 2 + (1 / 12 + square / 720) * (K @ K)) @ rows[:, :3]
        return self.whitening @ inner


def target_pose_jacobians(
    mounted: MountedCamera, T_rbase_lbase: Array, T_base_eye: Array, T_lbase_target: Array
) -> tuple[Array, Array, Array, Array]:
    """Compute derivatives (M, 6, 6) of the increment of T_cam_target.

    By T_eye_cam, T_base_eye, T_rbase_lbase (zero for the left eye) and T_lbase_target.
    """
    right = mounted.eye == "right"
    origin = T_lbase_target[:, :3, 3]
    turned = origin @ T_rbase_lbase[:3, :3].T if right else origin
    in_base = turned + T_rbase_lbase[:3, 3] if right else turned
    arm = in_base - T_base_eye[:, :3, 3]
    R_base_eye = T_base_eye[:, :3, :3]
    from_camera = (arm[:, None] @ R_base_eye)[:, 0] - mounted.T_eye_cam[:3, 3]
    by_eye = np.broadcast_to(mounted.T_eye_cam[:3, :3].T, R_base_eye.shape)
    by_base = by_eye @ np.swapaxes(R_base_eye, 1, 2)
    by_lbase = by_base @ T_rbase_lbase[:3, :3] if right else by_base
    between = -_by_frame(by_base, turned) if right else np.zeros((len(origin), 6, 6))
    return (
        _by_frame(by_eye, from_camera),
        _by_frame(by_base, arm),
        between,
        -_by_frame(by_lbase, np.zeros_like(origin)),  # the target turns about its own origin
    )


def _by_frame(R: Array, arm: Array) -> Array:
    """Compute derivatives (M, 6, 6) of a target's pose by that of a frame before it.

    R (M, 3, 3) turns the increment's axes into those of the camera; arm (M, 3) leads from the
    frame's origin to the target's, along the increment's axes.
    """
    rows = np.zeros((len(arm), 6, 6))
    rows[:, :3, :3] = rows[:, 3:, 3:] = -R
    rows[:, 3:, :3] = cross(R, arm[:, None])
    return rows
