"""Commands that calibrate, and that read and write calibrations."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

import tyro

from vergence.cli.progress import progress_bars, say_if_unfinished
from vergence.cli.tables import print_table
from vergence.commands.invocation import invocation
from vergence.errors import VergenceError, listed
from vergence.findings import select
from vergence.writable import check_outputs
from vergence.writing import results_folder, write_json


def calibrate(
    dataset: Annotated[Path, tyro.conf.Positional],
    /,
    *,
    out: Path,
    report: Path | None = None,
    method: Literal["bundle", "paper"] = "bundle",
    lens: Literal[
        "auto",
        "none",
        "k1",
        "k1k2",
        "radial-tangential",
        "radial-tangential-k3",
        "rational",
        "fisheye",
    ] = "auto",
    json: Path | None = None,
) -> None:
    """Calibrate a head from a dataset, and state the accuracy.

    Args:
        dataset: Folder with dataset.json, frames.csv and images.
        out: JSON file of the calibration. A VOID one does not replace a file that is there: it goes
            beside it, into NAME.void.json.
        report: Folder for report.md, its pictures and a recording of the dataset.
        method: Bundle adjustment, which starts from the paper's steps, or these steps alone.
        lens: Lens model of all cameras; auto: selected for each by how well it fits and predicts
            its views or, with the paper's method, radial-tangential, and none for narrow cameras.
        json: JSON file of the accuracy alone.
    """
    from vergence.calibration.calibrate import calibrate as run
    from vergence.commands.calibration_report import RESULTS, TITLE, as_plain, write_report
    from vergence.data.description import DESCRIPTION, FRAMES
    from vergence.data.reader import load_dataset
    from vergence.geometry.head import save_head

    read = [dataset / DESCRIPTION, dataset / FRAMES]
    beside = out.with_name(f"{out.stem}.void{out.suffix}")
    check_outputs(out, beside, json, folder=report, names=RESULTS, title=TITLE, inputs=read)
    data = load_dataset(dataset)
    say_if_unfinished(report)
    with progress_bars() as progress, results_folder(report):
        result = run(data, method=method, lens=lens, progress=progress)
        written = beside if result.accuracy.void and out.exists() else out
        save_head(result.head, written)
        if json is not None:
            write_json(as_plain(result), json)
        if report is not None:
            write_report(result, data, report, progress=progress)
    kept = f"; {out} is as it was" if written != out else ""
    print(f"{result.summary()}\nWrote {written}{kept}.")
    serious = select(result.findings, "void", "warning")
    if report is None and len(serious) > 1:
        print(f"To read all {len(serious)} warnings, add --report FOLDER.")
    if report is not None:
        print(f"To view the images: {invocation('rerun', report / 'dataset.rrd')}")


def self_calibrate(
    dataset: Annotated[Path, tyro.conf.Positional],
    /,
    *,
    calibration: Path,
    out: Path,
    json: Path | None = None,
    changed: Literal["nothing", "little", "anything"] = "little",
) -> None:
    """Correct a calibration by what both eyes see of the scene, without a board.

    Args:
        dataset: Folder with dataset.json, frames.csv and images. Rows with moving eyes are used or,
            where there are none, all rows that both main cameras see.
        calibration: JSON file that `vergence calibrate` wrote, of the same head.
        out: JSON file of the learned calibration.
        json: JSON file of what was observed of each parameter.
        changed: What may have changed since the calibration: nothing, if the images were taken
            right after it; little, as by transport or temperature; anything, as by a repair, so
            that the accuracy that it states no longer holds.
    """
    from vergence.commands.self_calibration import HEADING, as_plain, sentences, table
    from vergence.data.description import DESCRIPTION, FRAMES
    from vergence.data.reader import load_dataset
    from vergence.geometry.head import load_head, save_head
    from vergence.self_calibration.recorded import self_calibrate_dataset

    read = [dataset / DESCRIPTION, dataset / FRAMES, calibration]
    check_outputs(out, json, inputs=read)
    head, data = load_head(calibration), load_dataset(dataset)
    with progress_bars() as progress:
        found = self_calibrate_dataset(data, head, changed=changed, progress=progress)
    save_head(found.head, out)
    if json is not None:
        write_json(as_plain(found), json)
    rows = table(found)
    if rows:
        print_table("What was observed since the calibration", HEADING, rows)
    print("\n".join(sentences(found)))
    print(f"Wrote {out}.")


def evaluate(
    calibration: Annotated[Path, tyro.conf.Positional], /, *, truth: Path, json: Path | None = None
) -> None:
    """Compare a calibration with the ground truth of a dataset from the twin.

    Args:
        calibration: JSON file that `vergence calibrate` wrote.
        truth: truth.json of the dataset.
        json: JSON file of all errors.
    """
    from vergence.commands.evaluate import as_text
    from vergence.commands.evaluate import evaluate as run
    from vergence.commands.truth import is_truth, load
    from vergence.geometry.head import load_head

    check_outputs(json, inputs=[calibration, truth])
    if os.path.isdir(truth):
        raise VergenceError(
            f"--truth is a file that `vergence record` writes into a dataset, and {truth} is a "
            f"folder: give {truth / 'truth.json'}."
        )
    if is_truth(calibration):
        raise VergenceError(
            f"{calibration} is a truth, not a calibration; were the two exchanged? Give the file "
            "of the calibration first, and that of the truth after --truth."
        )
    found = run(load_head(calibration, allow_void=True), load(truth))
    if json is not None:
        write_json(found, json)
    print(as_text(found))


def export(
    calibration: Annotated[Path, tyro.conf.Positional],
    /,
    *,
    format: Literal["kalibr", "ros", "opencv", "urdf"],
    out: Path,
) -> None:
    """Write a calibration in another program's format.

    Args:
        calibration: JSON file that `vergence calibrate` wrote.
        format: Format; ros writes a folder, the others a file.
        out: File or folder to write.
    """
    from vergence.geometry.head import load_head
    from vergence.interchange import ros
    from vergence.interchange.formats import export_head

    head = load_head(calibration)
    if format == "ros":
        check_outputs(folder=out, names=map(ros.file_name, head.cameras), inputs=[calibration])
    else:
        check_outputs(out, inputs=[calibration])
    export_head(head, out, format)
    print(f"Wrote {out}.")


def import_(
    path: Annotated[Path, tyro.conf.Positional],
    /,
    *,
    format: Literal["kalibr", "ros", "opencv"],
    out: Path,
    start: Path | None = None,
) -> None:
    """Make a calibration from another program's files.

    Args:
        path: File; for ros a folder of files.
        format: opencv has the whole head, kalibr the cameras and their poses, ros the cameras only.
        out: JSON file of the calibration.
        start: Calibration that supplies what kalibr and ros files do not contain.
    """
    from vergence.geometry.head import load_head, save_head
    from vergence.interchange import ros
    from vergence.interchange.formats import import_head, unchanged_lenses

    if format == "opencv" and start is not None:
        raise VergenceError("opencv files hold the whole head; leave --start out.")
    read = ros.files(path) if format == "ros" else [path]
    check_outputs(out, inputs=[*read, start] if start else read)
    template = None if start is None else load_head(start)
    head = import_head(path, format, template=template)
    save_head(head, out)
    if start is not None and template is not None:
        kept = unchanged_lenses(head, template)
        if kept:
            print(f"{path} leaves the lenses of {listed(kept)} as {start} has them.")
    print(f"Wrote {out}.")
