"""Pictures. The only package that imports matplotlib; it draws into files, never into a window."""

from vergence.plots.calibration import coverage, residuals, views
from vergence.plots.depth import depth
from vergence.plots.paper import AXIS_COLOURS, paper_figures

__all__ = ["AXIS_COLOURS", "coverage", "depth", "paper_figures", "residuals", "views"]
