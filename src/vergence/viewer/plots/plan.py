"""A picture of a plan: the places of the board from above and from the side, and the accuracy."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vergence.accuracy.plan import Plan
from vergence.geometry.board import corner_points
from vergence.geometry.head import T_head_base
from vergence.geometry.se3 import transform
from vergence.viewer.plots.canvas import BLUE, GREEN, RED, label, panels, save

AXES = "xyz"


def save_plan(path: Path, plan: Plan) -> None:
    """Draw a plan into a PNG file."""
    canvas, (above, side, curve) = panels(3, "Views to record next", columns=3)
    T = T_head_base(plan.head, "left")
    grid = corner_points(plan.board).reshape(plan.board.rows, plan.board.columns, 3)
    outline = np.array([grid[0, 0], grid[0, -1], grid[-1, -1], grid[-1, 0], grid[0, 0]])
    boards = transform((T @ plan.views.T_lbase_target)[:, None], outline)
    points = transform(T, plan.workspace.points)
    for axes, (a, b), title in ((above, (1, 0), "from above"), (side, (0, 2), "from the side")):
        axes.plot(boards[..., a].T, boards[..., b].T, color=BLUE, linewidth=1)
        axes.plot(points[:, a], points[:, b], ".", color=GREEN, label="points of the workspace")
        axes.plot(0, 0, "o", color=RED, label="head")
        label(axes, title, xlabel=f"{AXES[a]} [m]", ylabel=f"{AXES[b]} [m]", aspect="equal")
    above.invert_xaxis()  # y, to the left
    side.legend(fontsize=9, frameon=False, loc="lower left", bbox_to_anchor=(0, 1.08))
    largest = 1e3 * np.array([plan.before_m.max(), *plan.steps_m])
    curve.plot(np.arange(len(largest)), largest, ".-", color=BLUE)
    title = "largest standard deviation of a point, by the calibration"
    label(curve, title, xlabel="views recorded", ylabel="[mm]", ylim=(0, None))
    save(canvas, path)
