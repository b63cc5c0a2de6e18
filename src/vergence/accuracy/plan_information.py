"""What views of a board tell about a head: the information of bundle adjustment, view by view.

Bundle adjustment's own derivatives, at the calibrated head and at corners as such views would show
them. The latent readings of each eye are eliminated at once, since they belong to one view; the
place of the board only after it is known which views share it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vergence.accuracy.plan_views import Views, T_cam_target, as_seen
from vergence.arrays import Array
from vergence.calibration.bundle.initial_state import initial_state
from vergence.calibration.bundle.problem import head_size, jacobians
from vergence.errors import VergenceError
from vergence.geometry.board import Board
from vergence.geometry.head import Accuracy, HeadCalibration
from vergence.geometry.parameters import POSE, parameter_names

LEAST_JOINT_STD = 1e-6
"""Of a reading [rad]: joints that a calibration calls exact."""


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

    @property
    def covariance(self) -> Array:
        """(p, p) in px, rad, m, s."""
        return np.linalg.inv(self.information) * np.outer(self.scale, self.scale)


def stated(head: HeadCalibration) -> tuple[Accuracy, Knowledge]:
    """Return what a calibration states; VergenceError if it states no covariance or no noise."""
    accuracy = head.accuracy
    if accuracy is None or not accuracy.parameters or not accuracy.joint_std:
        raise VergenceError(
            "This calibration states no covariance; `vergence calibrate --method bundle` makes "
            "one that does."
        )
    if accuracy.eye_motion == "poses":
        raise VergenceError(
            "A plan says which joint readings to take; this head was calibrated with measured "
            "eye poses."
        )
    scale = np.sqrt(np.diag(accuracy.covariance))
    correlation = accuracy.covariance / np.outer(scale, scale)
    return accuracy, Knowledge(accuracy.parameters, scale, np.linalg.inv(correlation))


def view_information(
    head: HeadCalibration,
    board: Board,
    views: Views,
    *,
    names: tuple[str, ...],
    scale: Array,
    pixel_std_px: float,
    joint_std_rad: Array,
) -> Array:
    """Return (V, p + 6, p + 6) the information of each view on the head and the board's place.

    Args:
        head: the calibrated head, at which all is linearised.
        board: that is shown.
        views: V of them.
        names: the p parameters of the head that are estimated.
        scale: (p,) units of their information; the place has rad and m.
        pixel_std_px: noise of one coordinate of a corner.
        joint_std_rad: noise of the readings of one eye: (n,), or one for all.
    """
    apart = Views(views.T_lbase_target, views.joints, np.arange(len(views.place)))
    fixed = set(parameter_names(head)) - set(names)
    problem, state, _ = initial_state(
        head, as_seen(head, board, apart), fixed=fixed, T_cam_target=T_cam_target(head, apart)
    )
    shared, index, latent = jacobians(problem, state)
    c, (B, n), V = head_size(problem), problem.reading.shape, len(views.place)
    # Each view's place has the same six columns after those of the head; the board's size is known.
    size = index == len(problem.free) - 1
    index = np.where(size, 0, np.where(index < c, index, c + (index - c) % len(POSE)))
    J = np.where(size[:, None, None], 0.0, shared / pixel_std_px)
    J = J.reshape(len(J), -1, J.shape[-1])
    L = (latent / pixel_std_px).reshape(len(J), -1, n)
    whole = np.zeros((V, c + len(POSE), c + len(POSE)))
    across, own = np.zeros((B, c + len(POSE), n)), np.zeros((B, n, n))
    view = problem.block_view[problem.block]
    J_T = np.swapaxes(J, 1, 2)
    np.add.at(whole, (view[:, None, None], index[:, :, None], index[:, None, :]), J_T @ J)
    np.add.at(across, (problem.block[:, None], index), J_T @ L)
    np.add.at(own, problem.block, np.swapaxes(L, 1, 2) @ L)
    precision = np.maximum(np.broadcast_to(joint_std_rad, n), LEAST_JOINT_STD) ** -2.0
    taken = across @ np.linalg.solve(own + np.diag(precision), np.swapaxes(across, 1, 2))
    np.subtract.at(whole, problem.block_view, taken)
    known = {name: k for k, name in enumerate(problem.parameters)}
    kept = np.array([known[name] for name in names] + [*range(c, c + len(POSE))])
    unit = np.append(scale, np.ones(len(POSE)))
    return whole[:, kept[:, None], kept] * np.outer(unit, unit)


def without_place(information: Array) -> Array:
    """Return (..., p, p) what is left on the head of (..., p + 6, p + 6), the place eliminated."""
    head, place = slice(None, -len(POSE)), slice(-len(POSE), None)
    across = information[..., place, head]
    rest = np.linalg.solve(information[..., place, place], across)
    return information[..., head, head] - np.swapaxes(across, -1, -2) @ rest
