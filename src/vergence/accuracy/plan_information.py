"""Information of views of a board about a head: that of bundle adjustment, view by view.

The derivatives are those of bundle adjustment, at the calibrated head and at corners as such views
would show them. The latent readings of each eye belong to one view and are marginalised at once;
the place of the board only when it is known which views share it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.accuracy.plan_views import T_cam_target, Views, as_seen
from vergence.arrays import Array, scatter_add
from vergence.calibration.bundle_start import bundle_problem
from vergence.errors import VergenceError
from vergence.geometry.board import Board
from vergence.geometry.head import HeadCalibration, check_states_covariance
from vergence.geometry.parameter_names import POSE
from vergence.geometry.parameters import parameter_names

CORNERS_AT_A_TIME = 20_000
"""Number of corners that are linearised together: their derivatives take 50 MB for each camera, and
those of all views of a board of 10,000 corners gigabytes."""


@dataclass(frozen=True, eq=False)
class Knowledge:
    """Information of a calibration about its p estimated parameters, in units of `scale`."""

    names: tuple[str, ...]
    scale: Array
    """(p,) standard deviations before the planned views."""
    information: Array
    """(p, p)."""


def known_of(head: HeadCalibration) -> Knowledge:
    """Invert the covariance of a calibration; VergenceError if it states no covariance."""
    check_states_covariance(head)
    accuracy = head.accuracy
    assert accuracy is not None
    if accuracy.eye_motion == "poses":
        raise VergenceError(
            "A plan is of joint readings; this head was calibrated with measured eye poses."
        )
    scale = np.sqrt(np.diag(accuracy.covariance))
    # A covariance may hold combinations of parameters fixed.
    values, directions = np.linalg.eigh(accuracy.covariance / np.outer(scale, scale))
    information: Array = (directions / np.maximum(values, 1e-12)) @ directions.T
    return Knowledge(accuracy.parameters, scale, information)


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
    """Compute the information of V views about the head and the board's place.

    Args:
        head: at which the views are linearised.
        board: in the views.
        views: of whole boards, without noise.
        names: of the p parameters of the head that are estimated.
        scale: (p,) their units.
        pixel_std_px: noise of one coordinate of a corner.
        joint_stds: (S, r) levels of the noise of the readings [rad].

    Returns:
        (S, V, p + 6, p + 6), with the board's place [rad, m] last.
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
        T_cam_target=T_cam_target(head, views),
    )
    rows, postures = problem.measured.rows(problem.start), problem.readings.postures
    assert rows.by_latent is not None
    J, L, index = rows.by_shared, rows.by_latent, rows.columns
    c, (B, n), V = len(everything), postures.reading.shape, len(views.placement)
    # Each view's place has the same six columns after those of the head; the board's size is known.
    of_size = index == problem.start.size - 1
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
        ratio = pixel_std_px / np.maximum(stds[postures.columns], 1e-6)  # joints stated as exact
        tied = latent + np.eye(n) * (ratio**2)[:, None]
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
