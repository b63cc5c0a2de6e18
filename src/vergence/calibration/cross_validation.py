"""How good a calibration is on views that it has not seen.

The views are divided into folds, and each is predicted from a calibration by the others: how wrong
are pixels and points, and do the calibrations differ from each other as much as they state?
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle_adjustment import BundleEstimate, NoiseModel, bundle_adjust
from vergence.calibration.initial import calibrate_sequentially
from vergence.calibration.intrinsics import FOLDS, calibrate_intrinsics
from vergence.calibration.observations import Observations, camera_eyes
from vergence.calibration.prepared_views import PreparedViews
from vergence.errors import VergenceError
from vergence.findings import Finding, void, warning
from vergence.geometry.board import corner_points
from vergence.geometry.camera import project
from vergence.geometry.head import (
    HeadCalibration,
    lenses_of,
    main_pair,
    narrow_camera,
    parameter_names,
    states_covariance,
)
from vergence.geometry.head_accuracy import HeldOut
from vergence.geometry.kinematics import EYES
from vergence.geometry.parameters import boxminus
from vergence.geometry.projection import project_at
from vergence.geometry.se3 import inverse, transform
from vergence.stereo.extrinsics import relative_camera_pose
from vergence.stereo.triangulation import triangulate_at
from vergence.stereo.uncertainty import combination
from vergence.vision.board_pose import LEAST_CORNERS, board_poses, seen_corners

EACH_BELOW = 20
"""Number of views below which leave-one-out is used."""
JACKKNIFE_LIMITS = 2.0, 10.0
"""Ratios of standard deviations from which the stated ones are doubted (the folds determine it to
about a tenth), and from which the result is void."""
MISFIT_LIMITS = 1.5, 5.0
"""The same of the held-out error and its expectation; with ten views or more of both eyes the ratio
stays below the first."""


@dataclass(frozen=True, eq=False)
class PartCalibration:
    """A calibration from a part of the views, by which the others are predicted."""

    head: HeadCalibration
    T_lbase_target: Mapping[int, Array]
    """By number of the placement, where the board stood in this part; empty: not estimated."""
    board_scale: float
    """Size of the board relative to the stated one."""


def folds(placement: np.ndarray) -> np.ndarray:
    """Return (V,) the fold of each view; the views of each placement are spread over all folds.

    There are FOLDS of them, or as many as views if these are fewer than EACH_BELOW.
    """
    count = FOLDS if len(placement) >= EACH_BELOW else max(1, len(placement))
    shuffled = np.random.default_rng(0).permutation(len(placement))
    order = shuffled[np.argsort(placement[shuffled], kind="stable")]
    numbers = np.empty(len(placement), dtype=int)
    numbers[order] = np.arange(len(placement)) % count
    return numbers


def calibrate_folds(
    observations: Observations, calibrate_part: Callable[[np.ndarray], PartCalibration]
) -> list[PartCalibration]:
    """Return for each fold of the views a calibration by the others.

    `calibrate_part` makes a calibration from the views of a mask (V,). VergenceError if there are
    fewer views than folds, or a calibration fails.
    """
    if len(observations.placement) < FOLDS:
        raise VergenceError(
            f"A held-out error needs at least {FOLDS} views, found {len(observations.placement)}."
        )
    number = folds(observations.placement)
    return [calibrate_part(number != k) for k in range(number.max() + 1)]


def predicted_squares(observations: Observations, parts: Sequence[PartCalibration]) -> Array:
    """Return (V, 2) the sum of squared prediction errors [px^2] and the number of corners.

    A corner is predicted from the reading of its own view and from the fold's calibration, with
    the board where the other views of its placement show it; zeros where none does. Before cameras
    that stand still it is where all cameras of its own view show it together.
    """
    number, points = folds(observations.placement), corner_points(observations.board)
    found = np.zeros((len(number), 2))
    for k, part in enumerate(parts):
        if observations.eye_motion == "fixed":
            part = _placed(part, observations.take(number == k))
        head, views = part.head, observations.at_image_times(part.head)
        eye_poses = views.eye_poses(head)
        known = np.isin(views.placement, list(part.T_lbase_target))
        rows = np.flatnonzero(known & (number == k))
        boards = np.array([part.T_lbase_target[int(p)] for p in views.placement[rows]])
        if not len(rows):
            continue
        on_boards = transform(boards[:, None], part.board_scale * points)
        for name, mounted in head.cameras.items():
            if name not in views.corners:
                continue
            T = eye_poses[rows, EYES.index(mounted.eye)]
            expected = project_at(mounted, head.T_rbase_lbase, T, on_boards)
            squares = ((expected - views.corners[name][rows]) ** 2).sum(axis=2)
            found[rows, 0] += np.nansum(squares, axis=1)
            found[rows, 1] += np.isfinite(squares).sum(axis=1)
    return found


def _placed(part: PartCalibration, views: Observations) -> PartCalibration:
    """Place the boards of held-out views by the views themselves."""
    head = part.head
    noise = NoiseModel(None if head.accuracy is None else head.accuracy.pixel_std_px)
    found = bundle_adjust(head, views, fixed=parameter_names(head), noise=noise)
    return replace(part, T_lbase_target=found.T_lbase_target)


def held_out(
    observations: Observations, parts: Sequence[PartCalibration], whole: HeadCalibration
) -> HeldOut:
    """Predict each fold of the views from its calibration, one of `calibrate_folds`.

    `whole` is the calibration from all views, with its accuracy.
    """
    number, heads = folds(observations.placement), [part.head for part in parts]
    squares, corners = predicted_squares(observations, parts).sum(axis=0)
    pixels, points, expected, distances = [], [], [], []
    transferred: set[int] = set()
    for k, part in enumerate(parts):
        head = part.head
        main = main_pair(head)
        if main is None:
            continue
        left, right = (narrow_camera(lenses_of(head, eye)) for eye in EYES)
        for pair in dict.fromkeys([main, (left, right)]):
            errors = _transferred(part, observations, number == k, pair)
            pixels += errors.values()
            transferred |= errors.keys()  # a view may be seen by both pairs
        found = _located(head, observations, number == k, main)
        for every, own in zip((points, expected, distances), found, strict=True):
            every.extend(own)
    return HeldOut(
        folds=len(parts),
        prediction_px=float(np.sqrt(squares / corners)) if corners else None,
        transfer_views=len(transferred),
        transfer_px=_rms(pixels),
        point_views=len(points),
        point_mm=_rms(points, 1e3),
        expected_mm=_rms(expected, 1e3),
        distance_m=float(np.concatenate(distances).mean()) if distances else None,
        jackknife_ratio=jackknife_ratio(whole, heads),
    )


def jackknife_ratio(whole: HeadCalibration, parts: Sequence[HeadCalibration]) -> float | None:
    """Compare the differences between calibrations from parts and the whole with those stated.

    A ratio of standard deviations over all parameters, 1 for independent errors of the stated size;
    None where a calibration states no covariance, or there are fewer than two parts.

    The covariance of the difference is that of the part less that of the whole. With many views
    both are nearly the same, and the sum over k folds is k / (k - 1) times the covariance of the
    whole, as in the usual jackknife; with few views a part knows much less.
    """
    stated = [
        dict(zip(a.parameters, np.diag(a.covariance), strict=True)) if a else {}
        for a in (head.accuracy for head in (whole, *parts))
    ]
    names = [name for name in stated[0] if all(name in each for each in stated)]
    if not names or len(parts) < 2:
        return None
    variance, *of_parts = ([each[name] for name in names] for each in stated)
    k = len(parts)
    less_known = np.sum(of_parts, axis=0) - k * np.array(variance)
    expected = np.maximum(less_known, k / (k - 1) * np.array(variance))
    away = [boxminus(part, whole) for part in parts]
    differ = np.square([[each[name] for name in names] for each in away]).sum(axis=0)
    return float(np.sqrt((differ / expected).mean()))


def _readings(views: Observations) -> Array:
    """Return joint readings (V, r), or measured poses (V, 2, 4, 4)."""
    return views.eye_angles if views.T_base_eye is None else views.T_base_eye


def _rms(errors: list[Array], unit: float = 1.0) -> float | None:
    """Compute the root mean square of errors; None: one of them, or all, are missing."""
    found = unit * float(np.sqrt((np.concatenate(errors) ** 2).mean())) if errors else np.nan
    return found if np.isfinite(found) else None


def _transferred(
    part: PartCalibration, observations: Observations, mine: np.ndarray, pair: tuple[str, str]
) -> dict[int, Array]:
    """Return by view of both eyes the distances of corners from the prediction [px]."""
    head = part.head
    seen = [seen_corners(observations.corners[name]).sum(axis=1) for name in pair]
    rows = np.flatnonzero((np.min(seen, axis=0) >= LEAST_CORNERS) & mine)
    views = observations.at_image_times(head).take(rows)  # readings move along all their neighbours
    if not len(views.placement):
        return {}
    points = part.board_scale * corner_points(views.board)
    between = relative_camera_pose(head, _readings(views), cameras=pair)
    errors = []
    for source, target, T in ((0, 1, between), (1, 0, inverse(between))):
        lenses = [head.cameras[pair[k]].intrinsics for k in (source, target)]
        T_target = T @ board_poses(lenses[0], views.corners[pair[source]], points)
        expected = project(lenses[1], transform(T_target[:, None], points))
        errors.append(np.linalg.norm(expected - views.corners[pair[target]], axis=-1))
    together = np.concatenate(errors, axis=1)
    return {row: own[np.isfinite(own)] for row, own in zip(rows.tolist(), together, strict=True)}


def _located(
    head: HeadCalibration, observations: Observations, mine: np.ndarray, pair: tuple[str, str]
) -> tuple[list[Array], list[Array], list[Array]]:
    """Return by view errors of corners of boards at rest [m]; expected errors and distances [m]."""
    views = observations.at_image_times(head)
    V, K = views.corners[pair[0]].shape[:2]
    left, right = (views.corners[name].reshape(-1, 2) for name in pair)
    readings = _readings(views)
    joints = np.repeat(readings, K, axis=0)
    points, _ = triangulate_at(head, left=left, right=right, joints=joints, cameras=pair)
    located = points.reshape(V, K, 3)
    seen = np.asarray(np.isfinite(located).all(axis=2))
    usable = np.zeros_like(seen)
    place = np.zeros_like(located)
    for number in np.unique(views.placement[mine]):
        there = views.placement == number
        counts = seen[there & ~mine].sum(axis=0)
        usable[there & mine] = seen[there & mine] & (counts > 0)
        total = np.nansum(located[there & ~mine], axis=0)
        place[there & mine] = total / np.maximum(counts, 1)[:, None]
    rows = np.flatnonzero(np.asarray(usable.any(axis=1)))
    errors, distances = np.linalg.norm(located - place, axis=2), np.linalg.norm(located, axis=2)
    expected = []
    if len(rows) and states_covariance(head):
        for row in rows:
            # One corner of each view stands for it: a view's corners are equally far away.
            corner = int(np.flatnonzero(usable[row])[usable[row].sum() // 2])
            others = np.flatnonzero(
                seen[:, corner] & ~mine & (views.placement == views.placement[row])
            )
            each = np.append(row, others)
            left, right = (views.corners[name][each, corner] for name in pair)
            # The calibration's errors are in all views, and cancel as far as these are alike.
            _, covariance = combination(
                head,
                weights=np.append(1.0, np.full(len(others), -1 / len(others))),
                left=left,
                right=right,
                joints=readings[each],
                cameras=pair,
            )
            expected.append(np.sqrt([np.trace(covariance)]))
    off, away = ([each[row, usable[row]] for row in rows] for each in (errors, distances))
    return off, expected, away


def cross_validate(
    observations: Observations,
    head: HeadCalibration,
    of_part: Callable[[np.ndarray], PartCalibration],
) -> tuple[HeldOut | None, list[Finding]]:
    """Predict each fold of the views from a calibration by the others, of `of_part`.

    Returns the errors, and what they show of the calibration `head` from all views.
    """
    try:
        found = held_out(observations, calibrate_folds(observations, of_part), head)
    except VergenceError as error:
        sentence = f"There is no held-out error: {error}"
        return None, [warning("no-held-out-error", sentence)]
    if not found.transfer_views and len(set(camera_eyes(observations).values())) > 1:
        sentence = "There is no held-out error of points: no view shows the board to both eyes."
        return found, [warning("no-held-out-points", sentence)]
    ratio, misfit = found.jackknife_ratio or 0.0, 0.0
    if found.point_mm is not None and found.expected_mm is not None:
        misfit = found.point_mm / found.expected_mm
    findings = []
    for code, value, limits, sentence in (
        (
            "held-out-misfit",
            misfit,
            MISFIT_LIMITS,
            f"Held-out points are {misfit:.1f} times as wrong as the noise explains; look for a "
            "board that moved or bends, and time stamps of moving eyes.",
        ),
        (
            "stated-too-small",
            ratio,
            JACKKNIFE_LIMITS,
            f"Calibrations from parts of the views differ {ratio:.1f} times as much as stated, and "
            "true errors are larger by as much; look for wrong readings, and for errors that "
            "corners share (a board that bends, blur).",
        ),
    ):
        if value > limits[0]:
            severity = void if value > limits[1] else warning
            findings.append(severity(code, sentence))
    return found, findings


def bundle_of_part(
    estimate: BundleEstimate, views: PreparedViews, rows: np.ndarray
) -> PartCalibration:
    """Return the calibration from a part of the views (V,), at the noise that all of them show."""
    part, T_part = views.take(rows)
    lenses = None
    if part.T_base_eye is not None:
        lenses = calibrate_intrinsics(part.take(part.at_rest), lenses=views.models)
    found = bundle_adjust(
        estimate.head,
        part,
        T_cam_target=T_part,
        noise=NoiseModel(levels=estimate.levels),
        intrinsics=lenses,
    )
    head = replace(found.head, accuracy=replace(found.accuracy, joint_std=estimate.joint_std))
    return PartCalibration(head, found.T_lbase_target, found.board_scale)


def paper_of_part(views: PreparedViews, rows: np.ndarray) -> PartCalibration:
    """Calibrate a part of the views (V,) by the paper's steps."""
    part, _ = views.take(rows)
    head = calibrate_sequentially(part.take(part.at_rest), lenses=views.models).head
    return PartCalibration(head, {}, 1.0)
