"""What all pictures share: the canvas, its axes, and how it becomes a file."""

from __future__ import annotations

import os
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas

from vergence.errors import VergenceError

DPI = 100


def save(canvas: Canvas, path: Path) -> None:
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


def panels(count: int, title: str, *, columns: int = 2) -> tuple[Canvas, list[Axes]]:
    rows = -(-count // columns)
    canvas = Canvas(figsize=(5.2 * columns, 4.0 * rows + 0.4), dpi=DPI, layout="constrained")
    FigureCanvasAgg(canvas)
    canvas.suptitle(title, fontsize=13)
    axes = list(canvas.subplots(rows, columns, squeeze=False).flat)
    for spare in axes[count:]:
        spare.set_visible(False)
    return canvas, axes[:count]


def image_frame(axes: Axes, size: tuple[int, int]) -> None:
    axes.set(xlim=(-0.5, size[0] - 0.5), ylim=(size[1] - 0.5, -0.5), aspect="equal")
