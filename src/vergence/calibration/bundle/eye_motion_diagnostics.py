"""What the motion of the eyes lacks for a calibration: in words."""

from __future__ import annotations

import numpy as np

from vergence.arrays import Array
from vergence.calibration.bundle.adjustment import Adjusted
from vergence.calibration.bundle.problem import (
    BundleProblem,
    detection_eye_poses,
    detection_eyes,
    latent_readings,
)
from vergence.errors import listed
from vergence.findings import Finding, void
from vergence.geometry.kinematics import EYES
from vergence.geometry.se3 import rotvec

SMALL_RAD = 0.05
"""Motion below this is small beside the +-0.25 rad of a good recording."""
ADVISED = "by at least 0.1 rad, better 0.25"
"""Median stated deviation of the worst axis, 20 views at 0.1 px and 0.1 degrees, board at 0.4 m:
0.92 degrees and 2.6 mm for motion within 0.03 rad, 0.27 and 0.8 within 0.1, 0.10 and 0.3 within
0.25."""
SENSE = 6.0
"""Motion, as a multiple of the noise of its mean, from which its sense is beyond doubt."""


def missing_motion(problem: BundleProblem, found: Adjusted, eyes: list[int]) -> str:
    """Return what the motion of the eyes lacks."""
    eye = detection_eyes(problem)
    shared = set(problem.placement[eye == 0]) & set(problem.placement[eye == 1])
    if len(eyes) == 2 and not shared:
        return "no board stands where both eyes see it; show the same board to both"
    causes = [cause for e in eyes if (eye == e).any() for cause in _motion(problem, found, e)]
    return ", ".join(causes) or (
        "the views do not distinguish it from other unknowns; record more of them, with pan and "
        "tilt moved by 0.25 rad and boards at several distances and slants"
    )


def _motion(problem: BundleProblem, found: Adjusted, eye: int) -> list[str]:
    """Return what is wrong with the motion of one eye before boards at rest."""
    whose = _whose(problem, eye)
    detections, which = _views(problem, eye)
    if np.bincount(which).max() < 2:
        return [f"{whose} sees each board in one view only; let it move before a board at rest"]
    if problem.T_base_eye_read is not None:
        R = detection_eye_poses(problem, found.state)[detections, :3, :3]
        first = np.unique(which, return_index=True)[1]
        turns = rotvec(np.swapaxes(R[first][which], 1, 2) @ R)
        reach = np.linalg.svd(turns, compute_uv=False) / np.sqrt(len(turns))
        if reach[0] < SMALL_RAD:
            return [f"{whose} turns by {reach[0]:.2g} rad only; turn it {ADVISED}"]
        if reach[1] < SMALL_RAD:
            return [
                f"all turns of {whose} share one axis to within {reach[1]:.2g} rad; "
                f"turn it about another axis as well, {ADVISED}"
            ]
        return []
    joints, angles, levels = _angles(problem, found, eye)
    away = _away(angles[problem.block[detections]], which)
    causes = []
    for joint, own, level in zip(joints, away.T, levels, strict=True):
        reach = np.abs(own).max()
        if np.sqrt((own**2).mean()) <= 1.5 * level:
            causes.append(
                f"all {joint} motion of {whose} ({reach:.2g} rad) is no larger than its noise "
                f"({level:.2g} rad); move {joint} {ADVISED}"
            )
        elif reach < SMALL_RAD:
            causes.append(
                f"{joint} of {whose} moves by {reach:.2g} rad only; move {joint} {ADVISED}"
            )
    together = np.linalg.svd(away, compute_uv=False)[-1] / np.sqrt(len(away))
    if not causes and together < SMALL_RAD / 3:
        causes.append(f"{listed(joints)} of {whose} move together; move one without the other")
    return causes


def doubtful_senses(problem: BundleProblem, found: Adjusted, eye: int) -> list[Finding]:
    """Return a finding for each joint whose motion is so small that its sense is uncertain."""
    detections, which = _views(problem, eye)
    if problem.T_base_eye_read is not None or np.bincount(which).max() < 2:
        return []
    joints, angles, levels = _angles(problem, found, eye)
    length = np.linalg.norm(_away(angles[problem.block[detections]], which), axis=0)
    return [
        void(
            "doubtful-sense",
            f"Readings of {joint} of {_whose(problem, eye)} hardly follow its motion: the noise is "
            f"{level:.2g} rad, and even the sense of the motion is uncertain.",
            f"{joint} of {_whose(problem, eye)}",
        )
        for joint, size, level in zip(joints, length, levels, strict=True)
        if size < SENSE * level
    ]


def _views(problem: BundleProblem, eye: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a detection of each board by an eye in each view, and before which placement it is."""
    mine = np.flatnonzero(detection_eyes(problem) == eye)
    pairs = np.stack([problem.block[mine], problem.placement[mine]])
    (_, placement), first = np.unique(pairs, axis=1, return_index=True)
    return mine[first], np.unique(placement, return_inverse=True)[1]


def _angles(problem: BundleProblem, found: Adjusted, eye: int) -> tuple[list[str], Array, Array]:
    """Return the joints of an eye: their names, angles (B, n) and the noise of each (n,) [rad]."""
    kinematics = found.state.head.kinematics
    mixing = kinematics.chains[EYES[eye]].mixing
    mine = problem.block[detection_eyes(problem) == eye][0]
    std = np.zeros(len(kinematics.readings))
    std[problem.block_columns[mine]] = found.noise.joint
    names = [joint.name for joint in kinematics.eyes[EYES[eye]]]
    angles = latent_readings(problem, found.state) @ mixing.T
    return names, angles, np.sqrt(mixing**2 @ std**2)


def _away(angles: Array, which: np.ndarray) -> Array:
    """Return the angles (N, n) less their mean before each placement."""
    counts = np.bincount(which)
    means = np.stack([np.bincount(which, column) / counts for column in angles.T], axis=-1)
    return angles - means[which]


def _whose(problem: BundleProblem, eye: int) -> str:
    return "the eye" if len(problem.cameras) == 1 else f"the {EYES[eye]} eye"
