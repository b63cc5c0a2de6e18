"""The paper's Figs. 6-11 with its statistics beside ours."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas
from matplotlib.offsetbox import AnchoredOffsetbox, HPacker, TextArea, VPacker

from vergence.arrays import Array
from vergence.paper.figures import Figure
from vergence.paper.statistics import Statistics
from vergence.viewer.canvas import DPI, save

AXIS_COLOURS = {"x": "#1f4fd8", "y": "#0b8a2e", "z": "#d62222"}
"""The paper's: x (depth) blue, y green, z red."""
_PANEL_INCHES, _HEADING_INCHES = (8.0, 5.8), 0.6
_FIRST = 6  # the paper's experiments come in pairs from here: parallel left, divergent right
_STYLE: dict[str, Any] = {"fontsize": 12}


class Observed(Protocol):
    """When the samples were taken."""

    @property
    def time_s(self) -> Array:
        """(N,)."""
        ...


class Points(Protocol):
    """What was estimated."""

    @property
    def points(self) -> Array:
        """(N, 3) [m] in the left eye's base frame; NaN: dropped."""
        ...


class FigureResult(Protocol):
    """What is drawn of a figure; experiments.replay.Replay is one."""

    @property
    def figure(self) -> Figure: ...
    @property
    def observations(self) -> Observed: ...
    @property
    def located(self) -> Points: ...
    @property
    def statistics(self) -> Statistics: ...


def paper_figures(path: Path, results: Sequence[FigureResult]) -> None:
    """Draw figures as the paper has them: positions against time.

    Rows share their scale, so that parallel and divergent motion can be compared by eye.

    Args:
        path: of the PNG; it appears only when it is complete.
        results: of any of the figures, at least one.

    Raises:
        VergenceError: the file cannot be written.
    """
    place = {result.figure.number: divmod(result.figure.number - _FIRST, 2) for result in results}
    rows = sorted({row for row, _ in place.values()})
    columns = sorted({column for _, column in place.values()})
    width, height = _PANEL_INCHES
    canvas = Canvas(
        figsize=(width * len(columns), height * len(rows) + _HEADING_INCHES),
        dpi=DPI,  # six panels: 1600 x 1800 pixels
        layout="constrained",
    )
    FigureCanvasAgg(canvas)
    canvas.suptitle(
        "Estimated position of a fixed object while the eyes move\n"
        "line: estimates    dashed, band: mean ± standard deviation in the paper",
        fontsize=13,
    )
    grid = canvas.subplots(len(rows), len(columns), squeeze=False, sharey="row")
    for axes in grid.flat:
        axes.set_visible(False)
    for result in results:
        row, column = place[result.figure.number]
        _panel(grid[rows.index(row), columns.index(column)], result)
    save(canvas, path)


def _panel(axes: Axes, result: FigureResult) -> None:
    figure, time_s = result.figure, result.observations.time_s
    axes.set_visible(True)
    title = f"Fig. {figure.number} - {figure.motion}, {figure.lens.removesuffix('mm')} mm"
    axes.set_title(title, fontsize=14, loc="left")
    counts = f"{result.statistics.samples} samples, {result.statistics.dropped} dropped"
    axes.set_title(counts, fontsize=11, color="0.4", loc="right")
    for k, colour in enumerate(AXIS_COLOURS.values()):
        mean, std = figure.mean_m[k], figure.std_m[k]
        axes.axhspan(mean - std, mean + std, color=colour, alpha=0.18, linewidth=0)
        axes.axhline(mean, color=colour, linewidth=0.9, linestyle=(0, (6, 4)), alpha=0.8)
        axes.plot(time_s, result.located.points[:, k], color=colour, linewidth=0.8)
    axes.set_xlabel("time [s]", **_STYLE)
    axes.set_ylabel("position [m]", **_STYLE)
    axes.tick_params(labelleft=True, labelsize=11)
    axes.margins(x=0)
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.add_artist(_table(axes, figure, result.statistics))


def _cells(figure: Figure, statistics: Statistics) -> list[list[str]]:
    """Return the columns of the table: the axes, mean ± std in the paper and here, their ratio."""
    columns = [["", "x = depth", "y", "z"], ["paper [mm]"], ["here [mm]"], ["std here / paper"]]
    for k in range(3):
        paper_mm, paper_std_mm = 1e3 * figure.mean_m[k], 1e3 * figure.std_m[k]
        mm, std_mm = 1e3 * statistics.mean_m[k], 1e3 * statistics.std_m[k]
        located = bool(np.isfinite(std_mm))
        columns[1].append(f"{paper_mm:.0f} ± {paper_std_mm:.0f}")
        digits = 1 if std_mm >= 1 else 2
        ours = f"{mm:.{digits}f} ± {std_mm:.{digits}f}"
        columns[2].append(ours if located else "not located")
        columns[3].append(f"{std_mm / paper_std_mm:.2f}" if located else "")
    return columns


def _table(axes: Axes, figure: Figure, statistics: Statistics) -> Artist:
    """Return the table, midway between the curve of x and the others, where none runs."""
    packed: list[Artist] = []
    for column in _cells(figure, statistics):
        cells: list[Artist] = [
            TextArea(text.replace("-", "\N{MINUS SIGN}"), textprops={"color": colour, **_STYLE})
            for text, colour in zip(column, ["0.25", *AXIS_COLOURS.values()], strict=True)
        ]
        packed.append(VPacker(children=cells, align="right", pad=0, sep=4))
    middle = (figure.mean_m[0] - 2 * figure.std_m[0] + max(figure.mean_m[1:])) / 2
    box = AnchoredOffsetbox(
        loc="center",
        child=HPacker(children=packed, pad=0, sep=14),
        pad=0.5,
        bbox_to_anchor=(0.5, middle),
        bbox_transform=axes.get_yaxis_transform(),
    )
    box.patch.set(alpha=0.85, edgecolor="0.8")
    return box
