"""Datasets that grow row by row and can be loaded after each of them."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vergence.data.description import DESCRIPTION, FRAMES, Description
from vergence.data.reader import load_dataset, load_description
from vergence.data.writer import DatasetRow, as_text, encode_image, row_cells
from vergence.errors import VergenceError
from vergence.files import check_writable, whole_file, write_whole


@dataclass(frozen=True, eq=False)
class GrowingDataset:
    """A dataset on disk to which rows are added."""

    folder: Path
    description: Description
    rows: tuple[Mapping[str, object], ...] = ()
    """Cells of frames.csv by column."""


def begin_dataset(folder: Path, description: Description) -> GrowingDataset:
    """Create a dataset without rows, or go on with the one in a folder.

    VergenceError if the folder holds something else, or a dataset of another description.
    """
    check_writable(folder, folder=True)
    if not folder.exists() or not any(folder.iterdir()):
        write_whole(folder / DESCRIPTION, as_text(description))
    if not (folder / DESCRIPTION).is_file():
        raise VergenceError(f"{folder} is not empty and holds no dataset; name another folder.")
    if as_text(load_description(folder)) != as_text(description):
        raise VergenceError(
            f"{folder} holds a dataset of other cameras, joints or another board; name another "
            "folder, or describe the head as its dataset.json does."
        )
    if not (folder / FRAMES).exists():
        growing = GrowingDataset(folder, description)
        _write_table(growing)
        return growing
    with (folder / FRAMES).open(encoding="utf-8", newline="") as file:
        rows = tuple(csv.DictReader(file))
    if rows:
        load_dataset(folder)  # its rows are valid
    return GrowingDataset(folder, description, rows)


def add_rows(growing: GrowingDataset, *rows: DatasetRow) -> GrowingDataset:
    """Write the images of rows, then the table with all of them.

    A process that is killed meanwhile leaves the dataset with all or none of these rows, and images
    that no row names at most. VergenceError if `load_dataset` would refuse a row.
    """
    table = list(growing.rows)
    for row in rows:
        cells, images = row_cells(growing.description, len(table), row)
        for camera, name in images.items():
            with whole_file(growing.folder / name) as part:
                part.write_bytes(encode_image(np.asarray(row.frame.images[camera])))
        table.append(cells)
    grown = replace(growing, rows=tuple(table))
    _write_table(grown)
    try:
        load_dataset(growing.folder)
    except VergenceError:
        _write_table(growing)
        raise
    return grown


def _write_table(growing: GrowingDataset) -> None:
    text = io.StringIO()
    table = csv.DictWriter(text, growing.description.columns, restval="", lineterminator="\n")
    table.writeheader()
    table.writerows(growing.rows)
    write_whole(growing.folder / FRAMES, text.getvalue())
