"""A dataset in, a calibrated head with its accuracy out: what `vergence calibrate` calls."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from rich.progress import Progress

from vergence.arrays import Array
from vergence.calibration.bundle.problem import POSE
from vergence.calibration.bundle.refine import Refined, held_by_default, refine
from vergence.calibration.checks import board_flips, encoders, excitation
from vergence.calibration.checks.cross_validation import Observations, held_out
from vergence.calibration.detection import LEAST_CORNERS, Detections, detect
from vergence.calibration.sequential import sequential
from vergence.calibration.sequential.intrinsics import Intrinsics, LensModel, seen_corners
from vergence.calibration.sequential.sequential import PaperCalibration, Views, eyes_of
from vergence.data.dataset import Dataset
from vergence.data.reader import load_dataset
from vergence.errors import VergenceError
from vergence.geometry.head import Accuracy, HeadCalibration, HeldOut, main_pair

Method = Literal["refined", "paper"]
LEAST_VIEWS = 3
"""Of a camera, for its intrinsics."""
MOST_SCATTER = 2.0
"""Ratio of standard deviations from which the stated ones are called too small. The folds tell it
to about a tenth."""


@dataclass(frozen=True, eq=False)
class Answer:
    """What calibration makes of observations."""

    head: HeadCalibration
    """With its accuracy."""
    start: PaperCalibration
    """By the paper's method."""
    refined: Refined | None
    """None: the paper's method was asked for."""
    seen: Observations
    """With boards that were numbered from the wrong end turned."""
    remarks: tuple[str, ...]
    """What was repaired."""


@dataclass(frozen=True, eq=False)
class Solved:
    """A calibration and all that a report says of it."""

    head: HeadCalibration
    """With its accuracy."""
    dataset: Dataset
    detections: Detections
    """With boards that were numbered from the wrong end turned."""
    start: PaperCalibration
    """By the paper's method."""
    refined: Refined | None
    """None: the paper's method was asked for."""


def solve(
    folder: Path,
    *,
    method: Method = "refined",
    wide_lens: LensModel = "radial-tangential",
    progress: Progress | None = None,
) -> Solved:
    """Calibrate a head from a dataset folder.

    Args:
        folder: see docs/dataset.md.
        method: the paper's steps, or one estimate of everything that starts from them.
        wide_lens: distortion of the wide cameras; the narrow ones have none.
        progress: gets bars; None: silent.

    Raises:
        VergenceError: the dataset is faulty, or too poor for any answer.
    """
    dataset = load_dataset(folder)
    _check_rest(dataset)
    detections = detect(dataset, progress=progress)
    seen = Observations(detections.views, detections.timing, detections.T_base_eye)
    task = progress.add_task("calibrating", total=3) if progress else None

    def advance() -> None:
        if progress and task is not None:
            progress.advance(task)

    found = answer(seen, method=method, wide_lens=wide_lens, done=advance)
    detections = replace(
        detections, views=found.seen.views, remarks=(*detections.remarks, *found.remarks)
    )
    return Solved(found.head, dataset, detections, found.start, found.refined)


def answer(
    seen: Observations,
    *,
    method: Method = "refined",
    wide_lens: LensModel = "radial-tangential",
    done: Callable[[], None] = lambda: None,
) -> Answer:
    """Calibrate a head from corners and readings, and predict each fold of them from the others.

    Args:
        seen: what the cameras saw of the board, and how the eyes stood.
        method: the paper's steps, or one estimate of everything that starts from them.
        wide_lens: distortion of the wide cameras; the narrow ones have none.
        done: called after each of three steps.

    Raises:
        VergenceError: the observations are too poor for any answer, or contradict themselves.
    """
    found = estimate(seen, method=method, wide_lens=wide_lens, done=done)
    refined = found.refined
    if refined is None:
        checked, said = _checked(found.seen, lambda part: paper(part, wide_lens).head)
    else:
        checked, said = _checked(found.seen, lambda part: again(refined, part))
    done()
    accuracy = found.head.accuracy
    assert accuracy is not None
    accuracy = replace(accuracy, held_out=checked, warnings=(*accuracy.warnings, *said))
    return replace(found, head=replace(found.head, accuracy=accuracy))


def estimate(
    seen: Observations,
    *,
    method: Method = "refined",
    wide_lens: LensModel = "radial-tangential",
    done: Callable[[], None] = lambda: None,
) -> Answer:
    """Calibrate a head from corners and readings; its accuracy lacks the held-out error.

    Args and errors: see answer.
    """
    still = _still(seen)
    _check_seen(seen.views, still)
    lenses = sequential.lenses(seen.take(still).views, wide_lens=wide_lens)
    encoders.check_readings(seen.take(still), lenses)
    repaired = board_flips.repair(
        seen.views,
        {name: each.camera for name, each in lenses.items()},
        T_base_eye_read=seen.T_base_eye,
    )
    seen = replace(seen, views=repaired.views)
    excitation.check_motion(seen.take(still), lenses)
    start = paper(seen, wide_lens, lenses)
    done()
    refined = _refined(start.head, seen)
    done()
    motion = "pan-tilt" if seen.T_base_eye is None else "poses"
    if method == "paper":
        head, accuracy = start.head, Accuracy(method="paper")
        focal = {name: each.focal_std_px for name, each in lenses.items()}
    else:
        head = with_accuracy(refined)
        assert head.accuracy is not None
        accuracy = head.accuracy
        std = dict(zip(refined.parameters, np.sqrt(np.diag(refined.covariance)), strict=True))
        focal = {name: (std[f"{name}.fx"], std[f"{name}.fy"]) for name in head.cameras}
    # What the data cannot determine is the same for either method, and so is what looks odd.
    doubts = (*encoders.doubts(head), *excitation.doubts(seen, head, focal))
    said = (*board_flips.warnings(repaired), *doubts, *refined.warnings)
    return Answer(
        replace(head, accuracy=replace(accuracy, eye_motion=motion, warnings=said)),
        start,
        refined if method == "refined" else None,
        seen,
        board_flips.remarks(repaired),
    )


def _check_rest(dataset: Dataset) -> None:
    if dataset.moving.all():
        raise VergenceError(
            f"{dataset.folder} has moving rows only; the calibration starts from views in which "
            "the eyes stand still."
        )


def _check_seen(views: Views, still: np.ndarray) -> None:
    for name, corners in views.corners.items():
        enough = seen_corners(corners[still]).sum(axis=1) >= LEAST_CORNERS
        if enough.sum() < LEAST_VIEWS:
            raise VergenceError(
                f"{name} shows the board in {enough.sum()} images at rest: fx, fy and T_eye_cam "
                f"are not observable; record at least {LEAST_VIEWS}, better 10, at different "
                "distances and slants."
            )


def paper(
    seen: Observations, wide_lens: LensModel, lenses: Mapping[str, Intrinsics] | None = None
) -> PaperCalibration:
    """Return the paper's calibration from the views in which the eyes stood still.

    Args:
        seen: all views.
        wide_lens: see solve.
        lenses: of these views, where they are known.
    """
    rest = seen.take(_still(seen))
    return sequential.calibrate(
        rest.views, wide_lens=wide_lens, intrinsics=lenses, eye_poses_read=rest.T_base_eye
    )


def _still(seen: Observations) -> np.ndarray:
    """Return (V,) in which views the eyes stood still."""
    return np.ones(len(seen.views.placement), bool) if seen.timing is None else seen.timing.run == 0


def _refined(start: HeadCalibration, seen: Observations) -> Refined:
    return refine(
        start,
        seen.views,
        timing=seen.timing,
        eye_poses_read=seen.T_base_eye,
        hold=_held(start, seen),
    )


def _held(start: HeadCalibration, seen: Observations) -> set[str]:
    """Return what is not estimated: with one eye, where the other one is."""
    held = held_by_default(start, timed=seen.timing is not None)
    if main_pair(start) is None:
        held |= {f"T_rbase_lbase.{name}" for name in POSE}
    return held


def again(whole: Refined, part: Observations) -> HeadCalibration:
    """Return the calibration from a part of the views, at the noise that all of them show."""
    levels = whole.joint_std
    # refine takes one level for all joints when it is told; the folds are but little the worse.
    told = _mean_level(levels) if part.T_base_eye is None else (levels[0], levels[-1])
    head = with_accuracy(
        refine(
            whole.head,
            part.views,
            timing=part.timing,
            eye_poses_read=part.T_base_eye,
            hold=_held(whole.head, part),
            pixel_std_px=whole.pixel_std_px,
            joint_std=told,
        )
    )
    assert head.accuracy is not None
    return replace(head, accuracy=replace(head.accuracy, joint_std=levels))


def with_accuracy(refined: Refined) -> HeadCalibration:
    """Return the head of a refinement with what is known of its accuracy."""
    estimated = np.flatnonzero(np.diag(refined.covariance) > 0)
    accuracy = Accuracy(
        method="refined",
        parameters=tuple(refined.parameters[i] for i in estimated),
        covariance=_symmetric(refined.covariance[np.ix_(estimated, estimated)]),
        pixel_std_px=refined.pixel_std_px,
        joint_std=refined.joint_std,
        warnings=refined.warnings,
    )
    return replace(refined.head, time_offset_s=refined.time_offset_s, accuracy=accuracy)


def _mean_level(levels: tuple[float, ...]) -> float:
    return float(np.sqrt(np.mean(np.square(levels))))


def _symmetric(matrix: Array) -> Array:
    return (matrix + matrix.T) / 2


def _checked(
    seen: Observations, calibrate: Callable[[Observations], HeadCalibration]
) -> tuple[HeldOut | None, tuple[str, ...]]:
    """Return the held-out error, or why there is none."""
    try:
        found = held_out(seen, calibrate)
    except VergenceError as error:
        return None, (f"There is no held-out error: {error}",)
    if not found.transfer_views and len(set(eyes_of(seen.views).values())) > 1:
        return found, ("There is no held-out error: no view shows the board to both eyes.",)
    if found.scatter is not None and found.scatter > MOST_SCATTER:
        return found, (
            f"Calibrations from parts of the views scatter {found.scatter:.1f} times as much as "
            "stated: the errors of the corners are not independent (a board that bends, blur), "
            "and true errors are larger than the stated ones by as much at least.",
        )
    return found, ()
