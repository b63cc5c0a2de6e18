"""Check before any work that the results of a command can be written."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from vergence.errors import VergenceError
from vergence.files import MAX_JSON_BYTES, REPORT, UNFINISHED, check_writable, read_bytes

DATASET_FILES = ("dataset.json", "frames.csv")
OWNED = {
    "dataset.json": "a dataset",
    "dataset.rrd": "a report of calibrate",
    "depth.rrd": "results of depth",
    "design.json": "results of design",
    "foveate.rrd": "results of foveate",
    "grasp.rrd": "results of grasp",
    "statistics.json": "results of reproduce",
    "track.rrd": "results of track",
}
"""Files that identify the contents of a folder."""


def check_outputs(
    *outputs: Path | None,
    figure: Path | None = None,
    folder: Path | None = None,
    names: Iterable[str] = (),
    title: str = "",
    inputs: Iterable[Path | str | None] = (),
) -> None:
    """Check that files and a folder of results can be written, without creating any.

    Args:
        outputs: files; None: not asked for.
        figure: a further file, a picture in PNG.
        folder: folder of results.
        names: files that are written into the folder.
        title: beginning of the folder's report.md; a report with another one is not replaced.
        inputs: files and folders of datasets that the same command reads; None: not given.

    Raises:
        VergenceError: a path cannot be written, two are the same, one is an input or the folder,
            the folder holds something else, or the name of the figure does not end in .png.
    """
    if figure is not None and figure.suffix.lower() != ".png":
        raise VergenceError(f"A figure is a PNG file, whose name ends in .png; found {figure}.")
    read = [Path(path) / name for path in inputs if path for name in ("", *DATASET_FILES)]
    taken = {path.resolve(): "the file that is read" for path in read if os.path.isfile(path)}
    names = tuple(names)
    if folder is not None:
        place = check_writable(folder, folder=True)
        outputs = (*outputs, *(folder / name for name in (*names, UNFINISHED)))
        taken |= dict.fromkeys((place, *place.parents), "a folder of other results")
    for path in filter(None, (*outputs, figure)):
        place = check_writable(path)
        if place in taken:
            raise VergenceError(f"Cannot write {path}: it is also {taken[place]}.")
        taken[place] = "the file of another result"
    if folder is not None:
        _check_contents(folder, names, title)


def _check_contents(folder: Path, names: tuple[str, ...], title: str) -> None:
    for name, what in OWNED.items():
        if name not in names and os.path.exists(folder / name):
            raise VergenceError(
                f"{folder} is {what}, since it has {name}: other results do not go into it. Name "
                "another folder."
            )
    report = folder / REPORT
    if title and os.path.exists(report):
        begin = read_bytes(report, MAX_JSON_BYTES)[:80].decode(errors="replace").partition("\n")[0]
        if not begin.startswith(title):
            raise VergenceError(
                f"{report} is the report of something else, and would be lost: it begins with "
                f"{begin!r}, not with {title!r}. Name another folder, or remove that file."
            )
