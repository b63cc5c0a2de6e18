"""The report of a calibration: the first ten lines say whether it is good, how good, what next."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from vergence.arrays import Array
from vergence.calibration.calibrate import Solved
from vergence.calibration.checks.cross_validation import calibration_covariance
from vergence.calibration.sequential.intrinsics import seen_corners
from vergence.files import write_whole
from vergence.geometry.camera import project
from vergence.geometry.head import HeadCalibration, T_base_cam, main_pair
from vergence.geometry.kinematics import EYES
from vergence.geometry.parameters import values_of, without_offsets
from vergence.geometry.se3 import inverse, transform
from vergence.stereo.uncertainty import locate_with_covariance
from vergence.viewer import plots_calibration as plots
from vergence.viewer.dataset import record_dataset

MISFIT = 1.5
"""Held-out error, as a multiple of what the noise explains, from which something is amiss; with
the ten views or more of a usual fold set it stays below by far."""
PART = 1 / 3
"""Of the noise of a reading, which a calibration may add: it makes a twentieth of the whole."""
SMALL = 0.002
"""Error of a point, relative to its distance, that is small whatever the noise of a reading."""
FAILURES_NAMED = 20
WORST_SHOWN, WORST_LISTED = 4, 10
DISTANCES_M = (0.3, 0.6, 1.0)
_TURNS_RAD = 0.2


def verdict(solved: Solved) -> tuple[str, str]:
    """Return one word, and what to do next."""
    accuracy = solved.head.accuracy
    assert accuracy is not None
    if accuracy.warnings:
        return "DOUBTFUL", f"Next: {accuracy.warnings[0]}"
    if accuracy.method == "paper":
        return (
            "UNKNOWN",
            "Next: the paper's method states no accuracy; calibrate with --method refined.",
        )
    checked = accuracy.held_out
    assert checked is not None
    if checked.point_mm is not None and checked.expected_mm is not None:
        ratio = checked.point_mm / checked.expected_mm
        if ratio > MISFIT:
            return (
                "DOUBTFUL",
                f"Next: held-out points are {ratio:.1f} times as wrong as the noise explains; look "
                "for backlash, a board that moved or bends, and time stamps of moving eyes.",
            )
    table = distances(solved.head)
    if not table:
        return "UNKNOWN", (
            "Next: look at the standard deviations; the accuracy of a point is stated for heads of "
            "two eyes that pan and tilt."
        )
    for distance, by_calibration, by_reading in table:
        if by_calibration > max(PART * by_reading, SMALL * 1e3 * distance):
            return "FAIR", (
                f"Next: record more views, or larger eye motion; at {distance:g} m the calibration "
                f"adds {by_calibration:.1f} mm to the {by_reading:.1f} mm of a reading's noise."
            )
    return "GOOD", "Next: nothing; more views would not make points much better."


@lru_cache(maxsize=4)
def distances(head: HeadCalibration) -> list[tuple[float, float, float]]:
    """Return at some distances what the calibration and what a reading adds to a point [mm].

    Root mean square over a motion: both eyes fixate a point while the gaze goes round. Empty
    where the head states no covariance, has one eye, or eyes that do not pan and tilt.
    """
    accuracy, pair = head.accuracy, main_pair(head)
    if accuracy is None or not accuracy.parameters or pair is None:
        return []
    if accuracy.eye_motion == "poses":
        return []
    rows = []
    for distance in DISTANCES_M:
        pixels_l, pixels_r, angles = motion(head, distance, pair)
        of_head = calibration_covariance(head, pixels_l, pixels_r, angles, cameras=pair)
        _, of_reading = locate_with_covariance(
            head,
            pixels_l,
            pixels_r,
            angles,
            pixel_std_px=accuracy.pixel_std_px or 0.0,
            joint_std_rad=np.tile(accuracy.joint_std, 4)[:4],
            cameras=pair,
        )
        both = (
            1e3 * float(np.sqrt(np.trace(each, axis1=1, axis2=2).mean()))
            for each in (of_head, of_reading)
        )
        rows.append((distance, *both))
    return rows


def motion(
    head: HeadCalibration, distance_m: float, pair: tuple[str, str]
) -> tuple[Array, Array, Array]:
    """Return pixels and readings (8, 2), (8, 2), (8, 4) of a point ahead while the gaze circles.

    Both eyes turn by 0.2 rad, in the same sense; the point stays in the middle of the head.
    """
    plain = without_offsets(head)
    phase = np.arange(8) * np.pi / 4
    angles = _TURNS_RAD * np.stack([np.cos(phase), np.sin(phase)] * 2, axis=1)
    T_lbase_rbase = inverse(plain.T_rbase_lbase)
    point = np.array([distance_m, 0.0, 0.0]) + T_lbase_rbase[:3, 3] / 2
    pixels = []
    for k, eye in enumerate(EYES):
        in_base = point if eye == "left" else transform(plain.T_rbase_lbase, point)
        T = T_base_cam(plain, pair[k], angles[:, 2 * k : 2 * k + 2])
        camera = plain.cameras[pair[k]].intrinsics
        pixels.append(project(camera, transform(inverse(T), in_base[None])))
    return pixels[0], pixels[1], angles


def summary(solved: Solved) -> list[str]:
    """Return at most ten lines: good or not, how good, what to do next."""
    accuracy = solved.head.accuracy
    assert accuracy is not None
    word, following = verdict(solved)
    lines = [f"{word}: {_seen(solved)}."]
    if accuracy.pixel_std_px is not None:
        levels = " and ".join(f"{np.degrees(s):.3f}" for s in accuracy.joint_std)
        of_eyes = f"{levels} degrees in readings"
        if accuracy.eye_motion == "poses":
            turn, shift = accuracy.joint_std
            of_eyes = f"{np.degrees(turn):.3f} degrees and {1e3 * shift:.3f} mm in eye poses"
        lines.append(f"Noise: {accuracy.pixel_std_px:.3f} px in corners, {of_eyes}.")
    checked = accuracy.held_out
    if checked is not None and checked.transfer_px is not None:
        lines.append(
            f"Held out: a corner carried from eye to eye is off by {checked.transfer_px:.2f} px "
            f"({checked.transfer_views} views, {checked.folds} folds)."
        )
    if checked is not None and checked.point_mm is not None:
        expected = checked.expected_mm
        noise = "" if expected is None else f"; the noise explains {expected:.2f} mm"
        lines.append(
            f"Held out: a point at {checked.distance_m:.2f} m is off by {checked.point_mm:.2f} mm"
            f"{noise}."
        )
    table = distances(solved.head)
    if table:
        parts = ", ".join(f"{mm:.2f} mm at {distance:g} m" for distance, mm, _ in table)
        lines.append(f"Of this the calibration itself adds (1 std): {parts}.")
    if len(accuracy.warnings) > 1:
        lines.append(f"{len(accuracy.warnings)} warnings, listed in the report.")
    lines.append(following)
    return lines


def _seen(solved: Solved) -> str:
    views = solved.detections.views
    found = sum(int(seen_corners(c).any(axis=1).sum()) for c in views.corners.values())
    failed = len(solved.detections.failures)
    images = f"the board found in {found} of {found + failed} images"
    return f"{len(views.corners)} cameras, {len(views.placement)} views, {images}"


def figures(solved: Solved) -> dict[str, Any]:
    """Return the accuracy in figures, for programs."""
    accuracy = solved.head.accuracy
    assert accuracy is not None
    word, following = verdict(solved)
    checked = accuracy.held_out
    return {
        "verdict": word,
        "next": following,
        "method": accuracy.method,
        "pixel_std_px": accuracy.pixel_std_px,
        "joint_std": list(accuracy.joint_std),
        "time_offset_ms": 1e3 * solved.head.time_offset_s,
        "held_out": None if checked is None else vars(checked),
        "point_std": [
            {"distance_m": d, "calibration_mm": a, "reading_mm": b}
            for d, a, b in distances(solved.head)
        ],
        "std": dict(
            zip(accuracy.parameters, np.sqrt(np.diag(accuracy.covariance)).tolist(), strict=True)
        ),
        "warnings": list(accuracy.warnings),
        "remarks": list(solved.detections.remarks),
        "failures": [str(failure) for failure in solved.detections.failures],
    }


def write_json(solved: Solved, path: Path) -> None:
    """Write the accuracy in figures."""
    write_whole(path, json.dumps(figures(solved), indent=1, allow_nan=False) + "\n")


def write_report(solved: Solved, folder: Path, *, done: Callable[[], None] = lambda: None) -> None:
    """Write report.md, its pictures and the recording dataset.rrd into a folder.

    Args:
        solved: the calibration.
        folder: made if it is not there.
        done: called after each recorded row.
    """
    views, eyes = solved.detections.views, solved.dataset.description.eyes
    angles = {eye: views.eye_angles[:, 2 * k : 2 * k + 2] for k, eye in enumerate(EYES)}
    plots.coverage(
        folder / "coverage.png", views.corners, views.sizes, {eye: angles[eye] for eye in eyes}
    )
    if solved.refined is not None:
        errors = solved.refined.residuals_px
        corners = {name: views.corners[name] for name in errors}
        of_camera = {name: angles[solved.head.cameras[name].eye] for name in errors}
        plots.residuals(folder / "residuals.png", corners, errors, views.sizes, of_camera)
        shown = {}
        for size, name, row in worst(solved)[:WORST_SHOWN]:
            image = solved.dataset.image(name, row)
            if image is not None:
                title = f"line {solved.dataset.lines[row]}, {name}: rms {size:.3f} px"
                shown[title] = (image, views.corners[name][row], errors[name][row])
        plots.views(folder / "worst_views.png", shown)
    text = as_markdown(solved)
    record_dataset(
        folder / "dataset.rrd",
        solved.dataset,
        solved.detections,
        solved.head,
        solved.refined,
        report=text,
        done=done,
    )
    write_whole(folder / "report.md", text)


def worst(solved: Solved) -> list[tuple[float, str, int]]:
    """Return residual (root mean square, px), camera and row of all views, the worst first."""
    if solved.refined is None:
        return []
    found = []
    for name, errors in solved.refined.residuals_px.items():
        squares = (errors**2).sum(axis=2)
        for row in np.flatnonzero(np.asarray(np.isfinite(squares).any(axis=1))):
            found.append((float(np.sqrt(np.nanmean(squares[row]))), name, int(row)))
    return sorted(found, reverse=True)


def as_markdown(solved: Solved) -> str:
    """Return the report."""
    accuracy = solved.head.accuracy
    assert accuracy is not None
    lines = ["# Calibration", "", *(f"{line}  " for line in summary(solved)), ""]
    said = (*accuracy.warnings, *solved.detections.remarks)
    lines += ["## Warnings", "", *([f"- {line}" for line in said] or ["None."]), ""]
    lines += ["## Accuracy of points", "", *_points(solved), ""]
    lines += ["## Parameters", "", *_parameters(solved.head), ""]
    lines += [
        "## Images",
        "",
        "All of them, with corners and residuals, are in the recording dataset.rrd.",
        "",
    ]
    lines += ["![coverage](coverage.png)", ""]
    if solved.refined is not None:
        lines += ["![residuals](residuals.png)", "", "![worst views](worst_views.png)", ""]
        lines += ["| worst views | camera | residual [px] |", "|---|---|---|"]
        lines += [
            f"| line {solved.dataset.lines[row]} | {name} | {size:.3f} |"
            for size, name, row in worst(solved)[:WORST_LISTED]
        ]
        lines.append("")
    failures = solved.detections.failures
    if failures:
        lines += [f"{len(failures)} images gave no corners:", ""]
        lines += [f"- {failure}" for failure in failures[:FAILURES_NAMED]]
        if len(failures) > FAILURES_NAMED:
            lines.append(f"- and {len(failures) - FAILURES_NAMED} more, all in the JSON file")
    return "\n".join(lines).rstrip() + "\n"


def _points(solved: Solved) -> list[str]:
    table = distances(solved.head)
    if not table:
        return ["Not stated: see `vergence calibrate --method refined`."]
    lines = [
        "Standard deviation of a point ahead, located with the wide cameras, while the gaze goes",
        "round by 0.2 rad: what the calibration adds, the same for every reading at these angles,",
        "and what the noise of one reading and its pixels adds.",
        "",
        "| distance [m] | calibration [mm] | reading [mm] |",
        "|---|---|---|",
    ]
    lines += [f"| {d:g} | {a:.2f} | {b:.2f} |" for d, a, b in table]
    checked = solved.head.accuracy.held_out if solved.head.accuracy else None
    if checked is not None and checked.scatter is not None:
        lines += ["", f"Folds scatter {checked.scatter:.2f} times as much as stated."]
    return lines


def _parameters(head: HeadCalibration) -> list[str]:
    accuracy = head.accuracy
    assert accuracy is not None
    values = values_of(head)
    stds = dict(
        zip(accuracy.parameters, np.sqrt(np.diag(accuracy.covariance)).tolist(), strict=True)
    )
    lines = [
        "Poses are given by their standard deviations alone; see the calibration file. Angles in",
        "radians, lengths in metres, focal lengths and centres in pixels, time in seconds.",
        "",
        "| parameter | value | std |",
        "|---|---|---|",
    ]
    for name, value in values.items():
        std = f"{stds[name]:.2g}" if name in stds else "held"
        lines.append(f"| {name} | {'' if value is None else f'{value:.6g}'} | {std} |")
    return lines
