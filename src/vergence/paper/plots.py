"""Plot the paper's Figs. 6-11, with its statistics and ours."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas
from matplotlib.offsetbox import AnchoredOffsetbox, HPacker, TextArea, VPacker

from vergence.paper.figures import Figure
from vergence.paper.replay import Replay, Statistics, describe
from vergence.viewer.plots.canvas import BLUE, DPI, GREEN, RED, save

_COLOURS = (BLUE, GREEN, RED)  # x, y, z
_OTHERS = ("orange", "black", "0.5")
"""Colours of the depth by other methods, in their order."""
_STYLE: dict[str, Any] = {"fontsize": 12}
"""Size of labels [points], for panels 8 inches wide."""


def save_figures(path: Path, results: Sequence[Replay]) -> None:
    """Draw figures into a PNG file, as `draw` does."""
    save(draw_figures(results), path)


def draw_figures(results: Sequence[Replay]) -> Canvas:
    """Draw estimated positions over time, as the paper does.

    Panels of a row have the same scale, to compare parallel with divergent motion.
    """
    # Parallel motion, from Fig. 6 on, is on the left.
    place = {result.figure.number: divmod(result.figure.number - 6, 2) for result in results}
    rows = sorted({row for row, _ in place.values()})
    columns = sorted({column for _, column in place.values()})
    canvas = Canvas(
        figsize=(8.0 * len(columns), 5.8 * len(rows) + 0.6),
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
    if any(result.others for result in results):
        for axes in grid[:, 0]:  # of a row that shares one scale: room for the legends
            low, high = axes.get_ylim()
            axes.set_ylim(low, high + 0.25 * (high - low))
    return canvas


def _panel(axes: Axes, result: Replay) -> None:
    figure, time_s = result.figure, result.measurements.time_s
    axes.set_visible(True)
    axes.set_title(figure.title, fontsize=14, loc="left")
    counts = f"{result.statistics.samples} samples, {result.statistics.dropped} dropped"
    axes.set_title(counts, fontsize=11, color="0.4", loc="right")
    for k, colour in enumerate(_COLOURS):
        mean, std = figure.mean_m[k], figure.std_m[k]
        axes.axhspan(mean - std, mean + std, color=colour, alpha=0.18, linewidth=0)
        axes.axhline(mean, color=colour, linewidth=0.9, linestyle=(0, (6, 4)), alpha=0.8)
        axes.plot(time_s, result.points[:, k], color=colour, linewidth=0.8)
    for (method, other), colour in zip(result.others.items(), _OTHERS, strict=False):
        label = f"depth, {method}: σ {1e3 * describe(other).std_m[0]:.1f} mm"
        axes.plot(time_s, other[:, 0], color=colour, linewidth=0.8, label=label)
    if result.others:
        axes.legend(loc="upper right", fontsize=10)
    axes.set_xlabel("time [s]", **_STYLE)
    axes.set_ylabel("position [m]", **_STYLE)
    axes.tick_params(labelleft=True, labelsize=11)
    axes.margins(x=0)
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.add_artist(_table(axes, figure, result.statistics))


def table_cells(figure: Figure, statistics: Statistics) -> list[list[str]]:
    """Make the table's columns: axes, mean ± std in the paper and here, ratio of the two std."""
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
    """Place the table midway between the curve of x and the others, where it hides neither."""
    packed: list[Artist] = []
    for column in table_cells(figure, statistics):
        cells: list[Artist] = [
            TextArea(text.replace("-", "\N{MINUS SIGN}"), textprops={"color": colour, **_STYLE})
            for text, colour in zip(column, ["0.25", *_COLOURS], strict=True)
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
