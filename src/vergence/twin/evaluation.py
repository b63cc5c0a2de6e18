"""The ground truth of a dataset recorded on the twin, and the errors of its calibration.

The truth is truth.json in the dataset's folder. Only evaluation reads it; calibration never does.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass
from scipy.stats import chi2

from vergence.arrays import Array, Matrix, Transform
from vergence.errors import VergenceError
from vergence.files import read_json
from vergence.geometry.board import Board
from vergence.geometry.head import HeadCalibration
from vergence.geometry.joints import Joint
from vergence.geometry.kinematics import EYES, Kinematics, Side, same_design
from vergence.geometry.parameters import boxminus, without_offsets
from vergence.geometry.se3 import angle, inverse
from vergence.twin.profile import ErrorProfile

TRUTH = "truth.json"
"""Name of the file in the folder of the dataset."""
REGION = 0.95
"""Probability of a confidence region."""


@dataclass(frozen=True, eq=False, config=ConfigDict(extra="forbid"))
class Truth:
    """Ground truth of a dataset."""

    head: HeadCalibration
    """The head as built, with gains and offsets that turn joint readings into true angles."""
    time_offset_s: float
    """Time from a joint reading to the moment that its image shows."""
    eye_angles: Matrix
    """(N, r) true angles [rad] at the moment of each row's images, in the order of the readings."""
    T_lbase_target: dict[int, Transform]
    """True pose of the board, by the number of its placement."""
    board: Board
    """The board as printed; dataset.json may state wrong dimensions."""
    seed: int
    lens: str
    profile: ErrorProfile
    format: Literal["vergence-truth-1"] = "vergence-truth-1"


def load_truth(path: Path) -> Truth:
    """Read a truth.json. Raises VergenceError as `read_json` does."""
    return read_json(path, Truth, TRUTH)


@dataclass(frozen=True)
class ParameterError:
    """Error of one parameter; None where no standard deviation is stated."""

    error: float
    """Estimate minus truth: px, rad, m, s, or a plain number."""
    std: float | None = None
    standardised: float | None = None
    """error / std."""
    within_95: bool | None = None
    """Whether the error is within 1.96 standard deviations."""


@dataclass(frozen=True)
class Region:
    """Joint confidence region of a group of parameters, such as one camera's lens."""

    parameters: int
    distance: float
    """Mahalanobis distance of the truth from the estimate."""
    holds_truth: bool
    """Whether the truth lies inside the 95 % region."""


@dataclass(frozen=True)
class CameraError:
    """Errors of one camera's T_eye_cam and focal length."""

    rotation_deg: float
    translation_mm: float
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

    Offsets of the joints are expressed as rotations of the mountings, from which images cannot
    distinguish them. VergenceError if the truth lacks a camera or has other joints.
    """
    eyes: set[Side] = {mounted.eye for mounted in head.cameras.values()}
    true_kinematics = truth.head.kinematics
    if absent := set(head.cameras) - set(truth.head.cameras):
        raise VergenceError(f"The truth is of another head: it has no camera {min(absent)}.")
    if not same_design(true_kinematics, head.kinematics, eyes):
        raise VergenceError(
            "The truth is of another head: its joints have other axes, places or readings than "
            "those of the calibration."
        )
    same: dict[Side, tuple[Joint, ...]] = {
        eye: (true_kinematics if eye in eyes else head.kinematics).eyes[eye] for eye in EYES
    }
    true_head = replace(truth.head, kinematics=Kinematics(same, true_kinematics.readings))
    errors = boxminus(head, replace(true_head, time_offset_s=truth.time_offset_s))
    estimated, true = without_offsets(head), without_offsets(true_head)
    cameras = {}
    for name, mounted in estimated.cameras.items():
        pose_error = _pose_error(mounted.T_eye_cam, true.cameras[name].T_eye_cam)
        K, K_true = mounted.intrinsics.matrix, true.cameras[name].intrinsics.matrix
        focal = 100 * np.abs(np.diag(K)[:2] / np.diag(K_true)[:2] - 1).max()
        cameras[name] = CameraError(*pose_error, focal_percent=float(focal))
    base_rotation_deg, base_translation_mm = _pose_error(
        estimated.T_rbase_lbase, true.T_rbase_lbase
    )
    parameters = {name: ParameterError(error) for name, error in errors.items()}
    regions: dict[str, Region] = {}
    if head.accuracy is not None:
        names, covariance = head.accuracy.parameters, head.accuracy.covariance
        for name, std in zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True):
            score = errors[name] / std
            within = bool(score**2 <= chi2.ppf(REGION, 1))
            parameters[name] = ParameterError(errors[name], std, score, within)
        groups: dict[str, list[int]] = {}
        for k, name in enumerate(names):
            groups.setdefault(name.rpartition(".")[0] or name, []).append(k)
        for group, rows in groups.items():
            error = np.array([errors[names[k]] for k in rows])
            regions[group] = _region(error, covariance[np.ix_(rows, rows)])
    return Evaluation(
        cameras=cameras,
        base_rotation_deg=base_rotation_deg,
        base_translation_mm=base_translation_mm,
        time_offset_ms=1e3 * errors["time_offset_s"],
        regions=regions,
        parameters=parameters,
    )


def _pose_error(T: Array, T_true: Array) -> tuple[float, float]:
    """Compute the angle [deg] and the distance [mm] between two poses."""
    turn = np.degrees(angle((inverse(T) @ T_true)[:3, :3]))
    return float(turn), float(1e3 * np.linalg.norm(T[:3, 3] - T_true[:3, 3]))


def _region(error: Array, covariance: Array) -> Region:
    scale = np.sqrt(np.diag(covariance))
    score = error / scale
    correlation = covariance / np.outer(scale, scale)
    squared = float(score @ np.linalg.pinv(correlation, hermitian=True) @ score)
    limit = chi2.ppf(REGION, len(error))
    return Region(len(error), float(np.sqrt(squared)), bool(squared <= limit))
