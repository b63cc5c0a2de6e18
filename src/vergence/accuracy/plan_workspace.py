"""The points for which a recording is planned, and how an error of the head moves them.

Points stand before the head, near to far, ahead and to the sides; both eyes fixate each, as nearly
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

ASIDE_RAD, ABOVE_RAD = 0.25, 0.2
"""To the side and upwards, from the middle of the head."""


@dataclass(frozen=True, eq=False)
class WorkspacePoints:
    """W points that both eyes fixate."""

    points: Array
    """(W, 3) [m] in the left eye's base frame."""
    joints: Array
    """(W, r) readings [rad]."""
    by_parameters: Array
    """(W, 3, p) how the located points change with the parameters of the head."""


def workspace(
    head: HeadCalibration,
    pair: tuple[str, str],
    limits_rad: Array,
    *,
    names: tuple[str, ...],
    distances_m: tuple[float, ...] = DISTANCES_M,
) -> WorkspacePoints:
    """Return points before the head, with their derivatives by named parameters.

    VergenceError if the eyes cannot both see one of them.
    """
    a, b = np.meshgrid(ASIDE_RAD * np.arange(-1, 2), ABOVE_RAD * np.arange(-1, 2))
    in_head = np.multiply.outer(np.array(distances_m), looking_along(a, -b)).reshape(-1, 3)
    points = transform(inverse(T_head_base(head, "left")), in_head)
    joints = fixating(head, pair, points, limits_rad)
    columns = named_columns(head, names)
    return WorkspacePoints(
        points, joints, point_by_parameters(head, pair, points, joints)[..., columns]
    )


def fixating(
    head: HeadCalibration, pair: tuple[str, str], points: Array, limits_rad: Array
) -> Array:
    """Return readings (N, r) [rad] at which both cameras have points (N, 3) at their centres.

    Or as near as limits (r,), the largest readings of the joints, allow. VergenceError if a point
    is not in both images then.
    """
    in_bases = points, transform(head.T_rbase_lbase, points)
    joints = solve_fixation(head, dict(zip(pair, in_bases, strict=True)), limits_rad=limits_rad)
    joints = np.nan_to_num(joints)  # of points that cannot be fixated, and other readings
    error = np.concatenate(
        [
            project_point(head, name, joints, points) - head.cameras[name].intrinsics.matrix[:2, 2]
            for name in pair
        ],
        axis=1,
    )
    lens = [head.cameras[name].intrinsics for name in pair]
    size = np.array([extent for each in lens for extent in each.size])
    seen = (np.abs(error) < size / 2).all(axis=1)
    if not seen.all():
        x, y, z = points[seen.argmin()]
        raise VergenceError(
            f"The eyes cannot both see the point ({x:z.2f}, {y:z.2f}, {z:z.2f}) m from the left "
            "eye within the limits of their joints; allow them more, or name larger distances."
        )
    return joints


def point_by_parameters(
    head: HeadCalibration, pair: tuple[str, str], points: Array, joints: Array
) -> Array:
    """Return (N, 3, c) how points that are located in two images move with the head.

    In the order of parameter_names; the pixels and the readings (N, r) stay what they are.
    """
    left, right = (project_point(head, name, joints, points) for name in pair)
    seen = linearised(head, left=left, right=right, joints=joints, cameras=pair)
    rows = np.zeros((len(points), 3, len(parameter_names(head))))
    columns = named_columns(head, pair_parameters(head, pair))
    rows[..., columns] = by_head_parameters(head, pair, seen).transpose(2, 0, 1)
    return rows


def largest_std(by_parameters: Array, covariance: Array) -> Array:
    """Return (..., W) [m] the standard deviation of each point in its worst direction.

    By derivatives (W, 3, p) and covariances (..., p, p) of the parameters.
    """
    C = by_parameters @ covariance[..., None, :, :] @ np.swapaxes(by_parameters, 1, 2)
    return np.sqrt(np.linalg.eigvalsh(C)[..., -1])
