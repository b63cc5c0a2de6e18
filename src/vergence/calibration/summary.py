"""How good a calibration is, in ten lines: good or not, how good, what to do next."""

from __future__ import annotations

import numpy as np

from vergence.calibration.cross_validation import MISFIT_CAUSES
from vergence.calibration.observations import NO_CORNERS, UNREADABLE_IMAGE, Observations
from vergence.calibration.plausibility import eye_shift
from vergence.errors import counted, listed
from vergence.findings import select
from vergence.geometry.head import (
    HeadCalibration,
    base_pose,
    main_pair,
)
from vergence.geometry.head_accuracy import Accuracy
from vergence.geometry.kinematics import reading_kinds, readings_to_turn
from vergence.geometry.parameters import without_offsets
from vergence.geometry.projection import project_point
from vergence.geometry.se3 import inverse, transform
from vergence.stereo.uncertainty import locate
from vergence.vision.board_pose import seen_corners

POOR_FIT = 1.5
"""Ratio of the held-out error to its expectation, from which something is amiss; with ten views or
more of both eyes it stays below."""
LARGEST_EXPECTED = 0.1
"""Error that noise explains, relative to the distance, from which held-out points check nothing."""
PART, SMALL = 1 / 3, 0.002
"""Largest error by the calibration, relative to that by a reading's noise (both together are then a
twentieth larger), and error relative to the distance that is always small."""
MOST_NOTES = 2
"""Number of notes that a summary repeats; the report has all."""
DISTANCES_M = (0.3, 0.6, 1.0)
"""Distances of the points whose accuracy is stated: the range of a hand, and beyond."""
DIFFER = 1.5
"""Ratio of the noise of cameras from which it is stated from least to most."""
AROUND_RAD = 0.2
"""Angle from straight ahead of the gaze directions over which that accuracy is stated."""


def verdict(accuracy: Accuracy, head: HeadCalibration) -> tuple[str, str]:
    """Judge a calibration in one word, and say what to do next.

    GOOD: the stated accuracy can be believed, and more views would not make points much better.
    VOID: the calibration must not be used. DOUBTFUL: something is amiss, unknown, or inaccurate.
    """
    if accuracy.void:
        return "VOID", accuracy.void[0].sentence
    warnings = select(accuracy.findings, "warning")
    doubt = str(warnings[0]) if warnings else _doubt(accuracy, head)
    if doubt:
        return "DOUBTFUL", f"Next: {doubt}"
    return "GOOD", "Next: nothing; more views would not make points much better."


def _doubt(accuracy: Accuracy, head: HeadCalibration) -> str:
    """Say why the accuracy is not good, or not known; empty: it is good."""
    checked = accuracy.held_out
    if accuracy.method == "paper" or checked is None:
        return "the paper's method states no accuracy; calibrate with --method bundle."
    if checked.point_mm is not None and checked.expected_mm is not None:
        if checked.expected_mm > LARGEST_EXPECTED * 1e3 * (checked.distance_m or np.inf):
            return (
                "record more views in which both eyes see the board (`vergence plan` says which); "
                "held-out points check nothing, since noise explains errors of "
                f"{checked.expected_mm:.0f} mm at {checked.distance_m:.2f} m."
            )
        ratio = checked.point_mm / checked.expected_mm
        if ratio > POOR_FIT:
            return (
                f"held-out points are {ratio:.1f} times as wrong as the noise explains; "
                f"{MISFIT_CAUSES}."
            )
    table = point_accuracy(head)
    if not table:
        return (
            "look at the standard deviations; the accuracy of a point is stated for heads of two "
            "eyes with joint readings."
        )
    for distance, by_calibration, by_reading in table:
        if by_calibration > max(PART * by_reading, SMALL * 1e3 * distance):
            return (
                "record more views (`vergence plan` says which), or larger eye motion; at "
                f"{distance:g} m the calibration adds {by_calibration:.1f} mm to the "
                f"{by_reading:.1f} mm of a reading's noise."
            )
    return ""


def point_accuracy(head: HeadCalibration) -> list[tuple[float, float, float]]:
    """Return at some distances [m] what calibration and what one reading add to a point [mm].

    Root mean square over a motion: both eyes turn in parallel while the gaze goes round a point
    that stays ahead. Without the distances at which they do not both see it; empty where the head
    states no covariance, has one eye, or eyes whose poses are measured.
    """
    accuracy, pair = head.accuracy, main_pair(head)
    if accuracy is None or not accuracy.parameters or pair is None:
        return []
    if accuracy.eye_motion == "poses":
        return []
    plain, phase = without_offsets(head), np.arange(8) * np.pi / 4
    turns = np.stack([np.zeros(8), np.sin(phase), np.cos(phase)], axis=1)
    joints = readings_to_turn(head.kinematics, AROUND_RAD * turns)
    T_lbase_head, rows = inverse(base_pose(plain, "left")), []
    for distance in DISTANCES_M:
        # Both eyes turn in the same sense; the point stays in the middle of the head.
        point = transform(T_lbase_head, np.array([distance, 0.0, 0.0]))
        left, right = (project_point(plain, name, joints, point) for name in pair)
        found = locate(head, left=left, right=right, joints=joints)
        of_head = found.calibration_covariance
        by_head, by_reading = (
            1e3 * float(np.sqrt(np.trace(each, axis1=1, axis2=2).mean()))
            for each in (of_head, found.covariance - of_head)
        )
        if np.isfinite([by_head, by_reading]).all():
            rows.append((distance, by_head, by_reading))
    return rows


def summary_lines(head: HeadCalibration, observations: Observations) -> list[str]:
    """Return at most ten lines of a calibration that states its accuracy."""
    accuracy = head.accuracy
    assert accuracy is not None
    word, following = verdict(accuracy, head)
    corners, notes = observations.corners, select(accuracy.findings, "note")
    lost = [each for each in notes if each.code in (NO_CORNERS, UNREADABLE_IMAGE)]
    apart = ""
    if main_pair(head) is not None and accuracy.eye_motion == "pan-tilt":
        apart = f" The eyes are {1e3 * np.linalg.norm(eye_shift(head)):.1f} mm apart."
    found = sum(int(seen_corners(c).any(axis=1).sum()) for c in corners.values())
    lines = [
        f"{word}: {counted(len(corners), 'camera')}, "
        f"{counted(len(observations.placement), 'view')}, the board found in {found} of "
        f"{counted(found + len(lost), 'image')}.{apart}"
    ]
    if accuracy.pixel_std_px is not None:
        levels = accuracy.camera_std_px.values()
        noise = f"{accuracy.pixel_std_px:.3f}"
        if levels and max(levels) > DIFFER * min(levels):
            noise = f"{min(levels):.3f} to {max(levels):.3f}"
        lines.append(f"Noise: {noise} px in corners, {_reading_noise(head)}.")
    checked = accuracy.held_out
    if checked is not None and checked.prediction_px is not None:
        read = "eye poses" if accuracy.eye_motion == "poses" else "joint readings"
        lines.append(
            f"Held-out views: the {read} predict corners to {checked.prediction_px:.2f} px "
            f"({checked.folds} folds)."
        )
    if checked is not None and checked.transfer_px is not None:
        lines.append(
            f"Held-out views: corners of one eye's image, carried to the other's, are off by "
            f"{checked.transfer_px:.2f} px ({counted(checked.transfer_views, 'view')}, "
            f"{checked.folds} folds)."
        )
    if checked is not None and checked.point_mm is not None:
        expected = checked.expected_mm
        noise = "" if expected is None else f"; noise explains {expected:.2f} mm"
        lines.append(
            f"Held-out views: points located at {checked.distance_m:.2f} m are off by "
            f"{checked.point_mm:.2f} mm{noise}."
        )
    table = point_accuracy(head)
    if table:
        parts = ", ".join(f"{mm:.2f} mm at {distance:g} m" for distance, mm, _ in table)
        shown = {distance for distance, *_ in table}
        unseen = " or ".join(f"{distance:g}" for distance in DISTANCES_M if distance not in shown)
        beyond = f"; not both eyes see a point at {unseen} m" if unseen else ""
        lines.append(f"Error of a point by the calibration alone (1 std): {parts}{beyond}.")
    serious = select(accuracy.findings, "void", "warning")
    if len(serious) > 1:
        lines.append(f"{len(serious)} warnings; the first is below, the report lists all.")
    shown = [each for each in notes if each.code != NO_CORNERS]
    lines += [f"Note: {each}" for each in shown[:MOST_NOTES]]
    lines.append(following)
    return lines


def _reading_noise(head: HeadCalibration) -> str:
    """Return the stated noise of the readings, by kind, in words."""
    accuracy = head.accuracy
    assert accuracy is not None
    degrees, last = np.degrees(accuracy.joint_std), len(accuracy.joint_std) - 1
    if accuracy.eye_motion == "poses":
        return f"{degrees[0]:.3f} degrees and {1e3 * accuracy.joint_std[1]:.3f} mm in eye poses"
    if last == 0:
        return f"{degrees[0]:.3f} degrees in all readings"
    kinds = [min(kind, last) for kind in reading_kinds(head.kinematics)]
    of_kind = [
        [name for name, kind in zip(head.kinematics.readings, kinds, strict=True) if kind == k]
        for k in range(last + 1)
    ]
    return ", ".join(
        f"{each:.3f} degrees in {listed(names)}"
        for each, names in zip(degrees, of_kind, strict=True)
    )
