"""Export and import by the name of a format: what the command line calls."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration
from vergence.interchange import kalibr, opencv, ros, urdf

ExportFormat = Literal["kalibr", "ros", "opencv", "urdf"]
ImportFormat = Literal["kalibr", "ros", "opencv"]


def export_head(head: HeadCalibration, path: Path, format_name: ExportFormat) -> None:
    """Write a head in another program's format; ros writes a folder, the others a file.

    Raises:
        VergenceError: the head has what the format cannot say, or the path cannot be written.
    """
    writers = {"kalibr": kalibr.save, "ros": ros.save, "opencv": opencv.save, "urdf": urdf.save}
    writers[format_name](head, path)


def import_head(
    path: Path, format_name: ImportFormat, *, start: HeadCalibration | None = None
) -> HeadCalibration:
    """Read a head from another program's format.

    Args:
        path: a file, or for ros a folder of them.
        format_name: opencv holds all of a head; kalibr holds cameras and their poses to each
            other, ros cameras alone.
        start: what the file does not say; needed for kalibr and ros.

    Raises:
        VergenceError: the file cannot be read, or a start is needed and there is none.
    """
    if format_name == "opencv":
        return opencv.load(path)
    if start is None:
        raise VergenceError(
            f"{format_name} does not say where cameras sit in the eyes; name a head calibration "
            "that does, whose cameras take the numbers from the file."
        )
    if format_name == "kalibr":
        return kalibr.into_head(kalibr.load(path), start)
    return ros.into_head(ros.load(path), start)
