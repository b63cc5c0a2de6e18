"""Calibrations from parts of the views, and whether measured poses are better taken as exact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle_adjustment import BundleEstimate, NoiseModel, bundle_adjust
from vergence.calibration.checks.cross_validation import (
    PartCalibration,
    calibrate_folds,
    predicted_squares,
)
from vergence.calibration.observations import Observations
from vergence.errors import VergenceError
from vergence.findings import Finding, note
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import EYES
from vergence.geometry.projection import T_lbase_cam
from vergence.geometry.se3 import known_poses, mean_pose

BOARD_SIZE_REMARK = 0.001
"""Relative error of the board's size from which it is spoken of."""
BEYOND_CHANCE = 2.0
"""Standard errors by which a prediction must be better to be preferred."""


def predicting_better(
    start: HeadCalibration,
    observations: Observations,
    T_cam_target: Mapping[str, Array],
    estimate: BundleEstimate,
) -> tuple[BundleEstimate, tuple[Finding, ...]]:
    """Return the estimate that predicts unseen views better, and notes on it.

    Errors of measured eye poses need not be independent and of one size, as an estimate of their
    noise assumes; where poses that are taken as exact predict better, beyond chance, they are.
    """
    if observations.T_base_eye is None:
        return estimate, ()
    said = []
    change = estimate.board_scale - 1
    if abs(change) > BOARD_SIZE_REMARK:
        square_mm = 1e3 * observations.board.square_m
        sentence = (
            f"By the eye poses a square of the board measures {square_mm * (1 + change):.3f} mm, "
            f"not {square_mm:.3f} mm ({100 * change:+.2f} %): measure it; lengths are those of the "
            "poses."
        )
        said.append(note("board-size", sentence))
    exact = bundle_adjust(
        start, observations, T_cam_target=T_cam_target, noise=NoiseModel(joint_std=0.0)
    )
    try:
        found = []
        for each in (estimate, exact):
            of_part = partial(bundle_of_part, each, observations, T_cam_target)
            parts = calibrate_folds(observations, of_part)
            found.append(predicted_squares(observations, parts))
        squares, counts = np.moveaxis(np.array(found), 2, 0)
    except VergenceError:
        return estimate, tuple(said)  # too few views: there is no held-out error at all
    gain = squares[0] - squares[1]
    rms = np.sqrt(squares.sum(axis=1) / np.maximum(counts.sum(axis=1), 1))
    if gain.sum() <= BEYOND_CHANCE * np.sqrt((gain**2).sum()):
        return estimate, tuple(said)
    sentence = (
        f"Eye poses are taken as exact: they then predict unseen views to {rms[1]:.2f} px, and to "
        f"{rms[0]:.2f} px if their noise is estimated."
    )
    said.append(note("exact-poses", sentence))
    return exact, tuple(said)


def bundle_of_part(
    estimate: BundleEstimate,
    observations: Observations,
    T_cam_target: Mapping[str, Array],
    rows: np.ndarray,
) -> PartCalibration:
    """Return the calibration from a part of the views (V,), at the noise that all of them show."""
    part, levels = observations.take(rows), estimate.joint_std
    found = bundle_adjust(
        estimate.head,
        part,
        T_cam_target={name: T[rows] for name, T in T_cam_target.items()},
        noise=NoiseModel(estimate.pixel_std_px, levels),
    )
    head = replace(found.head, accuracy=replace(found.accuracy, joint_std=levels))
    return PartCalibration(head, found.T_lbase_target, found.board_scale)


def placed_boards(
    head: HeadCalibration, seen: Observations, T_cam_target: Mapping[str, Array]
) -> dict[int, Array]:
    """Return where the board of each placement stands, by the cameras that see it."""
    eye_poses, found = seen.eye_poses(head), {}
    for number in np.unique(seen.placement):
        rows = seen.placement == number
        views = [
            T_lbase_cam(m, head.T_rbase_lbase, eye_poses[rows, EYES.index(m.eye)])
            @ T_cam_target[name][rows]
            for name, m in head.cameras.items()
            if name in T_cam_target
        ]
        T = np.concatenate(views)
        T = T[known_poses(T)]
        if len(T):
            found[int(number)] = mean_pose(T)
    return found
