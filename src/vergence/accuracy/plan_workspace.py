"""Points of the workspace for which views are planned, and their derivatives by the head.

Points stand before the head, near to far, ahead and to the sides. Both eyes fixate each as nearly
as the limits of their joints allow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.arrays import Array
from vergence.calibration.summary import DISTANCES_M
from vergence.errors import VergenceError
from vergence.gaze.fixation import solve_fixation
from vergence.geometry.head import HeadCalibration, T_head_base
from vergence.geometry.kinematics import looking_along
from vergence.geometry.parameters import named_columns, parameter_names
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import inverse, transform
from vergence.stereo.linearised import by_head_parameters, linearised, pair_parameters
from vergence.stereo.sightings import sightings

ASIDE_RAD, ABOVE_RAD = 0.25, 0.2
"""Directions of the points to the side and upwards, from the middle of the head [rad]: those of
most objects that a head looks at."""


@dataclass(frozen=True, eq=False)
class WorkspacePoints:
    """W points that both eyes fixate."""

    points: Array
    """(W, 3) [m] in the left eye's base frame."""
    joints: Array
    """(W, r) readings [rad]."""
    by_parameters: Array
    """(W, 3, p) derivatives of the located points by parameters of the head."""


def workspace(
    head: HeadCalibration,
    pair: tuple[str, str],
    limits_rad: Array,
    *,
    names: tuple[str, ...],
    distances_m: tuple[float, ...] = DISTANCES_M,
) -> WorkspacePoints:
    """Make the points at some distances, with their derivatives by named parameters.

    The eyes fixate with readings up to limits (r,) to either side. Raises VergenceError if a point
    is not in the images of both cameras of the pair then.
    """
    a, b = np.meshgrid(ASIDE_RAD * np.arange(-1, 2), ABOVE_RAD * np.arange(-1, 2))
    in_head = np.multiply.outer(np.array(distances_m), looking_along(a, -b)).reshape(-1, 3)
    points = transform(inverse(T_head_base(head, "left")), in_head)
    in_bases = points, transform(head.T_rbase_lbase, points)
    joints = solve_fixation(head, dict(zip(pair, in_bases, strict=True)))
    joints = np.clip(np.nan_to_num(joints), -limits_rad, limits_rad)
    seen = np.ones(len(points), bool)
    for name in pair:
        lens = head.cameras[name].intrinsics
        offset = project_point(head, name, joints, points) - lens.matrix[:2, 2]
        seen &= (np.abs(offset) < np.array(lens.size) / 2).all(axis=1)
    if not seen.all():
        x, y, z = points[seen.argmin()]
        raise VergenceError(
            f"The eyes cannot both see the point ({x:z.2f}, {y:z.2f}, {z:z.2f}) m from the left "
            "eye within the limits of their joints; allow them more, or name larger distances."
        )
    by_parameters = point_by_parameters(head, pair, points, joints)
    return WorkspacePoints(points, joints, by_parameters[..., named_columns(head, names)])


def point_by_parameters(
    head: HeadCalibration, pair: tuple[str, str], points: Array, joints: Array
) -> Array:
    """Compute derivatives (N, 3, c) of points that two cameras locate by `parameter_names`.

    The pixels of the points (N, 3) [m] and the readings (N, r) [rad] stay what they are.
    """
    left, right = (project_point(head, name, joints, points) for name in pair)
    seen = sightings(head, left=left, right=right, joints=joints, cameras=pair, pixel_std_px=1.0)
    rows = np.zeros((len(points), 3, len(parameter_names(head))))
    columns = named_columns(head, pair_parameters(head, pair))
    rows[..., columns] = by_head_parameters(linearised(seen), seen)
    return rows


def largest_std(by_parameters: Array, covariance: Array) -> Array:
    """Compute the standard deviation (..., W) [m] of each point in its worst direction.

    By derivatives (W, 3, p) and covariances (..., p, p) of the parameters.
    """
    C = by_parameters @ covariance[..., None, :, :] @ np.swapaxes(by_parameters, 1, 2)
    return np.sqrt(np.linalg.eigvalsh(C)[..., -1])
