"""The adjustment behind `refine`: its unknowns and its residuals.

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
from vergence.data import timing
from vergence.data.timing import Stencil
from vergence.geometry.camera import Camera, project
from vergence.geometry.kinematics import EYES, EyeAxes
from vergence.geometry.se3 import inverse, pose, rotation, rotvec, transform

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
    spread: Array
    """(M,) by what factor the corners of a detection scatter more than those of a typical one."""
    block_view: Index
    """(B,)."""
    block_eye: Index
    """(B,) 0 or 1."""
    reading: Array
    """(B, n) angles [rad]; zeros for eye poses."""
    around: Stencil | None
    """The neighbours of each block in time; None: the eyes stood still."""
    course: Array
    """(B, n, timing.DEGREE) how the latent unknowns go on in time; see followed."""
    read_well: NDArray[np.bool_]
    """(n,) of which joints the readings know the course better than the images do."""
    poses: Array | None
    """(B, 4, 4) T_base_eye as read; None: pan and tilt."""
    shared_px: float
    """The errors that all images of a camera share are at least so large."""
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
    """Return (B, n): by how much the noise-free readings differ from the readings.

    The latent angles are those of the image's moment, which is time_offset_s after the reading's.
    """
    return state.latent + timing.change(problem.course, -state.time_offset_s) - problem.reading


def joint_rates(problem: Problem, state: State) -> Array:
    """Return (B, n): how fast the joints moved when they were read [1/s]."""
    return timing.rate(problem.course, -state.time_offset_s)


def followed(problem: Problem, state: State) -> Problem:
    """Return the problem with the eyes' course in time taken from the latent angles.

    These know the images: they are nearer to the truth than readings, whose noise would make the
    eyes look faster, and the time offset smaller, than it is. Where readings are the better ones
    the course is theirs, for what follows from itself need not settle.
    """
    if problem.around is None:
        return problem
    latent = timing.coefficients(problem.around, state.latent)
    # Seen from the reading's moment time runs the other way: odd powers keep their sign.
    sign = -((-1.0) ** np.arange(1, timing.DEGREE + 1))
    reading = sign * timing.coefficients(problem.around, problem.reading)
    return replace(problem, course=np.where(problem.read_well[:, None], reading, latent))


def eye_poses(problem: Problem, state: State) -> Array:
    """Return T_base_eye (B, 4, 4) at the latent joint angles (the paper's T_er)."""
    R, t, _ = eye_parts(problem, state)
    return pose(R, t)


def eye_parts(problem: Problem, state: State) -> tuple[Array, Array, Array]:
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
