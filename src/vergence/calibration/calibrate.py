"""A dataset, or corners and readings, in; a calibrated head with its accuracy out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import get_args

import numpy as np

from vergence.arrays import single_blas_thread
from vergence.calibration.bundle_adjustment import BundleEstimate, bundle_adjust
from vergence.calibration.checked_views import CheckedViews, Method, checked_views
from vergence.calibration.checks import axes_and_eyes, board_flips, board_shape, excitation
from vergence.calibration.checks.cross_validation import PartCalibration
from vergence.calibration.checks.exchanged_readings import exchanged_readings
from vergence.calibration.checks.part_calibration import (
    bundle_of_part,
    placed_boards,
    predicting_better,
)
from vergence.calibration.checks.stray_corners import without_outliers, without_strays
from vergence.calibration.detection import detect_target
from vergence.calibration.initial import SequentialCalibration, calibrate_sequentially
from vergence.calibration.lens_choice import LensChoice, LensOption
from vergence.calibration.observations import Observations
from vergence.calibration.summary import summary_lines
from vergence.calibration.validation import cross_validated
from vergence.data.dataset import Dataset
from vergence.errors import VergenceError
from vergence.findings import Finding, by_severity
from vergence.geometry.head import HeadCalibration
from vergence.geometry.head_accuracy import Accuracy
from vergence.progress import Progress, silent


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """A calibrated head, and all that is known of how good it is."""

    head: HeadCalibration
    """With its accuracy and the findings."""
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
    def findings(self) -> tuple[Finding, ...]:
        """Everything that was noticed about the data and the result, the most severe first."""
        return self.accuracy.findings

    def summary(self) -> str:
        """Return at most ten lines: good or not, how good, what to do next."""
        return "\n".join(summary_lines(self.head, self.observations))


@single_blas_thread()
def calibrate(
    data: Dataset | Observations,
    *,
    method: Method = "bundle",
    lens: LensOption | Mapping[str, LensOption] = "auto",
    progress: Progress = silent,
) -> CalibrationResult:
    """Calibrate a head, and predict each fold of its views from the others.

    Args:
        data: a dataset, in whose images the board is then sought; or the observations of one's own
            detector.
        method: the paper's steps alone, or bundle adjustment, which starts from them.
        lens: lens model of all cameras, or by camera; "auto": selected for each by how well it fits
            and predicts its views or, for the paper's method, the paper's: radial-tangential, and
            none for the narrow cameras.
        progress: see vergence.progress.

    Raises:
        VergenceError: the data are too poor for any answer, or contradict themselves; or an
            argument is none of these.
    """
    data = without_strays(_observed(data, method, progress))
    progress("calibrating", 0, 3)
    views = checked_views(data, method, lens)
    observations, T_cam_target = views.observations, views.T_cam_target
    seen, T_rest = views.at_rest
    start = calibrate_sequentially(seen, intrinsics=views.intrinsics, T_cam_target=T_rest)
    progress("calibrating", 1, 3)
    estimate, preferred = None, ()
    if method == "bundle":
        estimate = bundle_adjust(start.head, observations, T_cam_target=T_cam_target)
        estimate, preferred = predicting_better(start.head, observations, T_cam_target, estimate)
    progress("calibrating", 2, 3)
    found = start if estimate is None else estimate
    whole = replace(found.head, accuracy=found.accuracy)
    validated = cross_validated(
        _to_be_predicted(observations, estimate), whole, partial(_calibrate_part, views, estimate)
    )
    progress("calibrating", 3, 3)
    findings = [*observations.findings, *views.pose_findings]
    findings += [*board_flips.findings(views.renumbered), *preferred]
    if estimate is not None:
        findings += exchanged_readings(observations, found.head, estimate.T_base_eye)
        if not observations.at_rest.all():
            findings += board_shape.stretched_in_motion(*views.at_rest, views.intrinsics)
    findings += [*_about_result(views, found), *validated.findings]
    accuracy = replace(
        found.accuracy,
        eye_motion="pan-tilt" if observations.T_base_eye is None else "poses",
        held_out=validated.held_out,
        findings=by_severity((*findings, *_impossible_geometry(views, found))),
    )
    head = replace(found.head, accuracy=accuracy)
    return CalibrationResult(head, observations, start, estimate, views.lenses)


def _observed(data: Dataset | Observations, method: Method, progress: Progress) -> Observations:
    """Return the observations, sought in the images of a dataset; errors are those of calibrate."""
    if not isinstance(data, (Dataset, Observations)):
        raise VergenceError(
            "calibrate takes a dataset, as of vg.load_dataset(folder), or observations; found "
            f"{data!r:.80}."
        )
    if method not in get_args(Method):
        raise VergenceError(f"method is {' or '.join(get_args(Method))}, found {method!r}.")
    if isinstance(data, Observations):
        return data
    if data.moving.all():
        raise VergenceError(
            f"{data.folder} has moving rows only; the calibration starts from views in which "
            "the eyes stand still."
        )
    return detect_target(data, progress=progress)


def _to_be_predicted(observations: Observations, estimate: BundleEstimate | None) -> Observations:
    """Return the observations without outliers, which the estimate did not follow either."""
    if estimate is None or not estimate.camera_std_px:
        return observations
    return without_outliers(observations, estimate.residuals_px, estimate.camera_std_px)


def _calibrate_part(
    views: CheckedViews, estimate: BundleEstimate | None, rows: np.ndarray
) -> PartCalibration:
    """Return the calibration from some of the views (V,) by the same method; None: the paper's."""
    if estimate is not None:
        return bundle_of_part(estimate, views.observations, views.T_cam_target, rows)
    part, T_part = views.take(rows)
    head = calibrate_sequentially(part.take(part.at_rest), lenses=views.models).head
    return PartCalibration(head, placed_boards(head, part, T_part), 1.0)


def _impossible_geometry(
    views: CheckedViews, found: SequentialCalibration | BundleEstimate
) -> list[Finding]:
    """Return findings on axes and eyes that the calibration puts where none can be.

    Bases of measured poses may stand anywhere, as those of two arms do.
    """
    if views.observations.T_base_eye is not None:
        return []
    return axes_and_eyes.impossible_geometry(found.head, _stds(found))


def _about_result(
    views: CheckedViews, found: SequentialCalibration | BundleEstimate
) -> tuple[Finding, ...]:
    """Return what the data could not determine, and what is odd in the result."""
    observations, head = views.observations, found.head
    odd_baseline = []
    if observations.T_base_eye is None:
        odd_baseline = axes_and_eyes.odd_baseline(head)
    focal_std = {name: each.focal_std_px for name, each in views.intrinsics.items()}
    if isinstance(found, BundleEstimate):
        std = _stds(found)
        focal_std = {name: (std[f"{name}.fx"], std[f"{name}.fy"]) for name in head.cameras}
    return (
        *odd_baseline,
        *board_shape.stretched_board(*views.at_rest, views.intrinsics),
        *excitation.doubtful_focal_lengths(observations, views.T_cam_target, head, focal_std),
        *found.accuracy.findings,
    )


def _stds(found: SequentialCalibration | BundleEstimate) -> dict[str, float]:
    """Return the stated standard deviations by parameter; the paper's method states none."""
    if not isinstance(found, BundleEstimate):
        return {}
    return dict(zip(found.parameters, np.sqrt(np.diag(found.covariance)).tolist(), strict=True))
