"""The adjustment behind `refine`: its unknowns, its residuals and their analytic derivatives.

A corner P of a board passes through
`p_cam = T_cam_eye T_eye_base(u) T_base_lbase T_lbase_target P`, and then through the lens. The
unknowns fall into two kinds:

- *shared* ones, in one vector named by `calibration_names`: for each camera
  fx, fy, cx, cy [px], k1, k2, p1, p2, k3 and the 6 of T_eye_cam; the 6 of T_rbase_lbase; the 6
  fields of EyeAxes for each eye; the time offset [s]; the 6 of each placement of the board,
  T_lbase_target, which follow without names;
- *latent* ones, n for each eye in each view: the readings u [rad] of pan and tilt as they would be
  without noise (n = 2) or, for eye poses given as 4x4 matrices, their errors (n = 6). An eye in a
  view is a *block*: every residual meets one block only, so blocks are eliminated one by one.

A change of a pose T_a_b is (rotation, translation) along the axes of frame a: R_a_b becomes
exp(rotation) R_a_b and t_a_b becomes t_a_b + translation; see `pose_difference`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from vergence.arrays import Array
from vergence.camera import Camera, project, project_jacobians
from vergence.geometry import hat, inverse, pose, rotation, rotvec, transform
from vergence.kinematics import EYES, EyeAxes

Index = NDArray[np.intp]

INTRINSICS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
POSE = ("rx", "ry", "rz", "tx", "ty", "tz")
AXES = tuple(field.name for field in fields(EyeAxes))
PER_CAMERA = len(INTRINSICS) + len(POSE)


@dataclass(frozen=True, eq=False)
class Problem:
    """What is given. M detections of a board with K corners, C cameras, B blocks, P placements."""

    cameras: tuple[str, ...]
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
    """(M, K, 3) the corners in frame target [m]."""
    block_view: Index
    """(B,)."""
    block_eye: Index
    """(B,) 0 or 1."""
    reading: Array
    """(B, n) angles [rad]; zeros for eye poses."""
    rate: Array
    """(B, n) by which the reading changes [1/s]."""
    poses: Array | None
    """(B, 4, 4) T_base_eye as read; None: pan and tilt."""
    free: NDArray[np.bool_]
    """(G,) which shared unknowns may change."""


@dataclass(frozen=True, eq=False)
class State:
    """Values of all unknowns."""

    lenses: tuple[Camera, ...]
    T_eye_cam: Array
    """(C, 4, 4)."""
    T_rbase_lbase: Array
    """(4, 4)."""
    axes: Array
    """(2, 6) the fields of EyeAxes, left eye and right eye."""
    time_offset_s: float
    """An image shows the joints this much later than their reading."""
    T_lbase_target: Array
    """(P, 4, 4)."""
    latent: Array
    """(B, n)."""


def size(problem: Problem) -> int:
    """Return G, the number of shared unknowns."""
    return len(problem.free)


def calibration_size(problem: Problem) -> int:
    """Return how many shared unknowns belong to the head; those of the placements follow."""
    return PER_CAMERA * len(problem.cameras) + len(POSE) + 2 * len(AXES) + 1


def calibration_names(cameras: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the shared unknowns of a head with these cameras, in their order."""
    own = (*INTRINSICS, *(f"T_eye_cam.{name}" for name in POSE))
    return (
        *(f"{camera}.{name}" for camera in cameras for name in own),
        *(f"T_rbase_lbase.{name}" for name in POSE),
        *(f"{eye}.{name}" for eye in EYES for name in AXES),
        "time_offset_s",
    )


def axes_row(axes: EyeAxes) -> list[float]:
    """Return the fields of EyeAxes in the order of AXES."""
    return [getattr(axes, name) for name in AXES]


def pose_difference(T: Array, T_reference: Array) -> Array:
    """Return (..., 6) rotation [rad] and translation [m] that turn T_reference into T.

    Both along the axes of the frame that T maps into: what the covariances of poses speak of.
    """
    R = T[..., :3, :3] @ np.swapaxes(T_reference[..., :3, :3], -1, -2)
    return np.concatenate([rotvec(R), T[..., :3, 3] - T_reference[..., :3, 3]], axis=-1)


def moved(T: Array, change: Array) -> Array:
    """Return T (..., 4, 4) changed by (..., 6); the inverse of pose_difference."""
    return pose(rotation(change[..., :3]) @ T[..., :3, :3], T[..., :3, 3] + change[..., 3:])


def lens_vector(camera: Camera) -> Array:
    """Return (9,) in the order of INTRINSICS."""
    K = camera.matrix
    return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *camera.distortion])


def changed_lens(camera: Camera, change: Array) -> Camera:
    """Return a camera changed by (9,); its skew stays."""
    fx, fy, cx, cy, *distortion = lens_vector(camera) + change
    matrix = np.array([[fx, camera.matrix[0, 1], cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return replace(camera, matrix=matrix, distortion=np.array(distortion))


def advance(problem: Problem, state: State, shared: Array, latent: Array) -> State:
    """Return the state changed by (G,) and (B, n).

    Raises:
        ValueError: a focal length would not stay positive.
    """
    C = len(problem.cameras)
    per_camera = shared[: PER_CAMERA * C].reshape(C, PER_CAMERA)
    rest = shared[PER_CAMERA * C :]
    return State(
        tuple(changed_lens(*pair) for pair in zip(state.lenses, per_camera[:, :9], strict=True)),
        moved(state.T_eye_cam, per_camera[:, 9:]),
        moved(state.T_rbase_lbase, rest[:6]),
        state.axes + rest[6:18].reshape(2, 6),
        state.time_offset_s + float(rest[18]),
        moved(state.T_lbase_target, rest[19:].reshape(-1, 6)),
        state.latent + latent,
    )


def joint_errors(problem: Problem, state: State) -> Array:
    """Return (B, n): by how much the noise-free readings differ from the readings."""
    return state.latent - problem.reading - state.time_offset_s * problem.rate


def eye_poses(problem: Problem, state: State) -> Array:
    """Return T_base_eye (B, 4, 4) at the latent joint angles (the paper's T_er)."""
    R, t, _ = _eyes(problem, state)
    return pose(R, t)


def _eyes(problem: Problem, state: State) -> tuple[Array, Array, Array]:
    """Return R_base_eye (B, 3, 3), t_base_eye (B, 3), R_base_pan (B, 3, 3) of every block."""
    if problem.poses is not None:
        T = moved(problem.poses, state.latent)
        return T[:, :3, :3], T[:, :3, 3], T[:, :3, :3]
    axes = state.axes[problem.block_eye]
    angles = axes[:, :2] * state.latent + axes[:, 2:4]
    tilt_axis = np.stack([np.zeros(len(axes)), np.cos(axes[:, 4]), np.sin(axes[:, 4])], axis=-1)
    R_pan = rotation(angles[:, :1] * [0.0, 0.0, 1.0])
    return R_pan @ rotation(angles[:, 1:] * tilt_axis), R_pan[:, :, 0] * axes[:, 5:], R_pan


def corner_errors(problem: Problem, state: State) -> Array:
    """Return (M, K, 2) [px], projected minus seen: 0 if not seen, NaN if not before the camera."""
    T_base_eye = eye_poses(problem, state)[problem.block]
    T_base_cam = T_base_eye @ state.T_eye_cam[problem.camera]
    right = problem.eye[problem.camera] == 1
    T_base_lbase = np.where(right[:, None, None], state.T_rbase_lbase, np.eye(4))
    T_cam_target = inverse(T_base_cam) @ T_base_lbase @ state.T_lbase_target[problem.placement]
    points = transform(T_cam_target[:, None], problem.points)
    projected = np.empty_like(problem.pixels)
    for c, lens in enumerate(state.lenses):
        chosen = problem.camera == c
        projected[chosen] = project(lens, points[chosen])
    return np.where(problem.seen[..., None], projected - problem.pixels, 0.0)


def jacobians(problem: Problem, state: State) -> tuple[Array, Index, Array]:
    """Return the derivatives of corner_errors.

    Returns:
        (M, K, 2, 33) by the shared unknowns that a detection meets, (M, 33) which these are, and
        (M, K, 2, n) by the latent ones of its block. Zero where a corner is not seen.
    """
    camera, block = problem.camera, problem.block
    right = problem.eye[camera] == 1
    R_eye, t_eye, R_pan = (array[block][:, None] for array in _eyes(problem, state))
    R_rl = np.where(right[:, None, None], state.T_rbase_lbase[:3, :3], np.eye(3))[:, None]
    t_rl = np.where(right[:, None], state.T_rbase_lbase[:3, 3], 0.0)[:, None]
    T_target = state.T_lbase_target[problem.placement][:, None]
    T_mount = state.T_eye_cam[camera][:, None]

    p_turned = _apply(T_target[..., :3, :3], problem.points)
    p_lbase = p_turned + T_target[..., :3, 3]
    p_swung = _apply(R_rl, p_lbase)
    p_arm = p_swung + t_rl - t_eye  # from the eye's origin, along the axes of its base
    p_eye = _apply(_t(R_eye), p_arm)
    p_mount = p_eye - T_mount[..., :3, 3]
    p_cam = _apply(_t(T_mount[..., :3, :3]), p_mount)

    M, K = problem.seen.shape
    by_point, by_lens = np.empty((M, K, 2, 3)), np.empty((M, K, 2, 9))
    for c, lens in enumerate(state.lenses):
        chosen = camera == c
        _, by_point[chosen], by_lens[chosen] = project_jacobians(lens, p_cam[chosen])

    by_eye = by_point @ _t(T_mount[..., :3, :3])
    by_base = by_eye @ _t(R_eye)
    by_lbase = by_base @ R_rl
    by_mount = np.concatenate([by_eye @ hat(p_mount), -by_eye], axis=-1)
    by_rl = np.concatenate([-by_base @ hat(p_swung), by_base], axis=-1) * right[:, None, None, None]
    by_target = np.concatenate([-by_lbase @ hat(p_turned), by_lbase], axis=-1)
    if problem.poses is None:
        by_axes, by_latent = _joint_jacobians(problem, state, by_eye, p_eye, p_arm, R_eye, R_pan)
    else:
        turn = by_base @ hat(p_arm) @ _left_jacobian(state.latent[:, :3])[block][:, None]
        by_latent = np.concatenate([turn, -by_base], axis=-1)
        by_axes = np.zeros((M, K, 2, 6))

    C = len(problem.cameras)
    head = PER_CAMERA * C
    index = np.concatenate(
        [
            PER_CAMERA * camera[:, None] + np.arange(PER_CAMERA),
            np.broadcast_to(head + np.arange(6), (M, 6)),
            head + 6 + 6 * problem.eye[camera][:, None] + np.arange(6),
            calibration_size(problem) + 6 * problem.placement[:, None] + np.arange(6),
        ],
        axis=1,
    )
    shared = np.concatenate([by_lens, by_mount, by_rl, by_axes, by_target], axis=-1)
    seen = problem.seen[..., None, None]
    return np.where(seen, shared, 0.0), index, np.where(seen, by_latent, 0.0)


def _joint_jacobians(
    problem: Problem,
    state: State,
    by_eye: Array,
    p_eye: Array,
    p_arm: Array,
    R_eye: Array,
    R_pan: Array,
) -> tuple[Array, Array]:
    """Return derivatives by the 6 fields of EyeAxes and by the 2 latent readings.

    p_eye = R_tilt^T q with q = R_pan^T p_arm, and R_tilt = Rx(e) Ry(tilt) Rx(-e) where e is the
    non-orthogonality, from which the derivative by e follows.
    """
    axes = state.axes[problem.block_eye][problem.block]
    latent = state.latent[problem.block]
    x, z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    tilt_axis = np.stack([np.zeros(len(axes)), np.cos(axes[:, 4]), np.sin(axes[:, 4])], axis=-1)
    R_tilt_T = _t(R_eye) @ R_pan
    q = _apply(_t(R_pan), p_arm)
    ahead = q + axes[:, None, 5:] * x  # the tilt axis travels with pan
    by_pan = -_apply(R_tilt_T, np.cross(z, ahead))
    by_tilt = -np.cross(tilt_axis[:, None], p_eye)
    by_skew = np.cross(x, p_eye) - _apply(R_tilt_T, np.cross(x, q))
    by_distance = np.broadcast_to(-_apply(R_tilt_T, x), p_eye.shape)
    columns = np.stack([by_pan, by_tilt, by_skew, by_distance], axis=-1)  # (M, K, 3, 4)
    pan_tilt, others = np.split(by_eye @ columns, 2, axis=-1)
    by_axes = np.concatenate([pan_tilt * latent[:, None, None], pan_tilt, others], axis=-1)
    return by_axes, pan_tilt * axes[:, None, None, :2]


def _left_jacobian(phi: Array) -> Array:
    """Return (B, 3, 3): exp(phi + d) = exp(J d) exp(phi); a series, for turns well below 1 rad."""
    term = np.broadcast_to(np.eye(3), (*phi.shape, 3))
    total = term.copy()
    for k in range(2, 12):
        term = term @ hat(phi) / k
        total += term
    return total


def _apply(R: Array, points: Array) -> Array:
    return (R @ points[..., None])[..., 0]


def _t(R: Array) -> Array:
    return np.swapaxes(R, -1, -2)
