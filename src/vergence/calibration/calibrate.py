"""A dataset, or corners and readings, in; a calibrated head with its accuracy out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import get_args

import numpy as np

from vergence.arrays import single_blas_thread
from vergence.calibration import excitation, plausibility
from vergence.calibration.bundle_adjustment import BundleEstimate, bundle_adjust
from vergence.calibration.bundle_findings import WRONG_VIEW
from vergence.calibration.cross_validation import (
    bundle_of_part,
    cross_validate,
    paper_of_part,
)
from vergence.calibration.detection import detect_target
from vergence.calibration.initial import SequentialCalibration, calibrate_sequentially
from vergence.calibration.lens_choice import LensChoice, LensOption
from vergence.calibration.observations import Observations
from vergence.calibration.prepared_views import Method, PreparedViews, prepare
from vergence.calibration.summary import inaccurate, summary_lines
from vergence.data.dataset import Dataset
from vergence.errors import VergenceError
from vergence.findings import Finding, by_severity, select
from vergence.geometry.head import HeadCalibration
from vergence.geometry.head_accuracy import Accuracy
from vergence.progress import Progress, silent


@dataclass(frozen=True, eq=False)
class CalibrationResult:
    """A calibrated head, and everything that is known about its quality."""

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
        """Write at most ten lines: good or not, how good, what to do next."""
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
        data: a dataset, in whose images the board is then detected; or the observations of another
            detector.
        method: the paper's steps alone, or bundle adjustment, which starts from them.
        lens: lens model of all cameras, or by camera; "auto": selected for each by how well it fits
            and predicts its views or, for the paper's method, the paper's: radial-tangential, and
            none for the narrow cameras.
        progress: see vergence.progress.

    Raises:
        VergenceError: the data are too poor for any answer, or contradict themselves; or an
            argument is not one of these.
    """
    observations = _observe(data, method, progress)
    progress("calibrating", 0, 3)
    views = prepare(observations, method, lens)
    observations, at_rest = views.observations, views.at_rest
    start = calibrate_sequentially(at_rest[0], intrinsics=views.intrinsics, T_cam_target=at_rest[1])
    progress("calibrating", 1, 3)
    estimate, findings = None, list(observations.findings)
    of_part = partial(paper_of_part, views)
    if method == "bundle":
        # Measured poses may err in ways that a lens would follow.
        lenses = None if observations.T_base_eye is None else views.intrinsics
        estimate = bundle_adjust(
            start.head, observations, T_cam_target=views.T_cam_target, intrinsics=lenses
        )
        findings = [*select(estimate.findings, "note", "warning", code=WRONG_VIEW), *findings]
        views = views.without(estimate.left_out)
        of_part = partial(bundle_of_part, estimate, views)
    progress("calibrating", 2, 3)
    found = start if estimate is None else estimate
    head = replace(found.head, accuracy=found.accuracy)
    held_out, validated = cross_validate(views.observations, head, of_part)
    progress("calibrating", 3, 3)
    findings += [*_about(views, head), *found.accuracy.findings, *validated]
    accuracy = replace(
        found.accuracy,
        eye_motion=observations.eye_motion,
        held_out=held_out,
    )
    findings += inaccurate(replace(head, accuracy=accuracy))
    head = replace(head, accuracy=replace(accuracy, findings=by_severity(findings)))
    return CalibrationResult(head, observations, start, estimate, views.lenses)


def _observe(data: Dataset | Observations, method: Method, progress: Progress) -> Observations:
    """Detect the board in a dataset; VergenceError for arguments of another kind."""
    if not isinstance(data, (Dataset, Observations)):
        raise VergenceError(
            "calibrate takes a dataset, as of vg.load_dataset(folder), or observations; found "
            f"{data!r:.80}."
        )
    if method not in get_args(Method):
        raise VergenceError(f"method is {' or '.join(get_args(Method))}, found {method!r}.")
    if isinstance(data, Observations):
        return data
    _ = data.board  # VergenceError without one
    if data.moving.all():
        raise VergenceError(
            f"{data.folder} has moving rows only; the calibration starts from views in which "
            "the eyes stand still."
        )
    return detect_target(data, progress=progress)


def _about(views: PreparedViews, head: HeadCalibration) -> list[Finding]:
    """Judge the result by what a head can be, and the boards by what they determine."""
    accuracy = head.accuracy
    assert accuracy is not None
    stds = np.sqrt(np.diag(accuracy.covariance)).tolist()
    std = dict(zip(accuracy.parameters, stds, strict=True))
    unknown = [name for name in head.cameras if name not in views.observations.known_lenses]
    focal_std = {name: views.intrinsics[name].focal_std_px for name in unknown}
    if std:
        focal_std = {name: (std[f"{name}.fx"], std[f"{name}.fy"]) for name in unknown}
    # Bases of measured poses may stand anywhere, as those of two arms do.
    poses = views.observations.T_base_eye is not None
    moving = not views.observations.at_rest.all()
    return [
        *([] if poses else plausibility.implausible_geometry(head)),
        *excitation.stretched_board(*views.at_rest, views.intrinsics, moving=moving),
        *excitation.doubtful_focal_lengths(head, focal_std),
    ]
