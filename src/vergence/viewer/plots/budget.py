"""The error budget as bars: what each source adds to the error of a point, and what cancels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure as Canvas

from vergence.accuracy.budget import Budget
from vergence.viewer.plots.canvas import BLUE, GREEN, RED, label, panels, save


def save_budget(path: Path, budgets: Sequence[Budget], title: str) -> None:
    """Draw the bars of `draw_budget` into a PNG file."""
    save(draw_budget(budgets, title), path)


def draw_budget(budgets: Sequence[Budget], title: str) -> Canvas:
    """Draw for each point the standard deviation by source, along x, y and z.

    Full bars differ between samples, pale ones are shared by all. Along the axis lengths are
    standard deviations: they add up as squares, not as lengths.
    """
    canvas, all_axes = panels(
        len(budgets),
        f"Error budget, {title}; pale: what all samples share",
        columns=min(2, len(budgets)),
    )
    for axes, one in zip(all_axes, budgets, strict=True):
        parts = [*one.parts, one.total]
        places = np.arange(len(parts))[::-1]
        for k, colour in enumerate((BLUE, GREEN, RED)):
            height, at = 0.26, places + 0.26 * (1 - k)
            spread, shared = (
                np.array([1e3 * abs(getattr(part, name)[k]) for part in parts])
                for name in ("spread_m", "shared_m")
            )
            axes.barh(at, np.hypot(spread, shared), height, color=colour, alpha=0.3)
            axes.barh(at, spread, height, color=colour, label=["x = depth", "y", "z"][k])
        axes.set_yticks(places, [part.name for part in parts], fontsize=9)
        x, y, z = one.point_m
        title = f"at ({x:g}, {y:g}, {z:g}) m"
        label(axes, title, legend=True, xlabel="standard deviation [mm]", axisbelow=True)
    return canvas
