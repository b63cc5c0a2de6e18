"""A dataset, or corners and readings, in; a calibrated head with its accuracy out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal, NamedTuple, get_args

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle.bundle_adjustment import BundleEstimate, bundle_adjust
from vergence.calibration.checks import (
    axes_and_eyes,
    board_flips,
    board_shape,
    encoders,
    excitation,
)
from vergence.calibration.checks.cross_validation import (
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
    Intrinsics,
    calibrate_intrinsics,
    lenses_of_the_paper,
)
from vergence.calibration.sequential.lens_choice import (
    LensChoice,
    LensOption,
    by_camera,
    choose_lenses,
)
from vergence.calibration.sequential.lens_models import LensModel
from vergence.calibration.sequential.sequential import SequentialCalibration, calibrate_sequentially
from vergence.calibration.summary import MISFIT_CAUSES, summary_lines
from vergence.data.dataset import Dataset
from vergence.errors import VergenceError
from vergence.geometry.board import corner_points
from vergence.geometry.head import HeadCalibration
from vergence.geometry.head_accuracy import Accuracy, HeldOut
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
    views = _checked_views(data, method, lens)
    observations, T_cam_target = views.observations, views.T_cam_target
    seen, T_rest = _at_rest(observations, T_cam_target)
    start = calibrate_sequentially(seen, intrinsics=views.intrinsics, T_cam_target=T_rest)
    progress("calibrating", 1, 3)
    estimate, preferred = None, ()
    if method == "bundle":
        estimate = bundle_adjust(start.head, observations, T_cam_target=T_cam_target)
        estimate, preferred = predicting_better(start.head, observations, T_cam_target, estimate)
    progress("calibrating", 2, 3)
    found = start if estimate is None else estimate
    whole = replace(found.head, accuracy=found.accuracy)
    validated = _cross_validated(observations, whole, partial(_calibrate_part, views, estimate))
    progress("calibrating", 3, 3)
    exchanged, unknown = (), ()
    if estimate is not None:
        exchanged, unknown = exchanged_readings(observations, found.head, estimate.T_base_eye)
    void = (*exchanged, *found.accuracy.void, *validated.contradictions)
    accuracy = replace(
        found.accuracy,
        eye_motion="pan-tilt" if observations.T_base_eye is None else "poses",
        held_out=validated.held_out,
        void=(*void, *_impossible_geometry(views, found)),
        warnings=(*_warnings(views, found), *validated.doubts),
    )
    remarks = (
        *observations.remarks,
        *board_flips.remarks(views.renumbered),
        *preferred,
        *unknown,
    )
    return CalibrationResult(
        replace(found.head, accuracy=accuracy),
        replace(observations, remarks=remarks),
        start,
        estimate,
        views.lenses,
    )


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


@dataclass(frozen=True, eq=False)
class _CheckedViews:
    """Observations that no check has refused, and what the checks found on the way."""

    renumbered: board_flips.Renumbered
    """The observations, in which each placement's boards are numbered from the same end."""
    lenses: dict[str, LensChoice]
    """By camera."""
    intrinsics: Mapping[str, Intrinsics]
    """By camera, from the views at rest."""
    pose_warnings: tuple[str, ...]
    """On measured eye poses that were left out."""

    @property
    def observations(self) -> Observations:
        return self.renumbered.observations

    @property
    def T_cam_target(self) -> Mapping[str, Array]:
        """By camera: (V, 4, 4) poses of the board, NaN where not known."""
        return self.renumbered.T_cam_target


def _checked_views(
    data: Observations, method: Method, lens: LensOption | Mapping[str, LensOption]
) -> _CheckedViews:
    """Return the views after all checks that precede a calibration: VergenceError if one fails."""
    seen = data.take(data.at_rest)
    _check_views(seen)
    if method == "bundle":  # the paper's steps need the readings of some views only
        check_readings(data)
    lenses = _lenses(seen, method, lens)
    intrinsics = calibrate_intrinsics(seen, lenses=_models(lenses))
    points = corner_points(data.board)
    # Once for each image: all that follows asks for these.
    T_cam_target = {
        name: board_poses(each.camera, data.corners[name], points)
        for name, each in intrinsics.items()
    }
    posed = check_pose_readings(data, T_cam_target)
    renumbered = board_flips.number_alike(posed.observations, T_cam_target)
    at_rest = _at_rest(renumbered.observations, renumbered.T_cam_target)
    # Of boards that one eye numbers from the other end the cameras seem to stand elsewhere.
    encoders.check_encoders(*at_rest)
    check_axis_order(*at_rest)
    excitation.check_excitation(*at_rest)
    return _CheckedViews(renumbered, lenses, intrinsics, posed.warnings)


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
    lens: LensOption | Mapping[str, LensOption],
) -> dict[str, LensChoice]:
    """Return the lens model of every camera."""
    if method == "paper":
        stated: dict[str, LensOption] = {**lenses_of_the_paper(seen)}
        for name, each in by_camera(seen, lens).items():
            stated[name] = stated.get(name, each) if each == "auto" else each
        return choose_lenses(seen, stated)
    return choose_lenses(seen, lens)


def _models(lenses: Mapping[str, LensChoice]) -> dict[str, LensModel]:
    return {name: choice.model for name, choice in lenses.items()}


def _take(T_cam_target: Mapping[str, Array], rows: np.ndarray) -> dict[str, Array]:
    return {name: T[rows] for name, T in T_cam_target.items()}


def _at_rest(
    observations: Observations, T_cam_target: Mapping[str, Array]
) -> tuple[Observations, dict[str, Array]]:
    """Return the views in which the eyes stand still, and the board's poses in them."""
    rows = observations.at_rest
    return observations.take(rows), _take(T_cam_target, rows)


def _calibrate_part(
    views: _CheckedViews, estimate: BundleEstimate | None, rows: np.ndarray
) -> PartCalibration:
    """Return the calibration from some of the views (V,) by the same method; None: the paper's."""
    if estimate is not None:
        return bundle_of_part(estimate, views.observations, views.T_cam_target, rows)
    part = views.observations.take(rows)
    at_rest = part.take(part.at_rest)
    head = calibrate_sequentially(at_rest, lenses=_models(views.lenses)).head
    return PartCalibration(head, placed_boards(head, part, _take(views.T_cam_target, rows)), 1.0)


class _Validation(NamedTuple):
    """What cross-validation found."""

    held_out: HeldOut | None
    doubts: tuple[str, ...] = ()
    """What is doubtful, among it why there is no held-out error."""
    contradictions: tuple[str, ...] = ()
    """Why the result must not be used."""


def _cross_validated(
    observations: Observations,
    whole: HeadCalibration,
    of_part: Callable[[np.ndarray], PartCalibration],
) -> _Validation:
    """Predict each fold of the views from a calibration by the others, of `of_part`."""
    try:
        found = held_out(observations, calibrate_folds(observations, of_part), whole)
    except VergenceError as error:
        return _Validation(None, (f"There is no held-out error: {error}",))
    if not found.transfer_views and len(set(camera_eyes(observations).values())) > 1:
        return _Validation(
            found, ("There is no held-out error: no view shows the board to both eyes.",)
        )
    contradictions = _misfit(found)
    ratio = found.jackknife_ratio
    if ratio is None or ratio <= LARGEST_JACKKNIFE_RATIO:
        return _Validation(found, contradictions=contradictions)
    said = f"Calibrations from parts of the views differ {ratio:.1f} times as much as stated: "
    if ratio > VOID_RATIO:
        said += "they contradict each other; look for views with wrong readings."
        return _Validation(found, contradictions=(said, *contradictions))
    said += (
        "true errors are larger than the stated ones by as much at least; look for errors that "
        "corners share (a board that bends, blur)."
    )
    return _Validation(found, (said,), contradictions)


def _misfit(checked: HeldOut) -> tuple[str, ...]:
    """Return a sentence if held-out points are too wrong for the calibration to be used."""
    if checked.point_mm is None or checked.expected_mm is None:
        return ()
    ratio = checked.point_mm / checked.expected_mm
    if ratio < VOID_MISFIT:
        return ()
    said = f"Held-out points are {ratio:.1f} times as wrong as the noise explains; {MISFIT_CAUSES}."
    return (said,)


def _impossible_geometry(
    views: _CheckedViews, found: SequentialCalibration | BundleEstimate
) -> list[str]:
    """Return sentences on axes and eyes that the calibration puts where none can be.

    Bases of measured poses may stand anywhere, as those of two arms do.
    """
    if views.observations.T_base_eye is not None:
        return []
    return axes_and_eyes.doubts(found.head, _stds(found))


def _warnings(
    views: _CheckedViews, found: SequentialCalibration | BundleEstimate
) -> tuple[str, ...]:
    """Return what the data could not determine, and what is odd in the result."""
    observations, head = views.observations, found.head
    odd_baseline, at_the_edge = [], ()
    if observations.T_base_eye is None:
        odd_baseline = axes_and_eyes.odd_baseline(head)
    focal_std = {name: each.focal_std_px for name, each in views.intrinsics.items()}
    if isinstance(found, BundleEstimate):
        std = _stds(found)
        focal_std = {name: (std[f"{name}.fx"], std[f"{name}.fy"]) for name in head.cameras}
        at_the_edge = edge_warnings(head, observations.corners, found.residuals_px)
    return (
        *views.pose_warnings,
        *odd_baseline,
        *board_flips.warnings(views.renumbered),
        *board_shape.warnings(*_at_rest(observations, views.T_cam_target), views.intrinsics),
        *excitation.doubts(observations, views.T_cam_target, head, focal_std),
        *found.accuracy.warnings,
        *at_the_edge,
    )


def _stds(found: SequentialCalibration | BundleEstimate) -> dict[str, float]:
    """Return the stated standard deviations by parameter; the paper's method states none."""
    if not isinstance(found, BundleEstimate):
        return {}
    return dict(zip(found.parameters, np.sqrt(np.diag(found.covariance)).tolist(), strict=True))
