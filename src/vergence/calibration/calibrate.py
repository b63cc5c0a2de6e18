"""A dataset, or corners and readings, in; a calibrated head with its accuracy out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle.bundle_adjustment import BundleEstimate, bundle_adjust
from vergence.calibration.checks import board_flips, encoders, excitation
from vergence.calibration.checks.cross_validation import (
    PartCalibration,
    calibrate_folds,
    held_out,
    predicted_squares,
)
from vergence.calibration.checks.pose_readings import check_pose_readings
from vergence.calibration.detection import detect_target
from vergence.calibration.observations import Observations, camera_eyes
from vergence.calibration.sequential.intrinsics import LensModel, calibrate_intrinsics
from vergence.calibration.sequential.sequential import SequentialCalibration, calibrate_sequentially
from vergence.calibration.summary import summary_lines
from vergence.data.dataset import Dataset
from vergence.errors import VergenceError
from vergence.geometry.board import corner_points
from vergence.geometry.head import Accuracy, HeadCalibration, HeldOut
from vergence.geometry.kinematics import EYES
from vergence.geometry.se3 import inverse, mean_pose
from vergence.progress import Progress, silent
from vergence.vision.board_pose import LEAST_CORNERS, board_poses, seen_corners

Method = Literal["bundle", "paper"]
LEAST_VIEWS = 3
"""Of a camera, for its intrinsics."""
BOARD_SIZE_REMARK = 0.001
"""Relative error of the board's size from which it is spoken of."""
BEYOND_CHANCE = 2.0
"""Standard errors by which a prediction must be better to be preferred."""
LARGEST_JACKKNIFE_RATIO = 2.0
"""Ratio of standard deviations from which the stated ones are called too small. The folds determine
it to about a tenth."""


VOID_RATIO = 10.0
"""The same, from which the result is worth nothing."""


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """A calibrated head, and all that is known of how good it is."""

    head: HeadCalibration
    """With its accuracy and its warnings."""
    observations: Observations
    """As they were used: with boards that were numbered from the wrong end renumbered."""
    start: SequentialCalibration
    """By the paper's method."""
    estimate: BundleEstimate | None
    """With residuals and the boards' poses; None: the paper's method was asked for."""

    @property
    def accuracy(self) -> Accuracy:
        """The head's accuracy."""
        assert self.head.accuracy is not None
        return self.head.accuracy

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the data could not determine, and what to record instead; first what voids it."""
        return (*self.accuracy.void, *self.accuracy.warnings)

    def summary(self) -> str:
        """Return at most ten lines: good or not, how good, what to do next."""
        return "\n".join(summary_lines(self.head, self.observations))


def calibrate(
    data: Dataset | Observations,
    *,
    method: Method = "bundle",
    wide_lens: LensModel = "radial-tangential",
    progress: Progress = silent,
) -> CalibrationResult:
    """Calibrate a head, and predict each fold of its views from the others.

    Args:
        data: a dataset, in whose images the board is then sought; or the observations of one's own
            detector.
        method: the paper's steps alone, or bundle adjustment, which starts from them.
        wide_lens: distortion of the wide cameras; the narrow ones have none.
        progress: see vergence.progress.

    Raises:
        VergenceError: the data are too poor for any answer, or contradict themselves.
    """
    if isinstance(data, Dataset):
        if data.moving.all():
            raise VergenceError(
                f"{data.folder} has moving rows only; the calibration starts from views in which "
                "the eyes stand still."
            )
        data = detect_target(data, progress=progress)
    progress("calibrating", 0, 3)
    seen = data.take(data.at_rest)
    camera_eyes(seen)  # each camera's eye is known
    for name, corners in seen.corners.items():
        enough = int((seen_corners(corners).sum(axis=1) >= LEAST_CORNERS).sum())
        if enough < LEAST_VIEWS:
            raise VergenceError(
                f"{name} shows the board in {enough} images at rest: fx, fy and T_eye_cam "
                f"are not observable; record at least {LEAST_VIEWS}, better 10, at different "
                "distances and slants."
            )
    intrinsics = calibrate_intrinsics(seen, wide_lens=wide_lens)
    points = corner_points(data.board)
    # Once for each image: all that follows asks for these.
    T_cam_target = {
        name: board_poses(each.camera, data.corners[name], points)
        for name, each in intrinsics.items()
    }
    encoders.check_encoders(seen, _take(T_cam_target, data.at_rest))
    posed = check_pose_readings(data, T_cam_target)
    renumbered = board_flips.number_alike(posed.observations, T_cam_target)
    observations, T_cam_target = renumbered.observations, renumbered.T_cam_target
    seen, T_rest = observations.take(data.at_rest), _take(T_cam_target, data.at_rest)
    excitation.check_excitation(seen, T_rest)
    start = calibrate_sequentially(seen, intrinsics=intrinsics, T_cam_target=T_rest)
    progress("calibrating", 1, 3)
    if method == "paper":
        estimate, choice = None, ()
        head, accuracy = start.head, Accuracy(method="paper")
        focal_std = {name: each.focal_std_px for name, each in intrinsics.items()}
    else:
        estimate = bundle_adjust(start.head, observations, T_cam_target=T_cam_target)
        estimate, choice = _better_of_two(start.head, observations, T_cam_target, estimate)
        head, accuracy = estimate.head, estimate.accuracy
        std = dict(zip(estimate.parameters, np.sqrt(np.diag(estimate.covariance)), strict=True))
        focal_std = {name: (std[f"{name}.fx"], std[f"{name}.fy"]) for name in head.cameras}
    progress("calibrating", 2, 3)

    def of_part(rows: np.ndarray) -> PartCalibration:
        if estimate is not None:
            return _part_of(estimate, observations, T_cam_target, rows)
        part = observations.take(rows)
        at_rest = part.take(part.at_rest)
        found = calibrate_sequentially(at_rest, wide_lens=wide_lens).head
        return PartCalibration(found, _boards(found, part, _take(T_cam_target, rows)), 1.0)

    checked, doubts, worthless = _cross_validated(observations, of_part)
    progress("calibrating", 3, 3)
    void = (*accuracy.void, *worthless, *encoders.doubts(head))
    warnings = (
        *posed.warnings,
        *board_flips.warnings(renumbered),
        *excitation.doubts(observations, T_cam_target, head, focal_std),
        *accuracy.warnings,
        *doubts,
    )
    accuracy = replace(
        accuracy,
        eye_motion="pan-tilt" if observations.T_base_eye is None else "poses",
        held_out=checked,
        void=void,
        warnings=warnings,
    )
    remarks = (*observations.remarks, *board_flips.remarks(renumbered), *choice)
    return CalibrationResult(
        replace(head, accuracy=accuracy), replace(observations, remarks=remarks), start, estimate
    )


def _better_of_two(
    start: HeadCalibration,
    observations: Observations,
    T_cam_target: Mapping[str, Array],
    estimate: BundleEstimate,
) -> tuple[BundleEstimate, tuple[str, ...]]:
    """Return the estimate that predicts unseen views better, and what there is to say of it.

    Errors of measured eye poses need not be independent and of one size, as an estimate of their
    noise assumes; where poses that are taken as exact predict better, beyond chance, they are.
    """
    if observations.T_base_eye is None:
        return estimate, ()
    said = []
    change = estimate.board_scale - 1
    if abs(change) > BOARD_SIZE_REMARK:
        square_mm = 1e3 * observations.board.square_m
        said.append(
            f"By the eye poses a square of the board measures {square_mm * (1 + change):.3f} mm, "
            f"not {square_mm:.3f} mm ({100 * change:+.2f} %): measure it; lengths are those of the "
            "poses."
        )
    exact = bundle_adjust(start, observations, T_cam_target=T_cam_target, joint_std=0.0)
    try:
        found = []
        for each in (estimate, exact):
            of_part = partial(_part_of, each, observations, T_cam_target)
            parts = calibrate_folds(observations, of_part)
            found.append(predicted_squares(observations, parts))
        squares, counts = np.moveaxis(np.array(found), 2, 0)
    except VergenceError:
        return estimate, tuple(said)  # too few views: there is no held-out error at all
    gain = squares[0] - squares[1]
    rms = np.sqrt(squares.sum(axis=1) / np.maximum(counts.sum(axis=1), 1))
    if gain.sum() <= BEYOND_CHANCE * np.sqrt((gain**2).sum()):
        return estimate, tuple(said)
    said.append(
        f"Eye poses are taken as exact: they then predict unseen views to {rms[1]:.2f} px, and to "
        f"{rms[0]:.2f} px if their noise is estimated."
    )
    return exact, tuple(said)


def _part_of(
    estimate: BundleEstimate,
    observations: Observations,
    T_cam_target: Mapping[str, Array],
    rows: np.ndarray,
) -> PartCalibration:
    """Return the calibration from a part of the views (V,), at the noise that all of them show."""
    part, levels = observations.take(rows), estimate.joint_std
    # One level for all joints is given; the folds are hardly the worse for it.
    mean = float(np.sqrt(np.mean(np.square(levels))))
    found = bundle_adjust(
        estimate.head,
        part,
        T_cam_target=_take(T_cam_target, rows),
        pixel_std_px=estimate.pixel_std_px,
        joint_std=mean if part.T_base_eye is None else (levels[0], levels[-1]),
    )
    head = replace(found.head, accuracy=replace(found.accuracy, joint_std=levels))
    return PartCalibration(head, found.T_lbase_target, found.board_scale)


def _boards(
    head: HeadCalibration, seen: Observations, T_cam_target: Mapping[str, Array]
) -> dict[int, Array]:
    """Return where the board of each placement stands, by the cameras that see it."""
    eye_poses, found = seen.eye_poses(head.axes), {}
    T_lbase_base = {"left": np.eye(4), "right": inverse(head.T_rbase_lbase)}
    for number in np.unique(seen.placement):
        rows = seen.placement == number
        views = [
            T_lbase_base[m.eye]
            @ eye_poses[rows, EYES.index(m.eye)]
            @ m.T_eye_cam
            @ T_cam_target[name][rows]
            for name, m in head.cameras.items()
            if name in T_cam_target
        ]
        T = np.concatenate(views)
        T = T[np.isfinite(T).all(axis=(1, 2))]
        if len(T):
            found[int(number)] = mean_pose(T)
    return found


def _take(T_cam_target: Mapping[str, Array], rows: np.ndarray) -> dict[str, Array]:
    return {name: T[rows] for name, T in T_cam_target.items()}


def _cross_validated(
    observations: Observations, of_part: Callable[[np.ndarray], PartCalibration]
) -> tuple[HeldOut | None, tuple[str, ...], tuple[str, ...]]:
    """Return the held-out error, or why there is none; doubts; and what voids the result."""
    try:
        found = held_out(observations, calibrate_folds(observations, of_part))
    except VergenceError as error:
        return None, (f"There is no held-out error: {error}",), ()
    if not found.transfer_views and len(set(camera_eyes(observations).values())) > 1:
        return found, ("There is no held-out error: no view shows the board to both eyes.",), ()
    ratio = found.jackknife_ratio
    if ratio is None or ratio <= LARGEST_JACKKNIFE_RATIO:
        return found, (), ()
    said = f"Calibrations from parts of the views differ {ratio:.1f} times as much as stated: "
    if ratio > VOID_RATIO:
        return (
            found,
            (),
            (said + "they contradict each other; look for views with wrong readings.",),
        )
    said += (
        "the errors of the corners are not independent (a board that bends, blur), and true errors "
        "are larger than the stated ones by as much at least."
    )
    return found, (said,), ()
