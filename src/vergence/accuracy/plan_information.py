"""What views of a board tell about a head: the information of bundle adjustment, view by view.

Bundle adjustment's own derivatives, at the calibrated head and at corners as such views would show
them. The latent readings of each eye are eliminated at once, since they belong to one view; the
place of the board only after it is known which views share it.
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

LEAST_JOINT_STD = 1e-6
"""Least noise of a reading [rad]: a calibration may call joints exact."""
CORNERS_AT_A_TIME = 20_000
"""Corners of views that are linearised together: their derivatives take some 50 MB for each camera,
where all views of a board of 10,000 corners would take gigabytes."""

OF_READINGS = "A plan says which joint readings to take;"

_FIXED = 1e-12
"""Variance of a combination, relative to its parameters', below which it does not change."""


@dataclass(frozen=True, eq=False)
class Knowledge:
    """What is known of the p parameters of a head that its calibration estimates.

    In units of `scale`, their standard deviations before the planned views.
    """

    names: tuple[str, ...]
    scale: Array
    """(p,)."""
    information: Array
    """(p, p)."""


def known_of(head: HeadCalibration) -> Knowledge:
    """Return what a calibration states; VergenceError if it states no covariance or no noise."""
    check_states_covariance(head)
    accuracy = head.accuracy
    assert accuracy is not None
    if accuracy.eye_motion == "poses":
        raise VergenceError(f"{OF_READINGS} this head was calibrated with measured eye poses.")
    scale = np.sqrt(np.diag(accuracy.covariance))
    # A covariance may hold combinations of parameters fixed.
    values, directions = np.linalg.eigh(accuracy.covariance / np.outer(scale, scale))
    information: Array = (directions / np.maximum(values, _FIXED)) @ directions.T
    return Knowledge(accuracy.parameters, scale, information)


@dataclass(frozen=True, eq=False)
class LinearViews:
    """V views linearised: J^T J of their corners in pixels, and the B postures of their eyes.

    The unknowns of a view are p parameters of the head, in given units, and the 6 of the board's
    place [rad, m]; and n latent readings of each block.
    """

    whole: Array
    """(V, p + 6, p + 6)."""
    across: Array
    """(B, p + 6, n)."""
    latent: Array
    """(B, n, n)."""
    columns: np.ndarray
    """(B, n) which reading of the head each latent one is."""
    view: np.ndarray
    """(B,) to which view a block belongs."""


def linearised_views(
    head: HeadCalibration, board: Board, views: Views, names: tuple[str, ...], scale: Array
) -> LinearViews:
    """Return views of a board, linearised at the head and at corners without noise.

    The p parameters that are estimated have names, and units `scale` (p,).
    """
    at_a_time = max(1, CORNERS_AT_A_TIME // (board.columns * board.rows))
    starts = range(0, len(views.placement), at_a_time)
    parts = [
        _linearised_part(head, board, views.take(np.s_[start : start + at_a_time]), names, scale)
        for start in starts
    ]
    whole, across, latent, columns = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("whole", "across", "latent", "columns")
    )
    view = [part.view + start for part, start in zip(parts, starts, strict=True)]
    return LinearViews(whole, across, latent, columns, np.concatenate(view))


def _linearised_part(
    head: HeadCalibration, board: Board, views: Views, names: tuple[str, ...], scale: Array
) -> LinearViews:
    apart = Views(views.T_lbase_target, views.joints, np.arange(len(views.placement)))
    fixed = set(parameter_names(head)) - set(names)
    problem = bundle_problem(
        head, as_seen(head, board, apart), fixed=fixed, T_cam_target=T_cam_target(head, apart)
    )
    rows, postures = problem.measured.rows(problem.start), problem.readings.postures
    assert rows.by_latent is not None
    J, L, index = rows.by_shared, rows.by_latent, rows.columns
    c, (B, n), V = len(parameter_names(head)), postures.reading.shape, len(views.placement)
    # Each view's place has the same six columns after those of the head; the board's size is known.
    of_size = index == problem.start.size - 1
    index = np.where(of_size, 0, np.where(index < c, index, c + (index - c) % len(POSE)))
    J = np.where(of_size[:, None], 0.0, J)
    J_T = np.swapaxes(J, 1, 2)
    block, angle = problem.measured.detections.posture[:, None, None], np.arange(n)
    view = postures.view[block]
    row, column = index[:, :, None], index[:, None, :]
    size = c + len(POSE)
    whole = scatter_add(J_T @ J, (view, row, column), (V, size, size))
    across = scatter_add(J_T @ L, (block, row, angle), (B, size, n))
    latent = scatter_add(np.swapaxes(L, 1, 2) @ L, (block, angle[:, None], angle), (B, n, n))
    known = {name: k for k, name in enumerate(parameter_names(head))}
    kept = np.array([known[name] for name in names] + [*range(c, c + len(POSE))])
    unit = np.append(scale, np.ones(len(POSE)))
    whole = whole[:, kept[:, None], kept] * np.outer(unit, unit)
    across = across[:, kept] * unit[:, None]
    return LinearViews(whole, across, latent, postures.columns, postures.view)


def information(linear: LinearViews, pixel_std_px: float, joint_std_rad: Array) -> Array:
    """Return each view's information (V, p + 6, p + 6) about the head and the board's place.

    The noise is that of one coordinate of a corner, and of the readings (r,) of the head.
    """
    joint = np.maximum(joint_std_rad[linear.columns], LEAST_JOINT_STD)
    # In pixels: (J^T J - J^T L (L^T L + s^2 / j^2)^-1 L^T J) / s^2.
    tied = linear.latent + np.eye(joint.shape[1]) * ((pixel_std_px / joint) ** 2)[:, None]
    taken = linear.across @ np.linalg.solve(tied, np.swapaxes(linear.across, 1, 2))
    left = linear.whole.copy()
    np.subtract.at(left, linear.view, taken)
    return left / pixel_std_px**2


def without_place(information: Array) -> Array:
    """Return (..., p, p) what is left on the head of (..., p + 6, p + 6), the place eliminated."""
    head, place = slice(None, -len(POSE)), slice(-len(POSE), None)
    across = information[..., place, head]
    rest = np.linalg.solve(information[..., place, place], across)
    return information[..., head, head] - np.swapaxes(across, -1, -2) @ rest


def gained(of_views: Array, place: np.ndarray) -> Array:
    """Return (p, p) what views (V, p + 6, p + 6) at places (V,) together tell of the head."""
    of_places = [of_views[place == each].sum(axis=0) for each in np.unique(place)]
    return without_place(np.array(of_places)).sum(axis=0)
