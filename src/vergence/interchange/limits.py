"""What other formats cannot say, put into words before anything is written."""

from __future__ import annotations

import re

import numpy as np

from vergence.errors import VergenceError
from vergence.geometry.head import HeadCalibration

SKEW_PX = 1e-9
K3 = 1e-9
"""Below these a number counts as zero: it moves no pixel by a billionth."""


def refuse_skew(head: HeadCalibration, format_name: str) -> None:
    """Raise VergenceError where a camera has skew, for which a format has no field."""
    for name, mounted in head.cameras.items():
        skew = mounted.intrinsics.matrix[0, 1]
        if abs(skew) > SKEW_PX:
            raise VergenceError(
                f"{name} has a skew of {skew:.3g} px, for which {format_name} has no field; "
                "calibrate without skew to export it."
            )


def refuse_k3(head: HeadCalibration, format_name: str) -> None:
    """Raise VergenceError where a camera has k3, for which a format has no field."""
    for name, mounted in head.cameras.items():
        k3 = mounted.intrinsics.distortion[4]
        if abs(k3) > K3:
            raise VergenceError(
                f"{name} has k3 = {k3:.3g}, for which {format_name} has no field; export to opencv "
                "or ros, or calibrate without k3."
            )


def check_names(head: HeadCalibration) -> None:
    """Raise VergenceError where there is no camera, or one whose name cannot be a file's."""
    if not head.cameras:
        raise VergenceError("The calibration has no camera to export.")
    for name in head.cameras:
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
            raise VergenceError(
                f"A camera is called {name!r}; other formats need names of letters, digits and _."
            )


def pinhole_matrix(fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    """Return the (3, 3) camera matrix without skew."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
