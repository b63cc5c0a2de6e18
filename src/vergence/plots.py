"""Pictures: the paper's Figs. 6-11 with its statistics beside ours, and those of calibrations.

The only module that imports matplotlib. It draws with Agg into a file and never opens a window.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas
from matplotlib.offsetbox import AnchoredOffsetbox, HPacker, TextArea, VPacker

from vergence.arrays import Array
from vergence.errors import VergenceError
from vergence.experiments.paper import Figure
from vergence.experiments.statistics import Statistics

AXIS_COLOURS = {"x": "#1f4fd8", "y": "#0b8a2e", "z": "#d62222"}
"""The paper's: x (depth) blue, y green, z red."""
_PANEL_INCHES, _HEADING_INCHES = (8.0, 5.8), 0.6
_DPI = 100  # six panels: 1600 x 1800 pixels
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
        dpi=_DPI,
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
    _save(canvas, path)


def _save(canvas: Canvas, path: Path) -> None:
    """Write a PNG under a temporary name, then rename it: never half a file."""
    part = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        canvas.savefig(part, format="png")
        os.replace(part, path)
    except OSError as error:
        raise VergenceError(f"Cannot write {path}: {error.strerror}.") from error
    finally:
        if part.is_file():
            part.unlink()


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


def coverage(
    path: Path,
    corners: Mapping[str, Array],
    sizes: Mapping[str, tuple[int, int]],
    eye_angles: Mapping[str, Array],
) -> None:
    """Draw where in the images the board was seen, and where the eyes looked.

    Args:
        path: of the PNG.
        corners: by camera, (V, K, 2) [px]; NaN where not seen.
        sizes: by camera, width and height [px].
        eye_angles: by eye, (V, 2) pan and tilt [rad].

    Raises:
        VergenceError: the file cannot be written.
    """
    canvas, panels = _grid(len(corners) + len(eye_angles), "Where the board was seen")
    for axes, (name, pixels) in zip(panels, corners.items(), strict=False):
        axes.plot(*pixels.reshape(-1, 2).T, ".", markersize=1.5, color="#1f4fd8")
        _frame(axes, sizes[name])
        seen = int(np.isfinite(pixels[..., 0]).sum(axis=1).astype(bool).sum())
        axes.set_title(f"{name}, {seen} views", fontsize=11, loc="left")
    for axes, (eye, angles) in zip(panels[len(corners) :], eye_angles.items(), strict=True):
        axes.plot(*np.degrees(angles).T, ".", markersize=5, color="#d62222")
        axes.set(xlabel="pan [deg]", ylabel="tilt [deg], positive down")
        axes.set_title(f"{eye} eye", fontsize=11, loc="left")
        axes.axis("equal")
        axes.grid(color="0.9", linewidth=0.6)
    _save(canvas, path)


def residuals(
    path: Path,
    corners: Mapping[str, Array],
    errors: Mapping[str, Array],
    sizes: Mapping[str, tuple[int, int]],
    eye_angles: Mapping[str, Array],
) -> None:
    """Draw residuals as arrows over the image, enlarged, and their size over the joint angles.

    Args:
        path: of the PNG.
        corners: by camera, (V, K, 2) [px].
        errors: by camera, (V, K, 2) projected minus seen [px]; NaN where not seen.
        sizes: by camera, width and height [px].
        eye_angles: by camera, (V, 2) pan and tilt of its eye [rad].

    Raises:
        VergenceError: the file cannot be written.
    """
    canvas, panels = _grid(3 * len(corners), "What is left after the fit", columns=3)
    for k, (name, pixels) in enumerate(corners.items()):
        over_image, over_pan, over_tilt = panels[3 * k : 3 * k + 3]
        points, arrows = pixels.reshape(-1, 2), errors[name].reshape(-1, 2)
        seen = np.asarray(np.isfinite(points + arrows).all(axis=1))
        size = float(np.sqrt((arrows[seen] ** 2).sum(axis=1).mean())) if seen.any() else 0.0
        enlarged = 0.02 * sizes[name][0] / max(size, 1e-9)
        over_image.quiver(
            *points[seen].T,
            *(enlarged * arrows[seen]).T,
            angles="xy",
            scale_units="xy",
            scale=1,
            width=0.0015,
            color="#1f4fd8",
        )
        _frame(over_image, sizes[name])
        title = f"{name}: rms {size:.3f} px, arrows x {enlarged:.0f}"
        over_image.set_title(title, fontsize=11, loc="left")
        length = np.linalg.norm(errors[name], axis=2)
        for axes, angles, joint in zip(
            (over_pan, over_tilt), eye_angles[name].T, ("pan", "tilt"), strict=True
        ):
            across = np.repeat(np.degrees(angles)[:, None], length.shape[1], axis=1)
            axes.plot(across.ravel(), length.ravel(), ".", markersize=1.5, color="#0b8a2e")
            axes.set(xlabel=f"{joint} [deg]", ylabel="residual [px]")
            axes.grid(color="0.9", linewidth=0.6)
    _save(canvas, path)


def views(path: Path, shown: Mapping[str, tuple[np.ndarray, Array, Array]]) -> None:
    """Draw images with the corners that were seen, and the residuals as arrows, 100 times as long.

    Args:
        path: of the PNG.
        shown: by title, image (H, W, 3), corners (K, 2) [px] and errors (K, 2) [px].

    Raises:
        VergenceError: the file cannot be written.
    """
    canvas, panels = _grid(len(shown), "The worst views; arrows: residuals x 100")
    for axes, (title, (image, corners, errors)) in zip(panels, shown.items(), strict=True):
        axes.imshow(image)
        axes.plot(*corners.T, "+", markersize=4, color="#0b8a2e")
        seen = np.asarray(np.isfinite(errors).all(axis=1))
        axes.quiver(
            *corners[seen].T,
            *(100 * errors[seen]).T,
            angles="xy",
            scale_units="xy",
            scale=1,
            width=0.003,
            color="#d62222",
        )
        axes.set_axis_off()
        axes.set_title(title, fontsize=10, loc="left")
    _save(canvas, path)


def _grid(count: int, title: str, *, columns: int = 2) -> tuple[Canvas, list[Axes]]:
    rows = -(-count // columns)
    canvas = Canvas(figsize=(5.2 * columns, 4.0 * rows + 0.4), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(canvas)
    canvas.suptitle(title, fontsize=13)
    panels = list(canvas.subplots(rows, columns, squeeze=False).flat)
    for spare in panels[count:]:
        spare.set_visible(False)
    return canvas, panels[:count]


def _frame(axes: Axes, size: tuple[int, int]) -> None:
    axes.set(xlim=(-0.5, size[0] - 0.5), ylim=(size[1] - 0.5, -0.5), aspect="equal")
