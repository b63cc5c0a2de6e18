"""The canvas that all pictures share: its panels, its colours and its file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import LogLocator, NullFormatter

from vergence.files import whole_file
from vergence.viewer.style import AXIS_COLOURS, html

DPI = 100
"""Resolution of a picture [pixels per inch]; matplotlib's usual one."""
BLUE, GREEN, RED = map(html, AXIS_COLOURS.values())


def save(canvas: Canvas, path: Path) -> None:
    """Write a canvas as a PNG file, as `whole_file` does."""
    with whole_file(path) as part:
        canvas.savefig(part, format="png")


def panels(count: int, title: str, *, columns: int = 2) -> tuple[Canvas, list[Axes]]:
    """Make a canvas with a title, and the axes of `count` panels in rows of `columns`."""
    rows = -(-count // columns)
    canvas = Canvas(figsize=(5.2 * columns, 4.0 * rows + 0.4), dpi=DPI, layout="constrained")
    FigureCanvasAgg(canvas)
    canvas.suptitle(title, fontsize=13)
    axes = list(canvas.subplots(rows, columns, squeeze=False).flat)
    for spare in axes[count:]:
        spare.set_visible(False)
    return canvas, axes[:count]


def plain_log(axis: Axis) -> None:
    """Make an axis logarithmic with ticks at 1, 2 and 5 times powers of ten, in plain numbers."""
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def image_frame(axes: Axes, size: tuple[int, int]) -> None:
    """Give axes the limits of an image of width and height [px], with the first row at the top."""
    axes.set(xlim=(-0.5, size[0] - 0.5), ylim=(size[1] - 0.5, -0.5), aspect="equal")


def label(axes: Axes, title: str, *, legend: bool = False, **settings: Any) -> None:
    """Give axes a title, a grid and further settings of `Axes.set`, and a legend of their lines."""
    axes.set_title(title, fontsize=11, loc="left")
    axes.set(**settings)
    axes.grid(color="0.9", linewidth=0.6)
    if legend:
        axes.legend(fontsize=9, frameon=False)
