"""Commands that calibrate, and that read and write calibrations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import vergence as vg
from vergence.cli.options import Optional, Positional, check_outputs
from vergence.cli.recordings import dataset_of
from vergence.cli.report import Report
from vergence.cli.terminal import invocation, progress_bars
from vergence.errors import VergenceError, listed
from vergence.files import results_folder

if TYPE_CHECKING:
    from vergence.calibration.calibrate import CalibrationResult

Lens = Literal[
    "auto", "none", "k1", "k1k2", "radial-tangential", "radial-tangential-k3", "rational", "fisheye"
]
"""A lens model, as `calibration.calibrate` names them."""


def calibrate(
    dataset: Positional[Path],
    /,
    *,
    out: Path,
    report: Optional[Path] = None,
    method: Literal["bundle", "paper"] = "bundle",
    lens: Lens = "auto",
    json: Optional[Path] = None,
) -> Report:
    """Calibrate a head from a dataset, and state the accuracy.

    Args:
        dataset: Folder with dataset.json, frames.csv and images, or a robot's recording with
            map.toml in its folder (see import-recording).
        out: JSON file of the calibration. A VOID one does not replace an earlier file: it is
            written into NAME.void.json.
        report: Folder for report.md, its pictures and a recording of the dataset.
        method: Bundle adjustment, which starts from the paper's steps, or these steps alone.
        lens: Lens model of all cameras; auto: selected for each by how well it fits and predicts
            its views or, with the paper's method, radial-tangential, and none for narrow cameras.
        json: JSON file of the accuracy alone.
    """
    from vergence.calibration.calibrate import calibrate as calibrate_dataset
    from vergence.cli.calibration_report import (
        RESULTS,
        calibration_report,
        write_calibration_report,
    )

    check_outputs(out, void_file(out), json, folder=report, names=RESULTS, inputs=[dataset])
    check_replaceable(out)
    with (
        progress_bars(report) as progress,
        dataset_of(dataset, progress) as data,
        results_folder(report),
    ):
        result = calibrate_dataset(data, method=method, lens=lens, progress=progress)
        saved = save_calibration(result, out)
        found = calibration_report(result)
        found.write_json(json)
        if report is not None:
            write_calibration_report(report, found, result, data, progress=progress)
    files = saved
    if report is not None:
        files += f"\nTo view the images: {invocation('rerun', report / 'dataset.rrd')}"
    elif (count := sum(each.severity != "note" for each in result.findings)) > 1:
        files += f"\nTo read all {count} warnings, add --report FOLDER."
    return replace(found, files=files)


def void_file(out: Path) -> Path:
    """Name the file of a VOID calibration, which does not replace an earlier one."""
    return out.parent / f"{out.stem}.void{out.suffix}"


def check_replaceable(out: Path) -> None:
    """Raise VergenceError if a file that a calibration would replace is something else."""
    if out.exists():
        try:
            vg.load_head(out, allow_void=True)
        except VergenceError:
            raise VergenceError(f"{out} is no calibration, and is not replaced by one.") from None


def save_calibration(result: CalibrationResult, out: Path) -> str:
    """Save a calibration, a VOID one beside an earlier file; return the sentence about it."""
    written = void_file(out) if result.accuracy.void and out.exists() else out
    vg.save_head(result.head, written)
    return f"Wrote {written}" + (f"; {out} is as it was." if written != out else ".")


def self_calibrate(
    dataset: Positional[Path],
    /,
    *,
    calibration: Path,
    out: Path,
    json: Optional[Path] = None,
    changed: Literal["nothing", "little", "anything"] = "little",
) -> Report:
    """Correct a calibration by what both eyes see of the scene, without a board.

    Args:
        dataset: Folder with dataset.json, frames.csv and images, or a robot's recording with
            map.toml in its folder. Rows with moving eyes are used or, without such rows, all rows
            that both main cameras see.
        calibration: JSON file that `vergence calibrate` wrote, of the same head.
        out: JSON file of the learned calibration.
        json: JSON file of what was observed of each parameter.
        changed: What may have changed since the calibration: nothing, if the images were taken
            right after it; little, as by transport or temperature; anything, as by a repair, so
            that the accuracy that it states no longer holds.
    """
    from vergence.cli.evaluation_reports import self_calibration_report

    check_outputs(out, json, inputs=[dataset, calibration])
    head = vg.load_head(calibration)
    with progress_bars() as progress, dataset_of(dataset, progress) as data:
        found = vg.self_calibrate(data, head, changed=changed, progress=progress)
    vg.save_head(found.head, out)
    report = self_calibration_report(found)
    report.write_json(json)
    return replace(report, files=f"Wrote {out}.")


def evaluate(
    calibration: Positional[Path], /, *, truth: Path, json: Optional[Path] = None
) -> Report:
    """Compare a calibration with the ground truth of a dataset from the twin.

    Args:
        calibration: JSON file that `vergence calibrate` wrote.
        truth: truth.json of the dataset.
        json: JSON file of all errors.
    """
    from vergence.cli.evaluation_reports import evaluation_report
    from vergence.twin.evaluation import evaluate as compare
    from vergence.twin.evaluation import load_truth

    check_outputs(json, inputs=[calibration, truth])
    head = vg.load_head(calibration, allow_void=True)
    report = evaluation_report(compare(head, load_truth(truth)))
    report.write_json(json)
    return report


def export(
    calibration: Positional[Path],
    /,
    *,
    format: Literal["kalibr", "mrcal", "ros", "opencv", "urdf"],
    out: Path,
    at: Optional[tuple[float, ...]] = None,
    head: Optional[Path] = None,
) -> Report:
    """Write a calibration in another program's format.

    Args:
        calibration: JSON file that `vergence calibrate` wrote.
        format: Format; mrcal and ros write a folder, the others a file.
        out: File or folder to write.
        at: Joint readings [rad] at which the cameras stand in files of kalibr, mrcal and ros;
            default: straight gaze, and no rectification of moving eyes.
        head: A head.toml, whose limits the joints of a urdf get; default: a quarter turn.
    """
    from vergence.interchange import mrcal, ros

    calibrated, limits = vg.load_head(calibration), None
    if folder := {"ros": ros, "mrcal": mrcal}.get(format):
        names = map(folder.file_name, calibrated.cameras)
        check_outputs(folder=out, names=names, inputs=[calibration])
    else:
        check_outputs(out, inputs=[calibration, head])
    if head is not None:  # the twin, and with it mujoco, is not needed without
        from vergence.twin.head_model import load_head_model

        limits = load_head_model(head).limits
    vg.export_head(calibrated, out, format, at=at, limits=limits)
    return Report("Export", (), None, files=f"Wrote {out}.")


def import_(
    path: Positional[Path],
    /,
    *,
    format: Literal["kalibr", "ros"],
    start: Path,
    out: Path,
) -> Report:
    """Make a calibration from another program's files.

    Args:
        path: File; for ros a folder of files.
        format: kalibr has the cameras and their poses, ros the cameras only.
        start: Calibration that supplies mountings and joints, which these files do not contain.
        out: JSON file of the calibration.
    """
    from vergence.interchange import ros
    from vergence.interchange.formats import unchanged_lenses

    read = ros.files(path) if format == "ros" else [path]
    check_outputs(out, inputs=[*read, start])
    template = vg.load_head(start)
    head = vg.import_head(path, format, template=template)
    vg.save_head(head, out)
    kept = unchanged_lenses(head, template)
    text = (f"{path} leaves the lenses of {listed(kept)} as {start} has them.",) if kept else ()
    return Report("Import", text, None, files=f"Wrote {out}.")
