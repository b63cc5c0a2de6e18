"""The bundle adjustment of a whole head: its unknowns, its residuals and their derivatives.

A corner P of a board passes through
`p_cam = T_cam_eye T_eye_base(u) T_base_lbase T_lbase_target P`, and then through the lens. The
unknowns fall into two kinds:

- *shared* ones, in one vector: the parameters of the head in the order of
  `geometry.parameters.parameter_names`, then the 6 of each placement of the board, T_lbase_target,
  and last the size of the board, relative to the stated one;
- *latent* ones, n for each block: the readings u [rad] as they would be without noise or, for
  measured eye poses, their errors (n = 6). A *block* is an eye in a view, or both eyes where some
  reading moves both: every residual meets one block only, so blocks are eliminated one by one.

Poses change by the increment of `se3.boxplus`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vergence.arrays import Array
from vergence.calibration.bundle.measured_poses import (
    MeasuredPoses,
    expected_poses,
    pose_errors,
    pose_jacobians,
    whitened,
)
from vergence.calibration.bundle.read_motion import ReadMotion
from vergence.calibration.sequential.lens_prior import lens_prior
from vergence.data import timing
from vergence.data.timing import Stencil
from vergence.geometry import parameters
from vergence.geometry.eye_motion import eye_linearised
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES, T_base_eye
from vergence.geometry.parameter_names import joint_names
from vergence.geometry.parameters import camera_columns
from vergence.geometry.projection import (
    by_parameters,
    by_pose_of_points,
    project_at,
    project_with_jacobians,
    rows_times,
)
from vergence.geometry.se3 import boxplus, hat

Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class BundleProblem:
    """What is given. M detections of a board with K corners, C cameras, B blocks, P placements."""

    cameras: tuple[str, ...]
    """All cameras of the head."""
    parameters: tuple[str, ...]
    """Names of the shared unknowns that belong to the head, which come first."""
    eye: Index
    """(C,) 0 for the left eye, 1 for the right one."""
    camera: Index
    """(M,) which camera saw."""
    block: Index
    """(M,) in which block."""
    placement: Index
    """(M,) where the board stood."""
    pixels: Array
    """(M, K, 2), 0 where a corner is not seen."""
    seen: NDArray[np.bool_]
    """(M, K)."""
    points: Array
    """(K, 3) the corners in frame target [m]."""
    noise_scale: Array
    """(M,) by what factor the corners of a detection are noisier than those of a typical one."""
    block_view: Index
    """(B,)."""
    block_columns: Index
    """(B, n) which reading of the head each latent unknown is; of no meaning for measured poses."""
    reading: Array
    """(B, n) angles [rad]; zeros for measured eye poses."""
    around: Stencil | None
    """The neighbours of each block in time; None: the eyes stood still."""
    trajectory_coefficients: Array
    """(B, n, TRAJECTORY_DEGREE) how the latent unknowns go on in time; see refit_trajectory."""
    read_motion: ReadMotion | None
    """How the readings go on in time, by all rows of a recording; None: the eyes stood still."""
    trust_encoder: NDArray[np.bool_]
    """(n,) of which joints the readings know the trajectory better than the images do."""
    T_base_eye_read: Array | None
    """(B, 4, 4) measured poses of the eyes; None: pan and tilt."""
    systematic_px: float
    """The errors that all images of a camera share are at least so large."""
    free: NDArray[np.bool_]
    """(G,) which shared unknowns may change."""
    assumed: NDArray[np.bool_]
    """(C,) of which lenses `lens_prior` is assumed: those that may change and start within it."""
    measured: MeasuredPoses | None = None
    """Poses of a target, in place of the corners of boards: pixels are then zeros, and K is 3."""


@dataclass(frozen=True, eq=False)
class BundleState:
    """Values of all unknowns."""

    head: HeadCalibration
    T_lbase_target: Array
    """(P, 4, 4)."""
    latent: Array
    """(B, n)."""
    board_scale: float = 1.0
    """Size of the board relative to the stated one."""


def head_size(problem: BundleProblem) -> int:
    """Return how many shared unknowns belong to the head; those of the boards follow."""
    return len(problem.parameters)


def retract(
    problem: BundleProblem, state: BundleState, shared: Array, latent: Array
) -> BundleState:
    """Return the state changed by (G,) and (B, n); ValueError if a focal length gets negative."""
    c = head_size(problem)
    return BundleState(
        parameters.boxplus(state.head, shared[:c]),
        boxplus(state.T_lbase_target, shared[c:-1].reshape(-1, 6)),
        state.latent + latent,
        state.board_scale + float(shared[-1]),
    )


def reading_residuals(problem: BundleProblem, state: BundleState) -> Array:
    """Return (B, n): by how much the noise-free readings differ from the readings.

    The latent angles are those of the image's moment, which is time_offset_s after the reading's.
    """
    moved = timing.change(problem.trajectory_coefficients, -state.head.time_offset_s)
    return state.latent + moved - problem.reading


def prior(problem: BundleProblem, state: BundleState) -> tuple[float, Array, Array]:
    """Return the prior of all lenses: -2 log density, half its gradient (G,), information (G,)."""
    total, (half_gradient, information) = 0.0, np.zeros((2, len(problem.free)))
    for c, (name, mounted) in enumerate(state.head.cameras.items()):
        if problem.assumed[c]:
            own = lens_prior(mounted.intrinsics)
            columns = camera_columns(state.head, name)[: len(own[1])]
            total += own[0]
            half_gradient[columns], information[columns] = own[1:]
    return total, half_gradient, information


def joint_rates(problem: BundleProblem, state: BundleState) -> Array:
    """Return (B, n): how fast the joints moved when they were read [1/s]."""
    return timing.rate(problem.trajectory_coefficients, -state.head.time_offset_s)


def refit_trajectory(problem: BundleProblem, state: BundleState) -> BundleProblem:
    """Return the problem with the eyes' trajectory fitted to the latent angles.

    These know the images: they are nearer to the truth than readings, whose noise would make the
    eyes look faster, and the time offset smaller, than it is. Where the readings are the better
    ones the trajectory is theirs: fitted to what it determines itself, it might not settle. It is
    theirs too where the board is seldom seen.
    """
    if problem.around is None or problem.read_motion is None:
        return problem
    if problem.T_base_eye_read is None:
        latent = timing.coefficients(problem.around, state.latent)
    else:
        poses = boxplus(problem.T_base_eye_read, state.latent)
        latent = timing.pose_coefficients(problem.around, poses)
    reading, seldom_seen = problem.read_motion
    # Seen from the reading's moment time runs the other way: odd powers keep their sign.
    reading = reading * -((-1.0) ** np.arange(1, timing.TRAJECTORY_DEGREE + 1))
    chosen = np.where(problem.trust_encoder[:, None] | seldom_seen[:, None, None], reading, latent)
    return replace(problem, trajectory_coefficients=chosen)


def detection_eyes(problem: BundleProblem) -> Index:
    """Return (M,) the eye that made each detection, 0 or 1."""
    return problem.eye[problem.camera]


def detection_eye_poses(problem: BundleProblem, state: BundleState) -> Array:
    """Return T_base_eye (M, 4, 4) of each detection at the latent angles (the paper's T_er)."""
    if problem.T_base_eye_read is not None:
        return boxplus(problem.T_base_eye_read, state.latent)[problem.block]
    readings = latent_readings(problem, state)
    poses = np.stack([T_base_eye(state.head.kinematics, eye, readings) for eye in EYES])
    return poses[detection_eyes(problem), problem.block]


def latent_readings(problem: BundleProblem, state: BundleState) -> Array:
    """Return (B, r) the noise-free readings of the head; 0 for those that move no eye of a block.

    Not for measured poses.
    """
    full = np.zeros((len(state.latent), len(state.head.kinematics.readings)))
    np.put_along_axis(full, problem.block_columns, state.latent, axis=1)
    return full


def _eye_jacobians(problem: BundleProblem, state: BundleState) -> tuple[list[Array], Array]:
    """Return how the poses of the detections change.

    By the errors of the joints, for each eye (M, 6, a); and by the latent ones (M, 6, n).
    """
    block = problem.block
    if problem.T_base_eye_read is None:
        readings, eyes = latent_readings(problem, state), detection_eyes(problem)
        found = [eye_linearised(state.head.kinematics, eye, readings) for eye in EYES]
        by_readings = np.stack([found[0][2], found[1][2]])[eyes, block]
        columns = problem.block_columns[block][:, None, :]
        by_latent = np.take_along_axis(by_readings, columns, axis=2)
        return [each[1][block] for each in found], by_latent
    by_latent = np.tile(np.eye(6), (len(state.latent), 1, 1))
    # exp(phi + d) = exp(J d) exp(phi); J (B, 3, 3) by its series, for turns well below 1 rad.
    term = by_latent[:, :3, :3].copy()
    for k in range(2, 12):
        term = term @ hat(state.latent[:, :3]) / k
        by_latent[:, :3, :3] += term
    axes = [np.zeros((len(block), 6, len(joint_names(state.head.kinematics, eye)))) for eye in EYES]
    return axes, by_latent[block]


def _on_boards(problem: BundleProblem, state: BundleState) -> tuple[Array, Array]:
    """Return the corners (M, K, 3) from the board's origin, and in the left eye's base frame."""
    T = state.T_lbase_target[problem.placement]
    turned = state.board_scale * problem.points @ np.swapaxes(T[:, :3, :3], 1, 2)
    return turned, turned + T[:, None, :3, 3]


def _target_poses(problem: BundleProblem, state: BundleState, T_base_eye: Array) -> Array:
    """Return T_cam_target (M, 4, 4) as expected at eye poses (M, 4, 4)."""
    found, boards = np.empty_like(T_base_eye), state.T_lbase_target[problem.placement]
    for c, mounted in enumerate(state.head.cameras.values()):
        own = problem.camera == c
        found[own] = expected_poses(mounted, state.head.T_rbase_lbase, T_base_eye[own], boards[own])
    return found


def corner_errors(problem: BundleProblem, state: BundleState) -> Array:
    """Return (M, K, 2) [px], projected minus seen: 0 if not seen, NaN if not before the camera.

    Of measured poses (M, 3, 2), expected minus measured, in standard deviations.
    """
    T = detection_eye_poses(problem, state)
    if problem.measured is not None:
        errors = pose_errors(problem.measured, _target_poses(problem, state, T))
        return np.where(problem.seen[..., None], errors, 0.0)
    _, points = _on_boards(problem, state)
    projected = np.empty_like(problem.pixels)
    for c, mounted in enumerate(state.head.cameras.values()):
        own = problem.camera == c
        projected[own] = project_at(mounted, state.head.T_rbase_lbase, T[own], points[own])
    return np.where(problem.seen[..., None], projected - problem.pixels, 0.0)


def _pose_rows(
    problem: BundleProblem, state: BundleState, own: np.ndarray, by_axes: Array, by_latent: Array
) -> tuple[Array, Array]:
    """Return the derivatives of the errors of one camera's measured poses, which are `own` (M,).

    By what jacobians has of them, in its order: (m, 3, 2, s), and (m, 3, 2, n). Those of
    T_base_eye (M, 6, ...) are by the errors of the joints and by the latent unknowns.
    """
    assert problem.measured is not None
    mounted = state.head.cameras[problem.cameras[problem.camera[own][0]]]
    T = detection_eye_poses(problem, state)[own]
    boards = state.T_lbase_target[problem.placement[own]]
    placed = mounted, state.head.T_rbase_lbase, T, boards
    by_camera, by_eye, between, by_board = pose_jacobians(*placed)
    by_lens = np.zeros((len(T), 6, len(parameters.lens_vector(mounted.intrinsics))))
    by_size = np.zeros((len(T), 6, 1))
    rows = [by_lens, by_camera, between, by_eye @ by_axes[own], by_board, by_size]
    measured = MeasuredPoses(*(each[own] for each in vars(problem.measured).values()))
    expected = expected_poses(*placed)
    shared = whitened(measured, expected, np.concatenate(rows, axis=-1))
    return shared, whitened(measured, expected, by_eye @ by_latent[own])


def jacobians(problem: BundleProblem, state: BundleState) -> tuple[Array, Index, Array]:
    """Return the derivatives of corner_errors; zero where a corner is not seen.

    (M, K, 2, s) by the shared unknowns that a detection meets, (M, s) which these are, and (M, K,
    2, n) by the latent ones of its block. The lens with the most coefficients sets s; for others
    the last columns are zero.
    """
    M, K = problem.seen.shape
    columns = [camera_columns(state.head, name) for name in problem.cameras]
    s = max(map(len, columns)) + 7
    T, (turned, points) = detection_eye_poses(problem, state), _on_boards(problem, state)
    by_axes, by_latent = _eye_jacobians(problem, state)
    shared, latent = np.zeros((M, K, 2, s)), np.empty((M, K, 2, by_latent.shape[-1]))
    index = np.zeros((M, s), dtype=np.intp)
    for c, mounted in enumerate(state.head.cameras.values()):
        own = problem.camera == c
        width = len(columns[c]) + 7
        if problem.measured is not None and own.any():
            rows, moved = _pose_rows(problem, state, own, by_axes[problem.eye[c]], by_latent)
            shared[own, ..., :width], latent[own] = rows, moved
        else:
            J = project_with_jacobians(mounted, state.head.T_rbase_lbase, T[own], points[own])
            by_board = by_pose_of_points(J.by_point, turned[own])
            by_size = (J.by_point @ turned[own][..., None]) / state.board_scale
            shared[own, ..., :width] = np.concatenate(
                [by_parameters(J, by_axes[problem.eye[c]][own]), by_board, by_size], axis=-1
            )
            latent[own] = rows_times(J.by_T_base_eye, by_latent[own])
        index[own, : width - 7] = columns[c]
        board = head_size(problem) + 6 * problem.placement[own, None] + np.arange(6)
        index[own, width - 7 : width - 1] = board
        index[own, width - 1] = len(problem.free) - 1
    seen = problem.seen[..., None, None]
    return np.where(seen, shared, 0.0), index, np.where(seen, latent, 0.0)
