"""Compare a calibration with the ground truth: errors, and coverage of the stated accuracy."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from pydantic.dataclasses import dataclass
from scipy.stats import chi2

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import EYES, Kinematics, Side, same_design
from vergence.geometry.parameters import boxminus, without_offsets
from vergence.geometry.se3 import angle, inverse
from vergence.twin.truth import Truth

REGION = 0.95


@dataclass(frozen=True)
class ParameterError:
    """Error of one parameter of the calibration."""

    error: float
    """Estimate minus truth: px, rad, m, s, or a plain number."""
    std: float | None
    """Stated standard deviation; None: it was not estimated, or no accuracy is stated."""
    standardised: float | None
    """error / std."""
    within_95: bool | None
    """Whether the error is within 1.96 standard deviations."""


@dataclass(frozen=True)
class Region:
    """Joint confidence region of a group of parameters, for example of one camera's lens."""

    parameters: int
    distance: float
    """Mahalanobis distance of the truth from the estimate."""
    holds_truth: bool
    """Whether the truth lies inside the 95 % region."""


@dataclass(frozen=True)
class CameraError:
    """Errors of one camera."""

    rotation_deg: float
    """Rotation error of T_eye_cam."""
    translation_mm: float
    """Translation error of T_eye_cam."""
    focal_percent: float
    """The larger of the errors of fx and fy."""


@dataclass(frozen=True)
class Evaluation:
    """Errors of a calibration."""

    cameras: dict[str, CameraError]
    base_rotation_deg: float
    """Rotation error of T_rbase_lbase."""
    base_translation_mm: float
    """Translation error of T_rbase_lbase."""
    time_offset_ms: float
    """Error of the time offset."""
    regions: dict[str, Region]
    """By group: <camera>, <camera>.T_eye_cam, T_rbase_lbase, <eye>, time_offset_s."""
    parameters: dict[str, ParameterError]


def evaluate(head: HeadCalibration, truth: Truth) -> Evaluation:
    """Compare a calibration with the truth.

    Images cannot distinguish offsets of the joints from rotations of the mountings, so both heads
    are compared with the offsets expressed as rotations. VergenceError if the truth lacks a camera,
    or its joints are others.
    """
    missing = [name for name in head.cameras if name not in truth.head.cameras]
    if missing:
        raise VergenceError(
            f"The truth is of another head: it has no camera {missing[0]}, only "
            f"{', '.join(truth.head.cameras)}."
        )
    eyes: set[Side] = {mounted.eye for mounted in head.cameras.values()}
    known = truth.head.kinematics
    if not same_design(known, head.kinematics, eyes):
        raise VergenceError(
            f"The truth is of another head: its joints are {_joints(known, eyes)}, those of the "
            f"calibration {_joints(head.kinematics, eyes)}."
        )
    same: dict[Side, tuple[Joint, ...]] = {
        eye: (known if eye in eyes else head.kinematics).eyes[eye] for eye in EYES
    }
    true_head = replace(truth.head, kinematics=Kinematics(same, known.readings))
    errors = boxminus(head, replace(true_head, time_offset_s=truth.time_offset_s))
    mine, true = without_offsets(head), without_offsets(true_head)
    cameras = {}
    for name, mounted in mine.cameras.items():
        turn, shift = _apart(mounted.T_eye_cam, true.cameras[name].T_eye_cam)
        K, K_true = mounted.intrinsics.matrix, true.cameras[name].intrinsics.matrix
        focal = 100 * np.abs(np.diag(K)[:2] / np.diag(K_true)[:2] - 1).max()
        cameras[name] = CameraError(turn, shift, float(focal))
    turn, shift = _apart(mine.T_rbase_lbase, true.T_rbase_lbase)
    names, covariance = (), np.empty((0, 0))
    if head.accuracy is not None:
        names, covariance = head.accuracy.parameters, head.accuracy.covariance
    stds = dict(zip(names, np.sqrt(np.diag(covariance)), strict=True))
    return Evaluation(
        cameras=cameras,
        base_rotation_deg=turn,
        base_translation_mm=shift,
        time_offset_ms=1e3 * errors["time_offset_s"],
        regions=_regions(names, covariance, errors),
        parameters={name: _parameter(error, stds.get(name)) for name, error in errors.items()},
    )


def _joints(kinematics: Kinematics, eyes: Collection[Side]) -> str:
    """Return the joints of some eyes in words."""
    return ", ".join(
        f"{eye} {joint.name} about {' '.join(f'{x:.5g}' for x in joint.axis)} through "
        f"{' '.join(f'{x:.5g}' for x in joint.point_m)} m by "
        + " and ".join(f"{factor:g} {reading}" for reading, factor in joint.readings.items())
        for eye, joints in kinematics.eyes.items()
        if eye in eyes
        for joint in joints
    )


def _apart(T: Array, T_true: Array) -> tuple[float, float]:
    """Return the angle [deg] and the distance [mm] between two poses."""
    turn = np.degrees(angle((inverse(T) @ T_true)[:3, :3]))
    return float(turn), float(1e3 * np.linalg.norm(T[:3, 3] - T_true[:3, 3]))


def _parameter(error: float, std: float | None) -> ParameterError:
    if std is None:
        return ParameterError(error, None, None, None)
    score = error / float(std)
    within = bool(score**2 <= chi2.ppf(REGION, 1))
    return ParameterError(error, float(std), score, within)


def _regions(
    names: tuple[str, ...], covariance: Array, errors: dict[str, float]
) -> dict[str, Region]:
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        groups.setdefault(name.rpartition(".")[0] or name, []).append(i)
    regions = {}
    for group, rows in groups.items():
        error = np.array([errors[names[i]] for i in rows])
        scale = np.sqrt(np.diag(covariance)[rows])
        correlation = covariance[np.ix_(rows, rows)] / np.outer(scale, scale)
        score = error / scale
        squared = float(score @ np.linalg.pinv(correlation, hermitian=True) @ score)
        limit = chi2.ppf(REGION, len(rows))
        regions[group] = Region(len(rows), float(np.sqrt(squared)), bool(squared <= limit))
    return regions
