"""What cross-validation says of a calibration: its held-out error, and whether to believe it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from vergence.calibration.checks.cross_validation import (
    PartCalibration,
    calibrate_folds,
    held_out,
)
from vergence.calibration.observations import Observations, camera_eyes
from vergence.calibration.summary import MISFIT_CAUSES
from vergence.errors import VergenceError
from vergence.findings import Finding, void, warning
from vergence.geometry.head import HeadCalibration
from vergence.geometry.head_accuracy import HeldOut

LARGEST_JACKKNIFE_RATIO = 2.0
"""Ratio of standard deviations from which the stated ones are called too small. The folds determine
it to about a tenth."""
VOID_RATIO = 10.0
"""Ratio of standard deviations from which the result must not be used."""
VOID_MISFIT = 5.0
"""Held-out error, as a multiple of what the noise explains, from which it must not be used."""


class Validation(NamedTuple):
    """What cross-validation found."""

    held_out: HeldOut | None
    findings: tuple[Finding, ...] = ()
    """Among them why there is no held-out error."""


def cross_validated(
    observations: Observations,
    whole: HeadCalibration,
    of_part: Callable[[np.ndarray], PartCalibration],
) -> Validation:
    """Predict each fold of the views from a calibration by the others, of `of_part`."""
    try:
        found = held_out(observations, calibrate_folds(observations, of_part), whole)
    except VergenceError as error:
        said = f"There is no held-out error: {error}"
        return Validation(None, (warning("no-held-out-error", said),))
    if not found.transfer_views and len(set(camera_eyes(observations).values())) > 1:
        said = "There is no held-out error of points: no view shows the board to both eyes."
        return Validation(found, (warning("no-held-out-points", said),))
    misfit = _misfit(found)
    ratio = found.jackknife_ratio
    if ratio is None or ratio <= LARGEST_JACKKNIFE_RATIO:
        return Validation(found, misfit)
    said = f"Calibrations from parts of the views differ {ratio:.1f} times as much as stated: "
    if ratio > VOID_RATIO:
        said += "they contradict each other; look for views with wrong readings."
        return Validation(found, (void("views-contradict", said), *misfit))
    said += (
        "true errors are larger than the stated ones by as much at least; look for errors that "
        "corners share (a board that bends, blur)."
    )
    return Validation(found, (warning("stated-too-small", said), *misfit))


def _misfit(checked: HeldOut) -> tuple[Finding, ...]:
    """Return a sentence if held-out points are too wrong for the calibration to be used."""
    if checked.point_mm is None or checked.expected_mm is None:
        return ()
    ratio = checked.point_mm / checked.expected_mm
    if ratio < VOID_MISFIT:
        return ()
    said = f"Held-out points are {ratio:.1f} times as wrong as the noise explains; {MISFIT_CAUSES}."
    return (void("held-out-misfit", said),)
