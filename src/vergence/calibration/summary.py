"""How good a calibration is, in ten lines: good or not, how good, what to do next."""

from __future__ import annotations

import numpy as np

from vergence.calibration.observations import NO_CORNERS, UNREADABLE_IMAGE, Observations
from vergence.calibration.plausibility import eye_shift
from vergence.errors import counted, listed
from vergence.findings import Finding, select, warning
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

LARGEST_EXPECTED = 0.1
"""Error that noise explains, relative to the distance, from which held-out points check nothing."""
INACCURATE = 0.01
"""Error of a point by the calibration, relative to its distance, that is reported where that by a
reading is smaller: a finger's width at arm's length."""
BUDGET_M = 0.6
"""Distance of the error budget in the last line, the middle one of DISTANCES_M."""
MOST_NOTES = 2
"""Number of notes that a summary repeats; the report has all."""
DISTANCES_M = (0.3, 0.6, 1.0)
"""Distances of the points whose accuracy is stated: the range of a hand, and beyond."""
DIFFER = 1.5
"""Ratio of the noise of cameras from which it is stated from least to most."""
AROUND_RAD = 0.2
"""Angle from straight ahead of the gaze directions over which that accuracy is stated."""


def verdict(accuracy: Accuracy, head: HeadCalibration) -> tuple[str, str]:
    """Judge a calibration by its findings in one word, and say what to do next.

    GOOD: the stated accuracy can be believed. DOUBTFUL: something is amiss, unknown, or inaccurate.
    VOID: the calibration must not be used.
    """
    if accuracy.void:
        return "VOID", accuracy.void[0].sentence
    if warnings := select(accuracy.findings, "warning"):
        return "DOUBTFUL", f"Next: {warnings[0]}"
    return "GOOD", f"Next: {_largest_part(head)}"


def inaccurate(head: HeadCalibration) -> list[Finding]:
    """Find out whether the accuracy of points is stated, was checked, and is good."""
    accuracy = head.accuracy
    assert accuracy is not None
    if accuracy.method == "paper":
        sentence = "the paper's method states no accuracy; calibrate with --method bundle."
        return [warning("no-accuracy", sentence)]
    findings, checked = [], accuracy.held_out
    still = accuracy.eye_motion == "fixed"
    which = "near, far and slanted" if still else "`vergence plan` says which"
    more = f"record more views in which both eyes see the board ({which})"
    move = "" if still else ", or let the eyes move farther"
    if checked is not None and checked.expected_mm is not None and checked.distance_m is not None:
        expected_mm, distance = checked.expected_mm, checked.distance_m
        if expected_mm > LARGEST_EXPECTED * 1e3 * distance:
            sentence = (
                f"{more}; held-out points check nothing, since noise explains errors of "
                f"{expected_mm:.0f} mm at {distance:.2f} m."
            )
            findings.append(warning("nothing-checked", sentence))
    for distance, by_calibration, by_reading, _ in point_accuracy(head):
        if by_calibration > max(by_reading, INACCURATE * 1e3 * distance):
            sentence = (
                f"{more}{move}; at {distance:g} m a point is wrong by "
                f"{by_calibration:.1f} mm by the calibration alone."
            )
            findings.append(warning("inaccurate", sentence))
            break
    return findings


def _largest_part(head: HeadCalibration) -> str:
    """Say which part of a point's error is the largest, and what makes it smaller."""
    budget = {distance: parts for distance, *parts in point_accuracy(head)}
    if not budget:
        return "nothing is amiss; the report states the deviation of each parameter."
    distance = min(budget, key=lambda each: abs(each - BUDGET_M))
    by_calibration, by_reading, by_pixels = budget[distance]
    by_joints = float(np.sqrt(max(by_reading**2 - by_pixels**2, 0.0)))
    moved = ", or let the eyes move farther (`vergence plan`)" if head.kinematics.readings else ""
    advice = {
        by_calibration: f"record more views{moved}",
        by_joints: "let images correct the readings (`SelfCalibrator`), or use better encoders; "
        "more views do not help",
        by_pixels: "nothing; a smaller error takes more pixels, or eyes farther apart",
    }
    return (
        f"{advice[max(advice)]}. At {distance:g} m the joint readings add {by_joints:.1f} mm to "
        f"the error of a point, its pixels {by_pixels:.1f} mm, the calibration "
        f"{by_calibration:.1f} mm."
    )


def point_accuracy(head: HeadCalibration) -> list[tuple[float, float, float, float]]:
    """Compute at some distances [m] the errors of a point [mm], and their parts.

    By the calibration, by the noise of one reading and its pixels, and by that of the pixels alone.
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
        found, seen = (
            locate(head, left=left, right=right, joints=joints, reading_std=std)
            for std in (None, 0.0)
        )
        of_head = found.calibration_covariance
        parts = of_head, found.covariance - of_head, seen.covariance - seen.calibration_covariance
        by_head, by_reading, by_pixels = (
            1e3 * float(np.sqrt(np.trace(each, axis1=1, axis2=2).mean())) for each in parts
        )
        if np.isfinite([by_head, by_reading]).all():
            rows.append((distance, by_head, by_reading, by_pixels))
    return rows


def summary_lines(head: HeadCalibration, observations: Observations) -> list[str]:
    """Return at most ten lines of a calibration that states its accuracy."""
    accuracy = head.accuracy
    assert accuracy is not None
    word, following = verdict(accuracy, head)
    corners, notes = observations.corners, select(accuracy.findings, "note")
    lost = [each for each in notes if each.code in (NO_CORNERS, UNREADABLE_IMAGE)]
    apart = ""
    if main_pair(head) is not None and accuracy.eye_motion != "poses":
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
        readings = f", {_reading_noise(head)}" if accuracy.joint_std else ""
        lines.append(f"Noise: {noise} px in corners{readings}.")
    checked = accuracy.held_out
    if checked is not None and checked.prediction_px is not None:
        by = {"poses": "eye poses", "fixed": "lenses and camera poses"}
        read = by.get(accuracy.eye_motion, "joint readings")
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
        parts = ", ".join(f"{mm:.2f} mm at {distance:g} m" for distance, mm, *_ in table)
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
        return f"{degrees[0]:.2g} degrees and {1e3 * accuracy.joint_std[1]:.2g} mm in eye poses"
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
