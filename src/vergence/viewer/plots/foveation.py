"""The effect of depth on foveation: the claim at the end of the paper's Sec. IV, in numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from vergence.arrays import Array
from vergence.gaze.foveation import foveal_miss, ideal_wide_pixel
from vergence.geometry.head import HeadCalibration, T_narrow_wide
from vergence.geometry.kinematics import EYES, Side
from vergence.geometry.se3 import inverse
from vergence.viewer.plots.canvas import label, panels, save
from vergence.viewer.style import EYE_COLOURS, html

NEAREST_M, FARTHEST_M = 0.25, 5.0
WRONG_M = (0.005, 0.020, 0.050)
"""Errors of depth."""
WRONG_PX = (0.5, 1.0, 2.0)
"""Errors of disparity between the wide images."""
_SHADES = ("#8fb4f0", "#4a7fe0", "#12389b")


def save_foveation(path: Path, calibration: HeadCalibration) -> None:
    """Draw the plots of `draw_foveation` into a PNG file."""
    save(draw_foveation(calibration), path)


def draw_foveation(calibration: HeadCalibration) -> Canvas:
    """Draw how the ideal wide pixel converges with depth, and what errors of depth cost."""
    canvas, (converge, cost, disparity) = panels(
        3, "Where to hold an object in the wide image so that it falls on the fovea", columns=3
    )
    depths = np.geomspace(NEAREST_M, FARTHEST_M, 200)
    for eye in EYES:
        limit = ideal_wide_pixel(calibration, eye, np.inf)
        distance = np.linalg.norm(ideal_wide_pixel(calibration, eye, depths) - limit, axis=1)
        width = 3.0 if eye == "left" else 1.5  # on a head as designed they are the same
        colour = html(EYE_COLOURS[eye][0])
        converge.plot(depths, distance, color=colour, linewidth=width, label=f"{eye} eye")
    for wrong_m, wrong_px, colour in zip(WRONG_M, WRONG_PX, _SHADES, strict=True):
        for axes, wrong, name in (
            (cost, np.full_like(depths, wrong_m), f"depth wrong by {1e3 * wrong_m:.0f} mm"),
            (
                disparity,
                by_disparity(calibration, depths, wrong_px),
                f"disparity wrong by {wrong_px:g} px",
            ),
        ):
            miss = miss_px(calibration, depths, wrong, eye="left")
            axes.plot(depths, miss, color=colour, label=name)
    _finish(converge, "ideal position, from its limit at infinity", "wide image [px]")
    _finish(cost, "what an error in depth costs, left eye", "narrow image [px]")
    _finish(disparity, "what stereo by the wide images costs (Eq. 20)", "narrow image [px]")
    return canvas


def miss_px(calibration: HeadCalibration, depths: Array, wrong: Array, *, eye: Side) -> Array:
    """Compute the distances (N,) [px] of objects from the centre of the narrow image.

    The objects are at depths (N,) [m] on the narrow camera's axis; `wrong` (N,) [m] is the error of
    these depths, positive where they are taken for too large.
    """
    T_wide_narrow = inverse(T_narrow_wide(calibration, eye))
    from_wide = T_wide_narrow[2, 2] * depths + T_wide_narrow[2, 3]
    return np.linalg.norm(foveal_miss(calibration, eye, from_wide, depths + wrong), axis=1)


def by_disparity(calibration: HeadCalibration, depths: Array, error_px: float) -> Array:
    """Compute the depth errors (N,) [m] by an error of disparity [px] at depths (N,) [m].

    Exact; Eq. 20 is its linear part, which is too small for large errors.
    """
    focal = calibration.camera("left_wide").intrinsics.matrix[0, 0]
    baseline = np.linalg.norm(calibration.T_rbase_lbase[:3, 3])
    return depths**2 * error_px / (baseline * focal - depths * error_px)


def _finish(axes: Axes, title: str, ylabel: str) -> None:
    limits = {"xscale": "log", "xlim": (NEAREST_M, FARTHEST_M), "ylim": (0, None)}
    label(axes, title, legend=True, xlabel="depth [m]", ylabel=ylabel, **limits)
    marks = [0.25, 0.5, 1, 2, 5]
    axes.set_xticks(marks, [f"{mark:g}" for mark in marks])
    axes.minorticks_off()
