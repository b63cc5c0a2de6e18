"""How good a calibration is: on views that it has not seen, and by its covariance.

Two questions are answered. `held_out`: if the views are divided into folds and each is predicted
from the others, how wrong are pixels and points? `predicted_covariance`: how uncertain is a point
that is located at given eye angles, by what is uncertain of the calibration?
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vergence.arrays import Array
from vergence.calibration.sequential.intrinsics import seen_corners, target_poses
from vergence.calibration.sequential.sequential import Views
from vergence.data.timing import Timing, moved_readings
from vergence.errors import VergenceError
from vergence.geometry.board import corner_points
from vergence.geometry.camera import project
from vergence.geometry.head import Accuracy, HeadCalibration, HeldOut, main_pair
from vergence.geometry.kinematics import EYES, T_base_eye
from vergence.geometry.parameters import changed, difference
from vergence.geometry.se3 import inverse, transform
from vergence.stereo.triangulation import locate
from vergence.stereo.uncertainty import locate_with_covariance

FOLDS = 5
LEAST_CORNERS = 6
"""Of a board in an image, for it to say where the board is."""
_STEP = 1e-2  # of the central differences, in standard deviations: no rounding, no curvature


@dataclass(frozen=True, eq=False)
class Observations:
    """What a calibration is made from: V views, and how the eyes moved in them."""

    views: Views
    timing: Timing | None
    """When the readings were taken; None: the eyes stood still."""
    T_base_eye: Array | None
    """(V, 2, 4, 4) poses of the eyes, where these are given instead of angles."""

    def take(self, rows: np.ndarray) -> Observations:
        """Return some of the views, by index or by truth."""
        views = replace(
            self.views,
            placement=self.views.placement[rows],
            eye_angles=self.views.eye_angles[rows],
            corners={name: corners[rows] for name, corners in self.views.corners.items()},
        )
        return Observations(
            views,
            None if self.timing is None else self.timing.take(rows),
            None if self.T_base_eye is None else self.T_base_eye[rows],
        )


def folds(placement: np.ndarray, count: int = FOLDS) -> np.ndarray:
    """Return (V,) the fold of each view; the views of each placement are spread over all folds."""
    shuffled = np.random.default_rng(0).permutation(len(placement))
    order = shuffled[np.argsort(placement[shuffled], kind="stable")]
    numbers = np.empty(len(placement), dtype=int)
    numbers[order] = np.arange(len(placement)) % count
    return numbers


def held_out(
    observations: Observations,
    calibrate: Callable[[Observations], HeadCalibration],
    *,
    count: int = FOLDS,
) -> HeldOut:
    """Predict each fold of the views from a calibration by the others.

    Args:
        observations: all views.
        calibrate: makes a calibration from some of them.
        count: of the folds.

    Raises:
        VergenceError: a calibration fails.
    """
    if len(observations.views.placement) < count:
        raise VergenceError(
            f"A held-out error needs at least {count} views, found "
            f"{len(observations.views.placement)}."
        )
    number = folds(observations.views.placement, count)
    heads = [calibrate(observations.take(number != k)) for k in range(count)]
    errors = [_fold(head, observations, number == k) for k, head in enumerate(heads)]
    pixels, points, expected, distances = (
        [each for fold in errors for each in fold[kind]]
        for kind in ("pixels", "points", "expected", "distances")
    )
    return HeldOut(
        folds=count,
        transfer_views=len(pixels),
        transfer_px=_rms(pixels),
        point_views=len(points),
        point_mm=_rms(points, 1e3),
        expected_mm=_rms(expected, 1e3),
        distance_m=float(np.concatenate(distances).mean()) if distances else None,
        scatter=scatter(heads),
    )


def scatter(heads: Sequence[HeadCalibration]) -> float | None:
    """Return by how much calibrations without one fold each scatter more than they say they do.

    The jackknife over folds: its standard deviation of a parameter is that of the scatter, times
    (k - 1) / sqrt(k). It knows nothing of the noise model: where the errors of a view's corners
    are not independent it exceeds the stated one. None where no covariance is stated.
    """
    accuracy = heads[0].accuracy
    if accuracy is None or not accuracy.parameters:
        return None
    names = set.intersection(*(set(h.accuracy.parameters if h.accuracy else ()) for h in heads))
    rows = [i for i, name in enumerate(accuracy.parameters) if name in names]
    away = [difference(head, heads[0]) for head in heads]
    values = np.array([[each[accuracy.parameters[i]] for i in rows] for each in away])
    k = len(heads)
    variance = (k - 1) / k * ((values - values.mean(axis=0)) ** 2).sum(axis=0)
    # What is stated is that of k - 1 of k folds.
    stated_variance = np.diag(accuracy.covariance)[rows] * (k - 1) / k
    return float(np.sqrt((variance / stated_variance).mean()))


def _rms(errors: list[Array], unit: float = 1.0) -> float | None:
    return unit * float(np.sqrt((np.concatenate(errors) ** 2).mean())) if errors else None


def _fold(
    head: HeadCalibration, observations: Observations, mine: np.ndarray
) -> dict[str, list[Array]]:
    """Return the errors of the views of one fold, an array of corners for each view."""
    found: dict[str, list[Array]] = {"pixels": [], "points": [], "expected": [], "distances": []}
    main, narrow = main_pair(head), ("left_narrow", "right_narrow")
    if main is not None:
        found["pixels"] += _transferred(head, observations, mine, main)
        if observations.T_base_eye is None:
            _located(head, observations, mine, main, found)
    if set(narrow) <= set(head.cameras) and main != narrow:
        found["pixels"] += _transferred(head, observations, mine, narrow)
    return found


def timely(observations: Observations, head: HeadCalibration) -> Array:
    """Return (V, 4) the readings at the moments of the images."""
    readings, timing = observations.views.eye_angles, observations.timing
    return readings if timing is None else moved_readings(readings, timing, head.time_offset_s)


def _transferred(
    head: HeadCalibration, observations: Observations, mine: np.ndarray, pair: tuple[str, str]
) -> list[Array]:
    """Return for each view of both eyes the distances of corners from the prediction [px]."""
    views = observations.views
    both = np.all([seen_corners(views.corners[n]).sum(1) >= LEAST_CORNERS for n in pair], axis=0)
    rows = np.flatnonzero(both & mine)
    if not len(rows):
        return []
    points = corner_points(views.board)
    angles = timely(observations, head)[rows]
    T_base_cam = []
    for k, name in enumerate(pair):
        given = observations.T_base_eye
        eye = head.axes[EYES[k]]
        T = T_base_eye(angles[:, 2 * k : 2 * k + 2], eye) if given is None else given[rows, k]
        T_base_cam.append(T @ head.cameras[name].T_eye_cam)
    T_rcam_lcam = inverse(T_base_cam[1]) @ head.T_rbase_lbase @ T_base_cam[0]
    errors = []
    for source, target, T in ((0, 1, T_rcam_lcam), (1, 0, inverse(T_rcam_lcam))):
        lens = head.cameras[pair[source]].intrinsics
        T_target = T @ target_poses(lens, views.corners[pair[source]][rows], points)
        expected = project(
            head.cameras[pair[target]].intrinsics, transform(T_target[:, None], points)
        )
        errors.append(np.linalg.norm(expected - views.corners[pair[target]][rows], axis=-1))
    together = np.concatenate(errors, axis=1)
    return [row[np.isfinite(row)] for row in together]


def _located(
    head: HeadCalibration,
    observations: Observations,
    mine: np.ndarray,
    pair: tuple[str, str],
    found: dict[str, list[Array]],
) -> None:
    """Add for each view of a board at rest the distances of its corners from their place [m]."""
    views, angles = observations.views, timely(observations, head)
    V, K = views.corners[pair[0]].shape[:2]
    left, right = (views.corners[name].reshape(-1, 2) for name in pair)
    repeated = np.repeat(angles, K, axis=0)
    located = locate(head, left, right, repeated, cameras=pair).points.reshape(V, K, 3)
    seen = np.asarray(np.isfinite(located).all(axis=2))
    usable = np.zeros_like(seen)
    place = np.zeros_like(located)
    for number in np.unique(views.placement[mine]):
        there = views.placement == number
        counts = seen[there & ~mine].sum(axis=0)
        mean = np.nansum(located[there & ~mine], axis=0) / np.maximum(counts, 1)[:, None]
        usable[there & mine] = seen[there & mine] & (counts > 0)
        place[there & mine] = mean
    rows = np.flatnonzero(np.asarray(usable.any(axis=1)))
    for row in rows:
        here = usable[row]
        found["points"].append(np.linalg.norm(located[row, here] - place[row, here], axis=1))
        found["distances"].append(np.linalg.norm(located[row, here], axis=1))
    if len(rows) and head.accuracy and head.accuracy.parameters:
        # One corner of each view stands for it: a view's corners are equally far away.
        corner = [np.flatnonzero(usable[row])[usable[row].sum() // 2] for row in rows]
        left_px, right_px = (views.corners[name][rows, corner] for name in pair)
        spread = predicted_covariance(head, left_px, right_px, angles[rows], cameras=pair)
        found["expected"].append(np.sqrt(np.trace(spread, axis1=1, axis2=2)))


def predicted_covariance(
    head: HeadCalibration,
    pixels_l: Array,
    pixels_r: Array,
    eye_angles: Array,
    *,
    cameras: tuple[str, str] = ("left_wide", "right_wide"),
    pixel_std_px: float | None = None,
    joint_std_rad: Array | float | None = None,
) -> Array:
    """Return the covariance (N, 3, 3) [m^2] of points that `locate` finds: all that is uncertain.

    Args:
        head: with its accuracy.
        pixels_l: (N, 2) in the left camera; (N, 2) pixels_r in the right one.
        pixels_r: see pixels_l.
        eye_angles: (N, 4) joint readings [rad].
        cameras: names of the left and the right camera.
        pixel_std_px: noise of the pixels; None: that of the calibration's corners.
        joint_std_rad: noise of the readings, a number or (4,); None: as the calibration found it.
            0 for both leaves what the calibration alone adds.

    Raises:
        VergenceError: the head states no covariance.
    """
    accuracy = stated(head)
    pixel = accuracy.pixel_std_px if pixel_std_px is None else pixel_std_px
    joint = np.tile(accuracy.joint_std, 4)[:4] if joint_std_rad is None else joint_std_rad
    _, of_reading = locate_with_covariance(
        head,
        pixels_l,
        pixels_r,
        eye_angles,
        pixel_std_px=0.0 if pixel is None else pixel,
        joint_std_rad=joint,
        cameras=cameras,
    )
    return of_reading + calibration_covariance(
        head, pixels_l, pixels_r, eye_angles, cameras=cameras
    )


def calibration_covariance(
    head: HeadCalibration,
    pixels_l: Array,
    pixels_r: Array,
    eye_angles: Array,
    *,
    cameras: tuple[str, str] = ("left_wide", "right_wide"),
) -> Array:
    """Return what the calibration's covariance adds (N, 3, 3) [m^2] to points that are located.

    Args and errors: see predicted_covariance.
    """
    accuracy = stated(head)
    # Along the principal axes of the covariance, where a step of fixed probability is harmless.
    std = np.sqrt(np.diag(accuracy.covariance))
    scale = np.where(std > 0, std, 1.0)
    values, vectors = np.linalg.eigh(accuracy.covariance / np.outer(scale, scale))
    axes = (vectors * np.sqrt(np.maximum(values, 0.0))).T * scale
    total = np.zeros((len(pixels_l), 3, 3))
    for axis in axes:
        points = [
            locate(
                changed(head, accuracy.parameters, sign * _STEP * axis),
                pixels_l,
                pixels_r,
                eye_angles,
                cameras=cameras,
            ).points
            for sign in (1, -1)
        ]
        moved = (points[0] - points[1]) / (2 * _STEP)
        total += moved[:, :, None] * moved[:, None, :]
    return total


def stated(head: HeadCalibration) -> Accuracy:
    """Return the accuracy of a head.

    Raises:
        VergenceError: it has none, or one without a covariance.
    """
    if head.accuracy is None or not head.accuracy.parameters:
        raise VergenceError(
            "This calibration states no covariance; `vergence calibrate --method refined` makes "
            "one that does."
        )
    return head.accuracy
