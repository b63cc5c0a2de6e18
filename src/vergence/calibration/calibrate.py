"""A dataset, or corners and readings, in; a calibrated head with its accuracy out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle.bundle_adjustment import BundleEstimate, bundle_adjust
from vergence.calibration.checks import axes_and_eyes, board_flips, encoders, excitation
from vergence.calibration.checks.cross_validation import (
    EACH_BELOW,
    PartCalibration,
    calibrate_folds,
    held_out,
)
from vergence.calibration.checks.exchanged_readings import exchanged_readings
from vergence.calibration.checks.lens_map import edge_warnings
from vergence.calibration.checks.part_calibration import (
    bundle_of_part,
    placed_boards,
    predicting_better,
)
from vergence.calibration.checks.pose_readings import check_axis_order, check_pose_readings
from vergence.calibration.checks.stray_corners import without_strays
from vergence.calibration.detection import detect_target
from vergence.calibration.observations import Observations, camera_eyes, check_readings
from vergence.calibration.sequential.intrinsics import (
    LEAST_VIEWS,
    LensModel,
    calibrate_intrinsics,
    lenses_of_the_paper,
)
from vergence.calibration.sequential.lens_choice import (
    Lens,
    LensChoice,
    by_camera,
    choose_lenses,
)
from vergence.calibration.sequential.sequential import SequentialCalibration, calibrate_sequentially
from vergence.calibration.summary import MISFIT_CAUSES, summary_lines
from vergence.data.dataset import Dataset
from vergence.errors import VergenceError
from vergence.geometry.board import corner_points
from vergence.geometry.head import Accuracy, HeadCalibration, HeldOut
from vergence.progress import Progress, silent
from vergence.vision.board_pose import LEAST_CORNERS, board_poses, seen_corners

Method = Literal["bundle", "paper"]
LARGEST_JACKKNIFE_RATIO = 2.0
"""Ratio of standard deviations from which the stated ones are called too small. The folds determine
it to about a tenth."""
VOID_RATIO = 10.0
"""The same, from which the result must not be used."""
VOID_MISFIT = 5.0
"""Held-out error, as a multiple of what the noise explains, from which it must not be used."""


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
    lenses: Mapping[str, LensChoice] = field(default_factory=dict)
    """By camera its lens model, and how well others predicted held-out images."""

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
    lens: Lens | Mapping[str, Lens] = "auto",
    progress: Progress = silent,
) -> CalibrationResult:
    """Calibrate a head, and predict each fold of its views from the others.

    Args:
        data: a dataset, in whose images the board is then sought; or the observations of one's own
            detector.
        method: the paper's steps alone, or bundle adjustment, which starts from them.
        lens: lens model of all cameras, or by camera; "auto": the one that predicts held-out images
            best or, for the paper's method, the paper's: radial-tangential, and none for the narrow
            cameras.
        progress: see vergence.progress.

    Raises:
        VergenceError: the data are too poor for any answer, or contradict themselves; or an
            argument is none of these.
    """
    if not isinstance(data, (Dataset, Observations)):
        raise VergenceError(
            "calibrate takes a dataset, as of vg.load_dataset(folder), or observations; found "
            f"{data!r:.80}."
        )
    if method not in get_args(Method):
        raise VergenceError(f"method is {' or '.join(get_args(Method))}, found {method!r}.")
    if isinstance(data, Dataset):
        if data.moving.all():
            raise VergenceError(
                f"{data.folder} has moving rows only; the calibration starts from views in which "
                "the eyes stand still."
            )
        data = detect_target(data, progress=progress)
    data = without_strays(data)
    progress("calibrating", 0, 3)
    seen = data.take(data.at_rest)
    _check_views(seen)
    if method == "bundle":  # the paper's steps need the readings of some views only
        check_readings(data)
    lenses = _lenses(seen, method, lens)
    models: dict[str, LensModel] = {name: choice.model for name, choice in lenses.items()}
    intrinsics = calibrate_intrinsics(seen, lenses=models)
    points = corner_points(data.board)
    # Once for each image: all that follows asks for these.
    T_cam_target = {
        name: board_poses(each.camera, data.corners[name], points)
        for name, each in intrinsics.items()
    }
    encoders.check_encoders(seen, _take(T_cam_target, data.at_rest))
    check_axis_order(seen, _take(T_cam_target, data.at_rest))
    posed = check_pose_readings(data, T_cam_target)
    renumbered = board_flips.number_alike(posed.observations, T_cam_target)
    observations, T_cam_target = renumbered.observations, renumbered.T_cam_target
    seen, T_rest = observations.take(data.at_rest), _take(T_cam_target, data.at_rest)
    excitation.check_excitation(seen, T_rest)
    start = calibrate_sequentially(seen, intrinsics=intrinsics, T_cam_target=T_rest)
    progress("calibrating", 1, 3)
    if method == "paper":
        estimate, choice, std = None, (), {}
        head, accuracy = start.head, start.accuracy
        focal_std = {name: each.focal_std_px for name, each in intrinsics.items()}
    else:
        estimate = bundle_adjust(start.head, observations, T_cam_target=T_cam_target)
        estimate, choice = predicting_better(start.head, observations, T_cam_target, estimate)
        head, accuracy = estimate.head, estimate.accuracy
        std = dict(zip(estimate.parameters, np.sqrt(np.diag(estimate.covariance)), strict=True))
        focal_std = {name: (std[f"{name}.fx"], std[f"{name}.fy"]) for name in head.cameras}
    progress("calibrating", 2, 3)

    def of_part(rows: np.ndarray) -> PartCalibration:
        if estimate is not None:
            return bundle_of_part(estimate, observations, T_cam_target, rows)
        part = observations.take(rows)
        at_rest = part.take(part.at_rest)
        found = calibrate_sequentially(at_rest, lenses=models).head
        return PartCalibration(found, placed_boards(found, part, _take(T_cam_target, rows)), 1.0)

    at_the_edge = ()
    if estimate is not None:
        at_the_edge = edge_warnings(head, observations.corners, estimate.residuals_px)
    checked, doubts, contradictions = _cross_validated(observations, of_part)
    progress("calibrating", 3, 3)
    exchanged, unknown = (), ()
    if estimate is not None:
        exchanged, unknown = exchanged_readings(observations, head, estimate.T_base_eye)
    void = (*exchanged, *accuracy.void, *contradictions)
    odd_baseline = []
    measured_poses = observations.T_base_eye is not None
    if not measured_poses:  # whose bases may stand anywhere, as those of two arms do
        void += tuple(axes_and_eyes.doubts(head, std))
        odd_baseline = axes_and_eyes.odd_baseline(head)
    warnings = (
        *posed.warnings,
        *odd_baseline,
        *board_flips.warnings(renumbered),
        *excitation.doubts(observations, T_cam_target, head, focal_std),
        *accuracy.warnings,
        *at_the_edge,
        *doubts,
    )
    accuracy = replace(
        accuracy,
        eye_motion="poses" if measured_poses else "pan-tilt",
        held_out=checked,
        void=void,
        warnings=warnings,
    )
    remarks = (*observations.remarks, *board_flips.remarks(renumbered), *choice, *unknown)
    return CalibrationResult(
        replace(head, accuracy=accuracy),
        replace(observations, remarks=remarks),
        start,
        estimate,
        lenses,
    )


def _check_views(seen: Observations) -> None:
    """Raise a VergenceError for a camera of no known eye, or that shows the board too seldom."""
    camera_eyes(seen)
    for name, corners in seen.corners.items():
        enough = int((seen_corners(corners).sum(axis=1) >= LEAST_CORNERS).sum())
        if enough < LEAST_VIEWS:
            raise VergenceError(
                f"{name} shows the board in {enough} images at rest: fx, fy and T_eye_cam "
                f"are not observable; record at least {LEAST_VIEWS}, better 10, at different "
                "distances and slants."
            )


def _lenses(
    seen: Observations,
    method: Method,
    lens: Lens | Mapping[str, Lens],
) -> dict[str, LensChoice]:
    """Return the lens model of every camera."""
    if method == "paper":
        stated: dict[str, Lens] = {**lenses_of_the_paper(seen)}
        for name, each in by_camera(seen, lens).items():
            stated[name] = stated.get(name, each) if each == "auto" else each
        return choose_lenses(seen, stated)
    return choose_lenses(seen, lens)


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
    contradictions = _misfit(found)
    ratio = found.jackknife_ratio
    if ratio is None or ratio <= LARGEST_JACKKNIFE_RATIO:
        return found, (), contradictions
    said = f"Calibrations from parts of the views differ {ratio:.1f} times as much as stated: "
    views, few = len(observations.placement), ""
    if views < EACH_BELOW:
        few = f", or record more: {views} views are so few that parts of them determine too little"
    if ratio > VOID_RATIO:
        said += f"they contradict each other; look for views with wrong readings{few}."
        return found, (), (said, *contradictions)
    said += (
        "true errors are larger than the stated ones by as much at least; look for errors that "
        f"corners share (a board that bends, blur){few}."
    )
    return found, (said,), contradictions


def _misfit(checked: HeldOut) -> tuple[str, ...]:
    """Return a sentence if held-out points are too wrong for the calibration to be used."""
    if checked.point_mm is None or checked.expected_mm is None:
        return ()
    ratio = checked.point_mm / checked.expected_mm
    if ratio < VOID_MISFIT:
        return ()
    said = f"Held-out points are {ratio:.1f} times as wrong as the noise explains; {MISFIT_CAUSES}."
    return (said,)
