"""Located points with their derivatives by all that they depend on.

`uncertainty` makes covariances of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from vergence.arrays import Array
from vergence.geometry.head import HeadCalibration, main_pair
from vergence.geometry.parameters import camera_columns, parameter_names
from vergence.geometry.projection import (
    by_parameters,
    eye_poses_with_jacobians,
    project_with_jacobians,
    stereo_cameras,
)
from vergence.geometry.se3 import cross
from vergence.stereo.triangulation import checked, pixel_variances, rays_meet, readable


@lru_cache(maxsize=64)
def pair_parameters(head: HeadCalibration, cameras: tuple[str, str] | None) -> tuple[str, ...]:
    """Return the names of the P parameters that the points of a pair of cameras depend on."""
    stereo_cameras(head, cameras)
    names, pair = parameter_names(head), cameras or main_pair(head) or ()
    both = np.unique(np.concatenate([camera_columns(head, name) for name in pair]))
    return tuple(names[k] for k in both)


@lru_cache(maxsize=64)
def pair_columns(
    head: HeadCalibration, cameras: tuple[str, str] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return where the columns of each camera are among the `pair_parameters`."""
    names = pair_parameters(head, cameras)
    everything = parameter_names(head)
    place = {everything.index(name): k for k, name in enumerate(names)}
    left, right = (
        np.array([place[k] for k in camera_columns(head, name)])
        for name in cameras or main_pair(head) or ()
    )
    return left, right


@dataclass(frozen=True, eq=False)
class Linearised:
    """n located points, and how they change with all that they depend on, components first.

    To first order: of rays that pass each other far off, derivatives are those of rays that meet.
    NaN: not located.
    """

    points: Array
    """(3, n)."""
    status: np.ndarray
    """(n,)."""
    by_pixels: Array
    """(3, 4, n) with left u, left v, right u, right v."""
    by_readings: Array
    """(3, r, n) with the readings, or the increments of both measured poses (r = 12)."""
    pixels_by_head: tuple[Array, ...]
    """(2, p, n) by camera, of its pixels by its `parameters.camera_columns`; empty where they are
    not wanted."""


def by_head_parameters(
    head: HeadCalibration, cameras: tuple[str, str] | None, seen: Linearised
) -> Array:
    """Return how points change (3, P, n) with the P `pair_parameters`."""
    total = np.zeros((3, len(pair_parameters(head, cameras)), seen.points.shape[1]))
    for k, (rows, columns) in enumerate(
        zip(seen.pixels_by_head, pair_columns(head, cameras), strict=True)
    ):
        # The point makes up for what changes, so that its projection stays where it was seen.
        total[:, columns] -= matrix_products(seen.by_pixels[:, 2 * k : 2 * k + 2], rows)
    return total


def linearised(
    head: HeadCalibration,
    *,
    left: Array,
    right: Array,
    joints: Array,
    cameras: tuple[str, str] | None = None,
) -> Linearised:
    """Return points and all their derivatives, for as many points as memory has room for.

    Pixels count equally. Arguments and errors are those of `locate`.
    """
    left, right, joints = checked(left, right, joints, len(head.kinematics.readings))
    joints = joints[None] if joints.ndim in (1, 3) else joints
    weights = pixel_variances(1.0, len(left))
    return weighted_linearised(head, (left, right), joints, cameras, weights, parameters=True)


def weighted_linearised(
    head: HeadCalibration,
    pixels: tuple[Array, Array],
    joints: Array,
    cameras: tuple[str, str] | None,
    variances: Array,
    *,
    parameters: bool,
) -> Linearised:
    """Locate points; `parameters`: whether the derivatives by the head's are wanted too.

    Joints are (n, ...) or (1, ...), variances those of `triangulation.rays_meet`.
    """
    pair = stereo_cameras(head, cameras)
    joints = readable(joints)
    T, by_axes, by_reading = eye_poses_with_jacobians(head, joints, len(joints))
    points, status = rays_meet(pair, head.T_rbase_lbase, T, pixels, variances)
    one = len(joints) == 1
    arranged = points.T[None] if one else points.T[:, None]  # postures, points in each
    J = [
        project_with_jacobians(each, head.T_rbase_lbase, T[:, k], arranged, parameters=parameters)
        for k, each in enumerate(pair)
    ]

    def flat(rows: Array) -> Array:
        """Return rows (M, K, a, b) of derivatives with their components first: (a, b, n)."""
        return rows.transpose(2, 3, 0, 1).reshape(*rows.shape[2:], -1)

    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        by_pixels = _by_pixels(flat(J[0].by_point), flat(J[1].by_point), variances)
    by_readings, rows = 0.0, []
    for k in (0, 1):
        # The point makes up for what changes, so that its projection stays where it was seen.
        by_pose = matrix_products(by_pixels[:, 2 * k : 2 * k + 2], flat(J[k].by_T_base_eye))
        by_readings = by_readings - matrix_products(by_pose, by_reading[:, k].transpose(1, 2, 0))
        if parameters:
            rows.append(flat(by_parameters(J[k], by_axes[k])))
    return Linearised(points, status, by_pixels, by_readings, tuple(rows))


def matrix_products(rows: Array, matrix: Array) -> Array:
    """Return the products (a, c, n) of matrices (a, b, n) and (b, c, n)."""
    total = rows[:, 0, None] * matrix[0]
    for k in range(1, len(matrix)):
        total += rows[:, k, None] * matrix[k]
    return total


def _by_pixels(left: Array, right: Array, variances: Array) -> Array:
    """Return the derivatives (3, 4, n) of located points by their pixels.

    Given are those of the pixels by the point (2, 3, n), and the variances of
    `triangulation.rays_meet`. Three pixel coordinates make a point: both of the left image, and in
    the right one that along the epipolar line. The fourth says by how much the rays miss each
    other, and the pixels share this in proportion to their variances.
    """
    a, b = left
    along = cross(a, b, axis=0)  # the left ray
    m1, m2 = np.add.reduce(right * along, axis=1)
    c, d = m1 * right[0] + m2 * right[1], m1 * right[1] - m2 * right[0]
    by_a, by_b = cross(b, c, axis=0), cross(c, a, axis=0)
    scale = 1 / (m1 * m1 + m2 * m2)
    by_pixels = np.empty((3, 4, len(m1)))
    by_pixels[:, 0], by_pixels[:, 1] = by_a * scale, by_b * scale
    along = along * scale
    by_pixels[:, 2], by_pixels[:, 3] = along * m1, along * m2
    miss = np.empty((4, len(m1)))
    miss[0] = -np.add.reduce(d * by_pixels[:, 0])
    miss[1] = -np.add.reduce(d * by_pixels[:, 1])
    miss[2], miss[3] = -m2, m1
    shares = miss * variances.swapaxes(0, 1).reshape(4, -1)
    shares /= np.add.reduce(shares * miss)
    return by_pixels - np.add.reduce(by_pixels * shares, axis=1)[:, None] * miss
