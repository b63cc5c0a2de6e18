"""Pictures of predicted accuracy: error budgets, plans of views, and sweeps over designs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vergence.accuracy.budget import Budget
from vergence.accuracy.design_settings import AXES
from vergence.accuracy.design_sweep import Sweep, at_distance, by_source, values_of
from vergence.accuracy.plan import Plan
from vergence.geometry.board import corner_points
from vergence.geometry.head import T_head_base
from vergence.geometry.se3 import transform
from vergence.viewer.plots.canvas import BLUE, GREEN, RED, label, panels, plain_log, save

MAP_STEPS = 41
LEVELS = (0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500)
"""Levels of the map's contours [mm]."""
UNITS = ("mm", "px", "deg", "ms")
"""At the end of the name of a property."""
CURVES = 7
"""Baselines that are drawn at most."""


def save_budget(path: Path, budgets: Sequence[Budget], title: str) -> None:
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
    save(canvas, path)


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
        label(axes, title, xlabel=f"{'xyz'[a]} [m]", ylabel=f"{'xyz'[b]} [m]", aspect="equal")
    above.invert_xaxis()  # y, to the left
    side.legend(fontsize=9, frameon=False, loc="lower left", bbox_to_anchor=(0, 1.08))
    largest = 1e3 * np.array([plan.before_m.max(), *plan.steps_m])
    curve.plot(np.arange(len(largest)), largest, ".-", color=BLUE)
    title = "largest standard deviation of a point, by the calibration"
    label(curve, title, xlabel="views recorded", ylabel="[mm]", ylim=(0, None))
    save(canvas, path)


def save_design(
    path: Path, sweep: Sweep, place: tuple[int, ...], accuracy_m: float, distance_m: float
) -> None:
    """Draw the map of a design from above, its curves by baseline, and the front of costs."""
    canvas, (above, curves, front) = panels(3, "Accuracy of points by design", columns=3)
    settings = sweep.settings
    reach = max(settings.workspace.distances_m)
    near = min(settings.workspace.distances_m)
    x, y = np.linspace(near, reach, MAP_STEPS), np.linspace(-reach / 2, reach / 2, MAP_STEPS)
    grid = np.stack(np.broadcast_arrays(x[:, None], y, 0.0), axis=-1).reshape(-1, 3)
    squares = by_source(settings, values_of(settings, place), grid).sum(axis=0)
    error_mm = 1e3 * np.sqrt(squares).reshape(MAP_STEPS, MAP_STEPS)
    lines = above.contour(y, x, error_mm, levels=LEVELS, cmap="viridis")
    above.clabel(lines, fmt="%g mm", fontsize=8)
    above.invert_xaxis()  # y, to the left
    title = "of fixated points, from above"
    label(above, title, xlabel="y [m]", ylabel="x [m]", aspect="equal")
    baselines = settings.designs.baseline_mm
    for k in np.unique(np.linspace(0, len(baselines) - 1, CURVES).astype(int)):
        own = (int(k), *place[1:])
        name = f"{baselines[k]:g} mm" + (" (chosen)" if own == place else "")
        width = 2.5 if own == place else 1.0
        distances = settings.workspace.distances_m
        order = np.argsort(distances)
        errors_mm = 1e3 * sweep.worst_m[own][order]
        curves.plot(np.array(distances)[order], errors_mm, linewidth=width, label=name)
    curves.plot(distance_m, 1e3 * accuracy_m, "x", color=RED, label="wanted")
    title = "worst direction and posture, by baseline"
    scales = {"xscale": "log", "yscale": "log"}
    label(curves, title, legend=True, xlabel="distance [m]", ylabel="[mm]", **scales)
    worst, cost = 1e3 * at_distance(sweep, distance_m).ravel(), sweep.cost.ravel()
    order = np.lexsort((worst, cost))
    best = np.minimum.accumulate(worst[order])
    front.step(cost[order], best, where="post", color=BLUE, label="the best for a cost")
    front.axhline(1e3 * accuracy_m, color=RED, linewidth=1, label="wanted")
    front.plot(sweep.cost[place], worst.reshape(sweep.cost.shape)[place], "o", color=GREEN)
    error = f"worst error at {distance_m:g} m [mm]"
    label(front, "accuracy by cost", legend=True, yscale="log", xlabel="cost", ylabel=error)
    for axis in (curves.xaxis, curves.yaxis, front.yaxis):
        plain_log(axis)
    save(canvas, path)


def save_properties(path: Path, sweep: Sweep, place: tuple[int, ...], distance_m: float) -> None:
    """Draw how accuracy follows from one property at a time, the others being the design's."""
    canvas, all_axes = panels(
        len(AXES), f"Worst error at {distance_m:g} m by one property at a time", columns=4
    )
    worst = 1e3 * at_distance(sweep, distance_m)
    for k, (name, axes) in enumerate(zip(AXES, all_axes, strict=True)):
        values = np.array(getattr(sweep.settings.designs, name))
        line = worst[(*place[:k], slice(None), *place[k + 1 :])]
        order = np.argsort(values)
        axes.plot(values[order], line[order], ".-", color=BLUE)
        axes.plot(values[place[k]], line[place[k]], "o", color=GREEN)
        what, _, unit = name.rpartition("_")
        xlabel = f"{what.replace('_', ' ')} [{unit}]" if unit in UNITS else name.replace("_", " ")
        axes.axhline(0, alpha=0)  # the margin is a part of the height above zero
        axes.margins(y=0.08)
        label(axes, "", xlabel=xlabel, ylabel="[mm]", ylim=(0, None))
    save(canvas, path)
