"""Export and import by the name of a format, for the command line."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from vergence.calibration.plausibility import implausible_geometry
from vergence.errors import VergenceError
from vergence.gaze.commands import JointLimits
from vergence.geometry.head import HeadCalibration
from vergence.geometry.kinematics import checked_readings
from vergence.geometry.parameters import lens_vector
from vergence.interchange import kalibr, mrcal, opencv, ros, urdf
from vergence.interchange.serialization import with_intrinsics

ExportFormat = Literal["kalibr", "mrcal", "ros", "opencv", "urdf"]
ImportFormat = Literal["kalibr", "ros"]


def export_head(
    head: HeadCalibration,
    path: Path | str,
    format_name: ExportFormat,
    *,
    limits: JointLimits | None = None,
    at: ArrayLike | None = None,
) -> None:
    """Write a head in another program's format; mrcal and ros write a folder, the others a file.

    `limits` are those of the joints; only urdf has a field for them. Poses in files of kalibr,
    mrcal and ros are those at readings `at` (r,) [rad]; None: straight gaze, and in ros none of
    moving eyes.

    Raises:
        VergenceError: the format is unknown, the head has a property for which it has no field,
            or the path cannot be written; or the readings are not those of the head.
    """
    _check_format(format_name, get_args(ExportFormat))
    if at is not None:
        at = checked_readings(head.kinematics, at, one_posture=True)
    writers = {
        "kalibr": partial(kalibr.save, at=at),
        "mrcal": partial(mrcal.save, at=at),
        "ros": partial(ros.save, at=at),
        "opencv": opencv.save,
        "urdf": partial(urdf.save, limits=limits),
    }
    writers[format_name](head, Path(path))


def import_head(
    path: Path | str, format_name: ImportFormat, *, template: HeadCalibration
) -> HeadCalibration:
    """Read cameras from another program's format into a head.

    Args:
        path: a file, or for ros a folder of files.
        format_name: kalibr contains cameras and their relative poses, ros only cameras.
        template: a head that supplies what the file does not contain.

    Raises:
        VergenceError: the format is unknown, or the file cannot be read.
    """
    _check_format(format_name, get_args(ImportFormat))
    path = Path(path)
    if format_name == "ros":
        return with_intrinsics(template, ros.load(path))
    head = kalibr.update_head(kalibr.load(path), template)
    for finding in implausible_geometry(head):
        raise VergenceError(f"{path}: {finding}")
    return head


def unchanged_lenses(head: HeadCalibration, template: HeadCalibration) -> list[str]:
    """List the cameras of an imported head whose intrinsics are those of its template."""
    pairs = ((n, head.camera(n).intrinsics, m.intrinsics) for n, m in template.cameras.items())
    return [name for name, a, b in pairs if np.array_equal(lens_vector(a), lens_vector(b))]


def _check_format(name: str, known: tuple[str, ...]) -> None:
    if name not in known:
        raise VergenceError(f"The format is one of {', '.join(known)}; found {name!r:.80}.")
