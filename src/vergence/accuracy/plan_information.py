"""Information of views of a board about a head: that of bundle adjustment, view by view.

The latent readings of each eye belong to one view and are marginalised at once; the place of the
board only when it is known which views share it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.accuracy.plan_views import Views, as_seen, target_poses
from vergence.arrays import Array, scatter_add
from vergence.calibration.bundle_start import bundle_problem
from vergence.calibration.summary import DISTANCES_M
from vergence.errors import VergenceError
from vergence.gaze.foveation import solve_fixation
from vergence.geometry.board import Board
from vergence.geometry.head import HeadCalibration, base_pose, parameter_names
from vergence.geometry.kinematics import looking_along
from vergence.geometry.parameters import named_columns
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import POSE, inverse, transform
from vergence.stereo.linearised import by_head_parameters, linearised, pair_parameters
from vergence.stereo.triangulation import sightings

CORNERS_AT_A_TIME = 20_000
"""Number of corners that are linearised together: their derivatives take 50 MB for each camera."""


def scaled_information(head: HeadCalibration) -> tuple[Array, Array]:
    """Invert the covariance of a calibration; VergenceError if it states no covariance.

    Returns the standard deviations (p,) of its parameters, and the information (p, p) in units of
    these.
    """
    accuracy = head.accuracy
    if accuracy is None or not accuracy.parameters:
        raise VergenceError(
            "This calibration states no covariance; `vergence calibrate --method bundle` makes "
            "one that does."
        )
    if accuracy.eye_motion == "poses":
        raise VergenceError(
            "A plan is of joint readings; this head was calibrated with measured eye poses."
        )
    scale = np.sqrt(np.diag(accuracy.covariance))
    # A covariance may hold combinations of parameters fixed.
    values, directions = np.linalg.eigh(accuracy.covariance / np.outer(scale, scale))
    return scale, (directions / np.maximum(values, 1e-12)) @ directions.T


def view_information(
    head: HeadCalibration,
    board: Board,
    views: Views,
    names: tuple[str, ...],
    *,
    scale: Array,
    pixel_std_px: float,
    joint_stds: Array,
) -> Array:
    """Compute the information (S, V, p + 6, p + 6) of V views about the head and the board's place.

    Its rows are the p named parameters, in units of scale (p,), then the board's place [rad, m].
    `joint_stds` (S, r) are levels of the noise of the readings [rad].
    """
    at_a_time = max(1, CORNERS_AT_A_TIME // (board.columns * board.rows))
    unit, parts = np.append(scale, np.ones(len(POSE))), []
    for start in range(0, len(views.placement), at_a_time):
        part = views.take(np.s_[start : start + at_a_time])
        part = Views(part.T_lbase_target, part.joints, np.arange(len(part.placement)))
        parts.append(_part_information(head, board, part, names, pixel_std_px, joint_stds))
    return np.concatenate(parts, axis=1) * np.outer(unit, unit)


def _part_information(
    head: HeadCalibration,
    board: Board,
    views: Views,
    names: tuple[str, ...],
    pixel_std_px: float,
    joint_stds: Array,
) -> Array:
    everything = parameter_names(head)
    problem = bundle_problem(
        head,
        as_seen(head, board, views),
        fixed=set(everything) - set(names),
        T_cam_target=target_poses(head, views),
    )
    rows, postures = problem.measured.rows(problem.start), problem.readings.postures
    assert rows.by_latent is not None
    J, L, index = rows.by_shared, rows.by_latent, rows.columns
    c, (B, n), V = len(everything), postures.reading.shape, len(views.placement)
    # Each view's place has the same six columns after those of the head; the board's size is known.
    of_size = index == problem.start.columns("board_scale")
    index = np.where(of_size, 0, np.where(index < c, index, c + (index - c) % len(POSE)))
    J = np.where(of_size[:, None], 0.0, J)
    J_T = np.swapaxes(J, 1, 2)
    block, angle = problem.measured.detections.posture[:, None, None], np.arange(n)
    row, column, size = index[:, :, None], index[:, None, :], c + len(POSE)
    by_view = scatter_add(J_T @ J, (postures.view[block], row, column), (V, size, size))
    across = scatter_add(J_T @ L, (block, row, angle), (B, size, n))
    latent = scatter_add(np.swapaxes(L, 1, 2) @ L, (block, angle[:, None], angle), (B, n, n))
    kept = np.array([everything.index(name) for name in names] + [*range(c, size)])
    by_view, across = by_view[:, kept[:, None], kept], across[:, kept]
    found = np.repeat(by_view[None], len(joint_stds), axis=0)
    for information, stds in zip(found, joint_stds, strict=True):
        # In pixels: J^T J - J^T L (L^T L + s^2 / j^2)^-1 L^T J.
        # Joints stated as exact, and those that share a reading, have a least noise.
        least = np.where(postures.own == 1, 0.0, stds[postures.columns])
        ratio = pixel_std_px / np.maximum(least, 1e-6)
        tied = latent + postures.tied.T @ (postures.tied * (ratio**2)[..., None])
        lost = across @ np.linalg.solve(tied, np.swapaxes(across, 1, 2))
        np.subtract.at(information, postures.view, lost)
    return found / pixel_std_px**2


def marginalise_place(information: Array) -> Array:
    """Marginalise the board's place of (..., p + 6, p + 6) information: (..., p, p)."""
    head, place = slice(None, -len(POSE)), slice(-len(POSE), None)
    across = information[..., place, head]
    lost = np.linalg.solve(information[..., place, place], across)
    return information[..., head, head] - np.swapaxes(across, -1, -2) @ lost


def total_information(of_views: Array, place: np.ndarray) -> Array:
    """Add up the information (p, p) of views (V, p + 6, p + 6) at places (V,) about the head."""
    of_places = [of_views[place == each].sum(axis=0) for each in np.unique(place)]
    return marginalise_place(np.array(of_places)).sum(axis=0)


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
    points = transform(inverse(base_pose(head, "left")), in_head)
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
