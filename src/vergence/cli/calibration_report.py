"""Report of the command calibrate: accuracy, findings, lenses, parameters and worst views."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from vergence.calibration.calibrate import CalibrationResult
from vergence.calibration.lens_map import lens_maps
from vergence.calibration.summary import point_accuracy, verdict
from vergence.cli.report import Report
from vergence.data.dataset import Dataset
from vergence.files import REPORT, markdown_table, write_whole
from vergence.geometry.head import main_pair
from vergence.geometry.kinematics import EYES, pan_tilt_along
from vergence.geometry.parameters import parameter_values
from vergence.geometry.se3 import rotvec
from vergence.progress import Progress, silent
from vergence.viewer.dataset import record_dataset, rms_by_view
from vergence.viewer.plots import calibration as plots

RESULTS = (
    REPORT, "dataset.rrd", "coverage.png", "residuals.png", "lenses.png", "worst_views.png"
)  # fmt: skip
"""Files of a report. The paper's method makes only the first three."""
MARKS = {"void": "VOID: ", "warning": "Warning: ", "note": ""}
WORST_VIEWS = 6
"""Number of the worst views in report.md."""


def calibration_report(result: CalibrationResult) -> Report:
    """Report a calibration: its summary, and its accuracy as plain values."""
    accuracy = result.accuracy
    names = "distance_m", "calibration_mm", "reading_mm", "pixel_mm"
    word, following = verdict(accuracy, result.head)
    data = {
        "verdict": word,
        "next": following,
        "method": accuracy.method,
        "pixel_std_px": accuracy.pixel_std_px,
        "camera_std_px": accuracy.camera_std_px,
        "joint_std": list(accuracy.joint_std),
        "backlash_rad": accuracy.backlash_rad,
        "time_offset_ms": 1e3 * result.head.time_offset_s,
        "held_out": accuracy.held_out,
        "point_std": [dict(zip(names, row, strict=True)) for row in point_accuracy(result.head)],
        "lenses": {
            name: {
                "model": choice.model,
                "runner_up": choice.runner_up,
                "held_out_px": dict(choice.held_out_px),
            }
            for name, choice in result.lenses.items()
        },
        "std": _stds(result),
        "findings": result.findings,
    }
    return Report("Calibration", (result.summary(),), data)


def write_calibration_report(
    folder: Path,
    report: Report,
    result: CalibrationResult,
    dataset: Dataset,
    *,
    progress: Progress = silent,
) -> None:
    """Write report.md, its pictures and the recording dataset.rrd into a `results_folder`.

    VergenceError if they cannot be written, or an image cannot be read.
    """
    progress("writing the report", 0, len(dataset))
    worst = _worst_views(result)
    pictures = _save_pictures(folder, result, dataset, worst)
    rows = [(f"line {dataset.lines[row]}", name, f"{size:.3f}") for size, name, row in worst]
    findings = "\n".join(f"- {MARKS[each.severity]}{each}" for each in result.findings)
    details = [
        "## Findings",
        findings or "None.",
        "## Accuracy of points",
        *_points(result),
        "## Lenses",
        *_lenses(result),
        "## Parameters",
        *_parameters(result),
        "## Images",
        "All of them, with corners and residuals: `rerun dataset.rrd`",
        *(f"![{name}]({name}.png)" for name in pictures),
        *([markdown_table("worst views | camera | residual [px]", rows)] if rows else []),
    ]
    summary = result.summary().replace("\n", "  \n")
    text = replace(report, parts=(summary,), details=details).markdown()
    record_dataset(folder / "dataset.rrd", dataset, result, report=text, progress=progress)
    write_whole(folder / REPORT, text)


def _worst_views(result: CalibrationResult) -> list[tuple[float, str, int]]:
    """Find the views with the largest residuals (root mean square, px), with camera and row."""
    residuals = {} if result.estimate is None else result.estimate.residuals_px
    found = [
        (float(size), name, row)
        for name, errors in residuals.items()
        for row, size in enumerate(rms_by_view(errors))
        if np.isfinite(size)
    ]
    return sorted(found, reverse=True)[:WORST_VIEWS]


def _save_pictures(
    folder: Path,
    result: CalibrationResult,
    dataset: Dataset,
    worst: list[tuple[float, str, int]],
) -> list[str]:
    """Draw the pictures of a report, and return the names of those in its last section."""
    seen, head = result.observations, result.head
    looking = np.moveaxis(seen.eye_poses()[..., :3, 0], -1, 0)  # an eye's x axis is ahead
    pan, tilt = pan_tilt_along(*looking)
    angles = {eye: np.stack([pan[:, k], tilt[:, k]], axis=-1) for k, eye in enumerate(EYES)}
    eyes = {eye: angles[eye] for eye in dataset.description.eyes}
    plots.save_coverage(folder / "coverage.png", seen.corners, seen.sizes, eyes)
    if result.estimate is None:
        return ["coverage"]
    errors = result.estimate.residuals_px
    corners = {name: seen.corners[name] for name in errors}
    of_camera = {name: angles[head.cameras[name].eye] for name in errors}
    plots.save_residuals(folder / "residuals.png", corners, errors, seen.sizes, of_camera)
    plots.save_lenses(folder / "lenses.png", lens_maps(head, corners, errors), seen.sizes)
    views = {}
    for size, name, row in worst:
        image = dataset.image(name, row)
        if image is not None:
            title = f"line {dataset.lines[row]}, {name}: rms {size:.3f} px"
            views[title] = (image, corners[name][row], errors[name][row])
    plots.save_views(folder / "worst_views.png", views)
    return ["coverage", "residuals", "worst_views"]


def _points(result: CalibrationResult) -> list[str]:
    rows = [
        (f"{distance:g}", *(f"{error_mm:.2f}" for error_mm in parts))
        for distance, *parts in point_accuracy(result.head)
    ]
    if not rows:
        return [
            "Not stated: it needs bundle adjustment, joint readings, and two eyes that see points "
            "from 0.3 to 1 m."
        ]
    parts: list[str] = [
        "Standard deviation of a point ahead that the main cameras locate, averaged over "
        "directions of gaze up to 0.2 rad from straight ahead. The error by the calibration is the "
        "same in all measurements at the same readings; the noise of joints and pixels varies.",
        markdown_table(
            "distance [m] | calibration [mm] | reading [mm] | its pixels alone [mm]", rows
        ),
    ]
    checked = result.accuracy.held_out
    if checked is not None and checked.jackknife_ratio is not None:
        ratio = f"{checked.jackknife_ratio:.2f} times the stated standard deviation"
        parts.append(f"The scatter of calibrations from parts of the views is {ratio}.")
    return parts


def _lenses(result: CalibrationResult) -> list[str]:
    rows = []
    for name, choice in result.lenses.items():
        error, other = choice.held_out_px.get(choice.model), choice.runner_up
        held_out = "not compared" if error is None else f"{error:.4f}"
        runner_up = "" if other is None else f"{other}, {choice.held_out_px[other]:.4f}"
        rows.append((name, choice.model, held_out, runner_up))
    picture = [] if result.estimate is None else ["![lenses](lenses.png)"]
    return [
        "A lens model is selected by the Bayesian information criterion; a simpler model that "
        "predicts held-out views as well is preferred. Models are not compared if the paper's "
        "method was used, a model was stated, or there are fewer than ten views. Errors are rms "
        "values of one coordinate of a corner in held-out views.",
        markdown_table("camera | lens model | held out [px] | runner-up, held out [px]", rows),
        *picture,
    ]


def _parameters(result: CalibrationResult) -> list[str]:
    """Tabulate the estimated parameters and the poses."""
    head, stds = result.head, _stds(result)
    parameters = [
        (name, "" if value is None else f"{value:.6g}", f"{stds[name]:.2g}")
        for name, value in parameter_values(head).items()
        if name in stds
    ]
    T = {f"{name}.T_eye_cam": mounted.T_eye_cam for name, mounted in head.cameras.items()}
    if main_pair(head) is not None:
        T["T_rbase_lbase"] = head.T_rbase_lbase
    poses = [
        (
            name,
            " ".join(f"{x:.3f}" for x in 1e3 * pose[:3, 3]),
            " ".join(f"{x:.4f}" for x in np.degrees(rotvec(pose[:3, :3]))),
        )
        for name, pose in T.items()
    ]
    return [
        "Estimated parameters: angles in radians, lengths in metres, focal lengths and centres in "
        "pixels, time in seconds.",
        markdown_table("parameter | value | std", parameters),
        markdown_table("pose | translation x y z [mm] | rotation vector x y z [deg]", poses),
    ]


def _stds(result: CalibrationResult) -> dict[str, float]:
    accuracy = result.accuracy
    stds = np.sqrt(np.diag(accuracy.covariance)).tolist()
    return dict(zip(accuracy.parameters, stds, strict=True))
