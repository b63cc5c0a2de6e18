"""Report of the command calibrate: accuracy, findings, lenses, parameters and worst views."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from vergence.calibration.calibrate import CalibrationResult
from vergence.calibration.lens_map import lens_maps
from vergence.calibration.observations import NO_CORNERS
from vergence.calibration.summary import point_accuracy, verdict
from vergence.cli.report import Part, Report, Table
from vergence.data.dataset import Dataset
from vergence.errors import counted
from vergence.files import REPORT, write_whole
from vergence.findings import select
from vergence.geometry.head import main_pair
from vergence.geometry.kinematics import EYES, pan_tilt_along
from vergence.geometry.parameters import parameter_values
from vergence.geometry.se3 import rotvec
from vergence.progress import Progress, silent
from vergence.viewer.dataset import record_dataset, rms_by_view
from vergence.viewer.plots import calibration as plots

TITLE = "Calibration"
RESULTS = (
    REPORT, "dataset.rrd", "coverage.png", "residuals.png", "lenses.png", "worst_views.png"
)  # fmt: skip
"""Files of a report. The paper's method makes only the first three."""
FAILURES_NAMED = 20
MARKS = {"void": "VOID: ", "warning": "Warning: ", "note": ""}
WORST_SHOWN, WORST_LISTED = 4, 10


def calibration_report(result: CalibrationResult) -> Report:
    """Report a calibration: its summary, and its accuracy as plain values."""
    accuracy = result.accuracy
    word, following = verdict(accuracy, result.head)
    data = {
        "verdict": word,
        "next": following,
        "method": accuracy.method,
        "pixel_std_px": accuracy.pixel_std_px,
        "camera_std_px": accuracy.camera_std_px,
        "joint_std": list(accuracy.joint_std),
        "time_offset_ms": 1e3 * result.head.time_offset_s,
        "held_out": accuracy.held_out,
        "point_std": [
            dict(zip(("distance_m", "calibration_mm", "reading_mm"), row, strict=True))
            for row in point_accuracy(result.head)
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
        "findings": result.findings,
    }
    return Report(TITLE, (result.summary(),), data)


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
    pictures = _save_pictures(folder, result, dataset)
    lines = (f"{line}  " for part in report.parts for line in str(part).splitlines())
    details = _details(result, dataset, pictures)
    text = replace(report, parts=("\n".join(lines),), details=details).markdown()
    record_dataset(folder / "dataset.rrd", dataset, result, report=text, progress=progress)
    write_whole(folder / REPORT, text)


def _save_pictures(folder: Path, result: CalibrationResult, dataset: Dataset) -> list[str]:
    """Draw the pictures of a report, and return the lines of markdown that show them."""
    seen, head = result.observations, result.head
    looking = np.moveaxis(seen.eye_poses()[..., :3, 0], -1, 0)  # an eye's x axis is ahead
    pan_tilt = np.stack(pan_tilt_along(*looking), axis=-1)
    angles = dict(zip(EYES, np.moveaxis(pan_tilt, 1, 0), strict=True))
    eyes = {eye: angles[eye] for eye in dataset.description.eyes}
    plots.save_coverage(folder / "coverage.png", seen.corners, seen.sizes, eyes)
    shown = ["![coverage](coverage.png)"]
    if result.estimate is None:
        return shown
    errors = result.estimate.residuals_px
    corners = {name: seen.corners[name] for name in errors}
    of_camera = {name: angles[head.cameras[name].eye] for name in errors}
    plots.save_residuals(folder / "residuals.png", corners, errors, seen.sizes, of_camera)
    plots.save_lenses(folder / "lenses.png", lens_maps(head, corners, errors), seen.sizes)
    views = {}
    for size, name, row in _worst_views(result)[:WORST_SHOWN]:
        image = dataset.image(name, row)
        if image is not None:
            title = f"line {dataset.lines[row]}, {name}: rms {size:.3f} px"
            views[title] = (image, corners[name][row], errors[name][row])
    plots.save_views(folder / "worst_views.png", views)
    return [*shown, "![residuals](residuals.png)", "![worst views](worst_views.png)"]


def _worst_views(result: CalibrationResult) -> list[tuple[float, str, int]]:
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


def _details(result: CalibrationResult, dataset: Dataset, pictures: list[str]) -> list[Part]:
    """Return the sections of report.md after the summary."""
    failures = select(result.findings, "note", code=NO_CORNERS)
    findings = [each for each in result.findings if each not in failures]
    images: list[Part] = ["All of them, with corners and residuals: `rerun dataset.rrd`", *pictures]
    rows = [
        (f"line {dataset.lines[row]}", name, f"{size:.3f}")
        for size, name, row in _worst_views(result)[:WORST_LISTED]
    ]
    if rows:
        images.append(Table(("worst views", "camera", "residual [px]"), rows))
    if failures:
        listed = [f"- {failure}" for failure in failures[:FAILURES_NAMED]]
        if len(failures) > FAILURES_NAMED:
            listed.append(f"- and {len(failures) - FAILURES_NAMED} more, all in the JSON file")
        images += [f"{counted(len(failures), 'image')} gave no corners:", "\n".join(listed)]
    return [
        "## Findings",
        "\n".join(f"- {MARKS[each.severity]}{each}" for each in findings) or "None.",
        "## Accuracy of points",
        *_points(result),
        "## Lenses",
        *_lenses(result),
        "## Parameters",
        *_parameters(result),
        "## Images",
        *images,
    ]


def _points(result: CalibrationResult) -> list[Part]:
    rows = [(f"{d:g}", f"{a:.2f}", f"{b:.2f}") for d, a, b in point_accuracy(result.head)]
    if not rows and result.accuracy.method == "paper":
        return ["Not stated: see `vergence calibrate --method bundle`."]
    if not rows:
        return [
            "Not stated: it is for points that both eyes see from 0.3 to 1 m, of heads of two eyes "
            "with joint readings."
        ]
    parts: list[Part] = [
        "Standard deviation of a point ahead that the main cameras locate, averaged over "
        "directions of gaze up to 0.2 rad aside. The calibration adds the same error to every "
        "reading at these angles; the noise of joints and pixels differs from reading to reading.",
        Table(("distance [m]", "calibration [mm]", "reading [mm]"), rows),
    ]
    checked = result.accuracy.held_out
    if checked is not None and checked.jackknife_ratio is not None:
        ratio = f"{checked.jackknife_ratio:.2f} times as much as stated"
        parts.append(f"Calibrations from parts of the views differ {ratio}.")
    return parts


def _lenses(result: CalibrationResult) -> list[Part]:
    rows = []
    for name, choice in result.lenses.items():
        error, other = choice.held_out_px.get(choice.model), choice.runner_up
        held_out = "not compared" if error is None else f"{error:.4f}"
        runner_up = "" if other is None else f"{other}, {choice.held_out_px[other]:.4f}"
        rows.append((name, choice.model, held_out, runner_up))
    parts: list[Part] = [
        "A lens model is selected by the Bayesian information criterion; a simpler model that "
        "predicts held-out views as well is preferred. Models are not compared with the paper's "
        "method, where a model was stated, or below ten views of the board. Errors are rms values "
        "of one coordinate of a corner in held-out views.",
        Table(("camera", "lens model", "held out [px]", "runner-up, held out [px]"), rows),
    ]
    if result.estimate is not None:
        parts.append("![lenses](lenses.png)")
    return parts


def _parameters(result: CalibrationResult) -> list[Part]:
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
        "Angles in radians, lengths in metres, focal lengths and centres in pixels, time in "
        "seconds.",
        Table(("parameter", "value", "std"), rows),
        *_poses(result),
    ]


def _poses(result: CalibrationResult) -> list[Part]:
    """Return the poses of the cameras in their eyes, and of the eyes relative to each other."""
    head = result.head
    poses = {f"{name}.T_eye_cam": mounted.T_eye_cam for name, mounted in head.cameras.items()}
    distance = []
    if main_pair(head) is not None:
        poses["T_rbase_lbase"] = head.T_rbase_lbase
        baseline_mm = 1e3 * np.linalg.norm(head.T_rbase_lbase[:3, 3])
        distance = [f"The eyes' rotation centres stand {baseline_mm:.3f} mm apart."]
    rows = [
        (
            name,
            " ".join(f"{x:.3f}" for x in 1e3 * T[:3, 3]),
            " ".join(f"{x:.4f}" for x in np.degrees(rotvec(T[:3, :3]))),
        )
        for name, T in poses.items()
    ]
    heading = ("pose", "translation x y z [mm]", "rotation vector x y z [deg]")
    return [Table(heading, rows), *distance]


def _stds(result: CalibrationResult) -> dict[str, float]:
    accuracy = result.accuracy
    stds = np.sqrt(np.diag(accuracy.covariance)).tolist()
    return dict(zip(accuracy.parameters, stds, strict=True))
