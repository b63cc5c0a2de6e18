"""The report of a calibration: its summary, warnings, accuracy, parameters and worst views."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from vergence.accuracy.plan import plan
from vergence.arrays import Array
from vergence.calibration.calibrate import CalibrationResult
from vergence.calibration.checks.lens_map import lens_maps
from vergence.calibration.observations import NO_CORNERS
from vergence.calibration.summary import point_accuracy, verdict
from vergence.commands.plan import as_text
from vergence.data.dataset import Dataset
from vergence.errors import VergenceError, counted
from vergence.findings import select
from vergence.geometry.head import main_pair
from vergence.geometry.kinematics import EYES, pan_tilt_along
from vergence.geometry.parameters import parameter_values
from vergence.geometry.se3 import rotvec
from vergence.progress import Progress, silent
from vergence.viewer.dataset import record_dataset, rms_by_view
from vergence.viewer.plots import calibration as plots
from vergence.writable import REPORT
from vergence.writing import markdown_table, write_whole

TITLE = "# Calibration"
RESULTS = (REPORT, "dataset.rrd", "coverage.png", "residuals.png", "worst_views.png")
"""Files of a report, some of which the paper's method does not make."""
FAILURES_NAMED = 20
SYSTEMATIC = 4.0
"""Standard errors of a mean residual from which it is marked; of a hundred cells one is beyond
three by chance."""
WORST_SHOWN, WORST_LISTED = 4, 10
_MARKS = {"void": "VOID: ", "warning": "Warning: ", "note": ""}
NEXT_VIEWS, NEXT_CANDIDATES = 4, (12, 6)
"""Planned in a report: few, from few candidates, since the report should not take long."""
LEAST_LIMIT_RAD = 0.17
"""To which eyes may turn in a plan, though they have not in the recording."""


def as_plain(result: CalibrationResult) -> dict[str, Any]:
    """Return the accuracy as plain values, for JSON."""
    accuracy = result.accuracy
    word, following = verdict(accuracy, result.head)
    checked = accuracy.held_out
    return {
        "verdict": word,
        "next": following,
        "method": accuracy.method,
        "pixel_std_px": accuracy.pixel_std_px,
        "camera_std_px": accuracy.camera_std_px,
        "joint_std": list(accuracy.joint_std),
        "time_offset_ms": 1e3 * result.head.time_offset_s,
        "held_out": None if checked is None else vars(checked),
        "point_std": [
            {"distance_m": d, "calibration_mm": a, "reading_mm": b}
            for d, a, b in point_accuracy(result.head)
        ],
        "lenses": {
            name: {
                "model": choice.model,
                "runner_up": choice.runner_up,
                "held_out_px": dict(choice.held_out_px),
            }
            for name, choice in result.lenses.items()
        },
        "std": _stds(result),
        "findings": [vars(each) for each in result.findings],
    }


def _stds(result: CalibrationResult) -> dict[str, float]:
    accuracy = result.accuracy
    stds = np.sqrt(np.diag(accuracy.covariance)).tolist()
    return dict(zip(accuracy.parameters, stds, strict=True))


def write_report(
    result: CalibrationResult, dataset: Dataset, folder: Path, *, progress: Progress = silent
) -> None:
    """Write report.md, its pictures and the recording dataset.rrd into a `results_folder`.

    VergenceError if they cannot be written, or an image cannot be read.
    """
    progress("writing the report", 0, len(dataset))
    seen = result.observations
    looking = np.moveaxis(seen.eye_poses()[..., :3, 0], -1, 0)  # the eyes' own x is ahead
    pan_tilt = np.stack(pan_tilt_along(*looking), axis=-1)
    angles = dict(zip(EYES, np.moveaxis(pan_tilt, 1, 0), strict=True))
    eyes = {eye: angles[eye] for eye in dataset.description.eyes}
    plots.save_coverage(folder / "coverage.png", seen.corners, seen.sizes, eyes)
    if result.estimate is not None:
        errors = result.estimate.residuals_px
        corners = {name: seen.corners[name] for name in errors}
        of_camera = {name: angles[result.head.cameras[name].eye] for name in errors}
        plots.save_residuals(folder / "residuals.png", corners, errors, seen.sizes, of_camera)
        shown = {}
        for size, name, row in worst(result)[:WORST_SHOWN]:
            image = dataset.image(name, row)
            if image is not None:
                title = f"line {dataset.lines[row]}, {name}: rms {size:.3f} px"
                shown[title] = (image, seen.corners[name][row], errors[name][row])
        plots.save_views(folder / "worst_views.png", shown)
    text = as_markdown(result, dataset)
    record_dataset(folder / "dataset.rrd", dataset, result, report=text, progress=progress)
    write_whole(folder / REPORT, text)


def worst(result: CalibrationResult) -> list[tuple[float, str, int]]:
    """Return residual (root mean square, px), camera and row of all views, the worst first."""
    if result.estimate is None:
        return []
    found = [
        (float(size), name, row)
        for name, errors in result.estimate.residuals_px.items()
        for row, size in enumerate(rms_by_view(errors))
        if np.isfinite(size)
    ]
    return sorted(found, reverse=True)


def as_markdown(result: CalibrationResult, dataset: Dataset) -> str:
    """Return the report."""
    failures = select(result.findings, "note", code=NO_CORNERS)
    said = [each for each in result.findings if each not in failures]
    images = ["All of them, with corners and residuals: `rerun dataset.rrd`", ""]
    images += ["![coverage](coverage.png)", ""]
    if result.estimate is not None:
        images += ["![residuals](residuals.png)", "", "![worst views](worst_views.png)", ""]
        rows = [
            (f"line {dataset.lines[row]}", name, f"{size:.3f}")
            for size, name, row in worst(result)[:WORST_LISTED]
        ]
        images += [markdown_table("worst views | camera | residual [px]", rows), ""]
    if failures:
        images += [f"{counted(len(failures), 'image')} gave no corners:", ""]
        images += [f"- {failure}" for failure in failures[:FAILURES_NAMED]]
        if len(failures) > FAILURES_NAMED:
            images.append(f"- and {len(failures) - FAILURES_NAMED} more, all in the JSON file")
    lines = [TITLE, "", *(f"{line}  " for line in result.summary().splitlines())]
    for heading, section in (
        ("Findings", [f"- {_MARKS[each.severity]}{each}" for each in said] or ["None."]),
        ("Accuracy of points", _points(result)),
        ("Views to record next", _next_views(result)),
        ("Lenses", _lenses(result)),
        ("Parameters", _parameters(result)),
        ("Images", images),
    ):
        lines += ["", f"## {heading}", "", *section]
    return "\n".join(lines).rstrip() + "\n"


def _points(result: CalibrationResult) -> list[str]:
    rows = [(f"{d:g}", f"{a:.2f}", f"{b:.2f}") for d, a, b in point_accuracy(result.head)]
    if not rows and result.accuracy.method == "paper":
        return ["Not stated: see `vergence calibrate --method bundle`."]
    if not rows:
        return [
            "Not stated: it is for points that both eyes see from 0.3 to 1 m, of heads of two eyes "
            "with joint readings."
        ]
    lines = [
        "Standard deviation of a point ahead, located with the main cameras, while the gaze goes",
        "round by 0.2 rad: what the calibration adds, the same for every reading at these angles,",
        "and what the noise of one reading and its pixels adds.",
        "",
        markdown_table("distance [m] | calibration [mm] | reading [mm]", rows),
    ]
    checked = result.accuracy.held_out
    if checked is not None and checked.jackknife_ratio is not None:
        ratio = f"{checked.jackknife_ratio:.2f}"
        stated = f"Calibrations from parts of the views differ {ratio} times as much as stated."
        lines += ["", stated]
    return lines


def _next_views(result: CalibrationResult) -> list[str]:
    """Return a short plan, for eyes that move as far as in this recording, or LEAST_LIMIT_RAD."""
    reached = np.nan_to_num(np.abs(result.observations.eye_angles)).max(axis=0)
    least = LEAST_LIMIT_RAD / result.head.kinematics.factors
    try:
        found = plan(
            result.head,
            result.observations.board,
            views=NEXT_VIEWS,
            limits_rad=np.maximum(reached, least),
            candidates=NEXT_CANDIDATES,
        )
    except VergenceError as error:
        return [f"No plan: {error}"]
    return [as_text(found), "", "`vergence plan` plans more views, for other distances or limits."]


def _lenses(result: CalibrationResult) -> list[str]:
    rows = []
    for name, choice in result.lenses.items():
        own, other = choice.held_out_px.get(choice.model), choice.runner_up
        rows.append(
            (
                name,
                choice.model,
                "not compared" if own is None else f"{own:.4f}",
                "" if other is None else f"{other}, {choice.held_out_px[other]:.4f}",
            )
        )
    lines = [
        "Models are selected by the Bayesian information criterion, in favour of simpler ones that",
        "predict held-out views as well; not with the paper's method, where a model was stated, or",
        "where fewer than ten views show the board. Errors are of one coordinate of a corner in",
        "held-out views, root mean square.",
        "",
        markdown_table("camera | lens model | held out [px] | runner-up, held out [px]", rows),
    ]
    if result.estimate is None:
        return lines
    maps = lens_maps(result.head, result.observations.corners, result.estimate.residuals_px)
    lines += [
        "",
        "Part by part of each image: the standard deviation of a direction's pixel by the lens, in",
        "brackets where no corner was ever seen; and the mean of the residuals of corners there,",
        f"with * beyond {SYSTEMATIC:g} standard errors. Both in px.",
    ]
    for name, own in maps.items():
        off = np.linalg.norm(own.residual_px, axis=-1)
        beyond = off > SYSTEMATIC * np.sqrt(2) * own.residual_std_px
        std = _grid(own.std_px, np.where(own.corners > 0, " %s ", "(%s)"))
        mean = _grid(off, np.where(beyond, " %s*", " %s "))
        covered = f"{100 * own.covered:.0f} % of the image covered"
        lines += ["", f"{name}, {covered}; standard deviation:", "", *std]
        lines += ["", f"{name}, mean residual:", "", *mean]
    return lines


def _grid(values: Array, form: np.ndarray) -> list[str]:
    """Return a block of numbers (R, C), each in its form; those that are not known are left out."""
    return [
        "    "
        + " ".join(
            (each % (f"{value:.3g}" if np.isfinite(value) else "-")).rjust(8)
            for value, each in zip(row, forms, strict=True)
        )
        for row, forms in zip(values, form, strict=True)
    ]


def _parameters(result: CalibrationResult) -> list[str]:
    stds = _stds(result)
    rows = [
        (
            name,
            "" if value is None else f"{value:.6g}",
            f"{stds[name]:.2g}" if name in stds else "fixed",
        )
        for name, value in parameter_values(result.head).items()
    ]
    return [
        "Angles in radians, lengths in metres, focal lengths and centres in pixels, time in",
        "seconds.",
        "",
        markdown_table("parameter | value | std", rows),
        "",
        *_poses(result),
    ]


def _poses(result: CalibrationResult) -> list[str]:
    """Return the poses of the cameras in their eyes, and of the eyes to each other."""
    head = result.head
    poses = {f"{name}.T_eye_cam": mounted.T_eye_cam for name, mounted in head.cameras.items()}
    lines = []
    if main_pair(head) is not None:
        poses["T_rbase_lbase"] = head.T_rbase_lbase
        baseline_mm = 1e3 * np.linalg.norm(head.T_rbase_lbase[:3, 3])
        lines = ["", f"The eyes' rotation centres stand {baseline_mm:.3f} mm apart."]
    rows = [
        (
            name,
            " ".join(f"{x:.3f}" for x in 1e3 * T[:3, 3]),
            " ".join(f"{x:.4f}" for x in np.degrees(rotvec(T[:3, :3]))),
        )
        for name, T in poses.items()
    ]
    table = markdown_table("pose | translation x y z [mm] | rotation vector x y z [deg]", rows)
    return [table, *lines]
