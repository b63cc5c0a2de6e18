"""Stereo that follows moving eyes (Sec. II-C): pixels and joint readings in, points out.

Equation numbers are the paper's; docs/equations.md says where its printed forms were mended.
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.camera import Camera, normalised_rows
from vergence.geometry.head import HeadCalibration, MountedCamera, T_body_base, T_head_base
from vergence.geometry.projection import camera_poses, eye_poses, stereo_cameras
from vergence.geometry.se3 import cross, inverse, transform

CHUNK = 4096
"""Points at a time: their arrays stay in the processor's cache, and memory does not grow."""
PARALLEL_RAD = 1e-12
"""Angle between two rays that rounding errors make of none."""


class Status(IntEnum):
    """What became of one point."""

    OK = 0
    NOT_SEEN = 1
    """A pixel or a joint reading is NaN, or a pixel lies beyond the lens model's reach."""
    PARALLEL = 2
    """The two rays are parallel to within rounding errors."""
    BEHIND = 3
    """The rays meet behind a camera."""


def triangulate(
    *,
    left: Array,
    right: Array,
    left_camera: Camera,
    right_camera: Camera,
    T_rcam_lcam: Array,
    pixel_std_px: ArrayLike = 1.0,
) -> tuple[Array, np.ndarray]:
    """Solve Eqs. 3-4 for the points in the left camera's frame.

    Args:
        left: (N, 2) pixels in the left camera, distortion included; NaN: not seen.
        right: (N, 2) pixels in the right camera.
        T_rcam_lcam: (N, 4, 4) or (4, 4) pose of the left camera in the right one.
        pixel_std_px: noise of (left u, left v, right u, right v), of which only the ratios count: a
            number, (4,) or (N, 4).

    Returns:
        Points (N, 3) [m], NaN where the status is not OK, and the status (N,).
    """
    n = len(left)
    poses = np.zeros((3, 4, 2, n))
    poses[:, :3, 0] = np.eye(3)[..., None]
    T_lcam_rcam = np.broadcast_to(inverse(T_rcam_lcam), (n, 4, 4))
    poses[:, :, 1] = T_lcam_rcam[:, :3].transpose(1, 2, 0)
    cameras = left_camera, right_camera
    variances = pixel_variances(pixel_std_px, n)
    points, status = np.empty((n, 3)), np.empty(n, dtype=int)
    for part in chunks(n):
        pixels = left[part], right[part]
        found = intersect(cameras, pixels, poses[..., part], of_part(variances, part))
        points[part], status[part] = found[0].T, found[1]
    return points, status


def triangulate_at(
    head: HeadCalibration,
    *,
    left: Array,
    right: Array,
    joints: Array,
    cameras: tuple[str, str] | None = None,
    pixel_std_px: ArrayLike = 1.0,
) -> tuple[Array, np.ndarray]:
    """Return points in the left eye's base frame, and their status (Eqs. 3, 4 and 11).

    Points are (N, 3) [m], NaN where the status (N,) is not OK. Arguments and errors are those of
    `uncertainty.locate`, and the noise that of `triangulate`.
    """
    left, right, joints = checked(left, right, joints, len(head.kinematics.readings))
    pair, n = stereo_cameras(head, cameras), len(left)
    variances = pixel_variances(pixel_std_px, n)
    points, status = np.empty((n, 3)), np.empty(n, dtype=int)
    for part in chunks(n):
        T = eye_poses(head, readable(postures(joints, part)))
        pixels = left[part], right[part]
        found = rays_meet(pair, head.T_rbase_lbase, T, pixels, of_part(variances, part))
        points[part], status[part] = found[0].T, found[1]
    return points, status


def rays_meet(
    pair: tuple[MountedCamera, MountedCamera],
    T_rbase_lbase: Array,
    T: Array,
    pixels: tuple[Array, Array],
    variances: Array,
) -> tuple[Array, np.ndarray]:
    """Return points (3, N) in the left eye's base frame, and their status (N,).

    Args:
        pair: a left and a right camera.
        T: (N, 2, 4, 4) poses of the eyes, or (1, 2, 4, 4) for all.
        pixels: (N, 2) left and right.
        variances: (2, 2, N or 1) of the pixels: u or v, camera.
    """
    lenses = pair[0].intrinsics, pair[1].intrinsics
    return intersect(lenses, pixels, camera_poses(pair, T_rbase_lbase, T), variances)


def intersect(
    lenses: tuple[Camera, Camera], pixels: tuple[Array, Array], poses: Array, variances: Array
) -> tuple[Array, np.ndarray]:
    """Return where the rays of pixels meet (3, N), and the status (N,).

    Rays of noisy pixels pass each other. The pixels are first moved onto the epipolar lines of each
    other, by the least sum of squares relative to their variances (Sampson's correction, to first
    order the maximum of the likelihood); then the rays meet in a point, by cross products.

    Args:
        pixels: (N, 2) left and right, distortion included.
        poses: (3, 4, 2, N or 1) of the cameras, in the frame of the points.
        variances: (2, 2, N or 1) of the pixels: u or v, camera.
    """
    n = len(pixels[0])
    xy, slopes = np.empty((2, 2, n)), np.empty((2, 2, 2, n))
    for k in (0, 1):
        xy[:, k], slopes[:, :, k] = normalised_rows(lenses[k], pixels[k].T)
    across, centres = poses[:, :2], poses[:, 3]
    rays = np.add.reduce(across * xy, axis=1) + poses[:, 2]
    base = centres[:, 1:] - centres[:, :1]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        # gap = left ray . (right ray x base), and its derivatives by the pixels.
        normals = cross(rays[:, ::-1], base, axis=0) * _SIGNS
        gap = np.add.reduce(rays[:, 0] * normals[:, 0])
        by_x, by_y = np.add.reduce(across * normals[:, None], axis=0)
        (a, b), (c, d) = slopes
        det = a * d - b * c
        by_u, by_v = (d * by_x - c * by_y) / det, (a * by_y - b * by_x) / det
        u, v = by_u * variances[0], by_v * variances[1]
        factor = gap / np.add.reduce(u * by_u + v * by_v) / det
        rays -= across[:, 0] * (factor * (d * u - b * v)) + across[:, 1] * (
            factor * (a * v - c * u)
        )
        left, right = rays[:, 0], rays[:, 1]
        normal = cross(left, right, axis=0)
        size = np.add.reduce(normal * normal)
        # base = s left - r right, the one of (s, r) by its cross product with the other's ray.
        depths = np.add.reduce(cross(base, rays[:, ::-1], axis=0) * normal[:, None]) / size
        points = centres[:, 0] + depths[0] * left
        parallel = size <= PARALLEL_RAD**2 * np.multiply(*np.add.reduce(rays * rays))
    status = np.where(
        parallel, Status.PARALLEL, np.where((depths <= 0).any(axis=0), Status.BEHIND, 0)
    )
    status[~np.isfinite(rays[0, 0] + rays[0, 1])] = Status.NOT_SEEN
    points[:, status != Status.OK] = np.nan
    return points, status


_SIGNS = np.array([[1.0], [-1.0]])


def chunks(n: int) -> Iterator[slice]:
    """Yield slices of at most CHUNK that together are range(n)."""
    for start in range(0, n, CHUNK):
        yield slice(start, min(start + CHUNK, n))


def postures(joints: Array, part: slice) -> Array:
    """Return the readings, or measured poses, of a chunk: (n, r) or (n, 2, 4, 4); n may be 1."""
    if joints.ndim in (1, 3):
        return joints[None]
    return joints[part]


def readable(joints: Array) -> Array:
    """Return readings (n, r), or poses (n, 2, 4, 4); all of a posture is NaN if one number is."""
    finite = np.isfinite(joints)
    if finite.all():
        return joints
    usable = finite.reshape(len(joints), -1).all(axis=1)
    return np.where(usable.reshape(-1, *(1,) * (joints.ndim - 1)), joints, np.nan)


def pixel_variances(pixel_std_px: ArrayLike, n: int) -> Array:
    """Return variances (2, 2, N or 1) of pixels, u or v and camera, as weights of a triangulation.

    Noise is a number, (4,) or (N, 4) in the order (left u, left v, right u, right v). All ones
    where some of it is zero: with an exact pixel there are no ratios.
    """
    variances = np.square(np.atleast_2d(np.asarray(pixel_std_px, dtype=float)))
    if not (variances > 0).all():
        variances = np.ones((1, 1))
    return np.broadcast_to(variances, (len(variances), 4)).T.reshape(2, 2, -1).swapaxes(0, 1)


def of_part(variances: Array, part: slice) -> Array:
    """Return the variances of a chunk; (..., 1) are those of all points."""
    return variances if variances.shape[-1] == 1 else variances[..., part]


def checked(left: Array, right: Array, joints: Array, r: int) -> tuple[Array, Array, Array]:
    """Return float arrays; VergenceError if they are not (N, 2), (N, 2) and readings.

    These are angles (r,) or (N, r), or measured eye poses (2, 4, 4) or (N, 2, 4, 4).
    """
    left, right, joints = (np.asarray(each, dtype=float) for each in (left, right, joints))
    n = len(left) if left.ndim else 0
    for name, array, shapes in (
        ("left", left, [(n, 2)]),
        ("right", right, [(n, 2)]),
        ("joints", joints, [(n, r), (r,), (n, 2, 4, 4), (2, 4, 4)]),
    ):
        if array.shape not in shapes:
            raise VergenceError(
                f"Locating {n} points needs {name} of shape {' or '.join(map(str, shapes))}, found "
                f"{array.shape}."
            )
    return left, right, joints


def in_head(head: HeadCalibration, points_lbase: Array) -> Array:
    """Map points (..., 3) [m] from the left eye's base frame into frame head."""
    return transform(T_head_base(head, "left"), points_lbase)


def in_body(head: HeadCalibration, points_lbase: Array, neck_angles: Array) -> Array:
    """Eq. 12: map points (..., 3) [m] from the left eye's base frame into frame body.

    The neck's angles (..., n) [rad] are in the order of its chain.
    """
    return transform(T_body_base(head, "left", neck_angles), points_lbase)
