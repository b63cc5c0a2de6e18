"""Pictures of predicted accuracy: budgets, plans of views, designs, and the cost of depth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure as Canvas

from vergence.accuracy.budget import Budget
from vergence.accuracy.design_settings import AXES
from vergence.accuracy.design_sweep import Sweep, at_distance, by_source, values_of
from vergence.accuracy.plan import Plan
from vergence.gaze.foveation import foveal_miss, ideal_wide_pixel
from vergence.geometry.board import corner_points
from vergence.geometry.head import HeadCalibration, base_pose, wide_pose_in_narrow
from vergence.geometry.kinematics import EYES
from vergence.geometry.se3 import inverse, transform
from vergence.viewer.plots.canvas import BLUE, GREEN, RED, label, panels, plain_log, save
from vergence.viewer.style import EYE_COLOURS, html

MAP_STEPS = 41
"""Points of a side of the map."""
DEPTHS_M = np.geomspace(0.25, 5.0, 200)
"""Depths at which the curves are drawn [m], at equal ratios."""
DEPTH_ERRORS = {0.005: "#8fb4f0", 0.020: "#4a7fe0", 0.050: "#12389b"}
"""Drawn errors of depth [m], with their colours."""


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
    T = base_pose(plan.head, "left")
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
    levels_mm = (0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500)
    lines = above.contour(y, x, error_mm, levels=levels_mm, cmap="viridis")
    above.clabel(lines, fmt="%g mm", fontsize=8)
    above.invert_xaxis()  # y, to the left
    title = "of fixated points, from above"
    label(above, title, xlabel="y [m]", ylabel="x [m]", aspect="equal")
    baselines = settings.designs.baseline_mm
    for k in np.unique(np.linspace(0, len(baselines) - 1, 7).astype(int)):
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
        axes.axhline(0, alpha=0)  # the margin is a part of the height above zero
        axes.margins(y=0.08)
        label(axes, "", xlabel=name.replace("_", " "), ylabel="[mm]", ylim=(0, None))
    save(canvas, path)


def draw_foveation(calibration: HeadCalibration) -> Canvas:
    """Draw how the ideal wide pixel converges with depth, and what errors of depth cost.

    This is the claim at the end of the paper's Sec. IV.
    """
    canvas, (converge, cost) = panels(
        2, "Where to hold an object in the wide image so that it falls on the fovea"
    )
    for eye in EYES:
        limit = ideal_wide_pixel(calibration, eye, np.inf)
        distance = np.linalg.norm(ideal_wide_pixel(calibration, eye, DEPTHS_M) - limit, axis=1)
        width = 3.0 if eye == "left" else 1.5  # on a head as designed they are the same
        colour = html(EYE_COLOURS[eye][0])
        converge.plot(DEPTHS_M, distance, color=colour, linewidth=width, label=f"{eye} eye")
    T_wide_narrow = inverse(wide_pose_in_narrow(calibration, "left"))
    from_wide = T_wide_narrow[2, 2] * DEPTHS_M + T_wide_narrow[2, 3]
    for wrong_m, colour in DEPTH_ERRORS.items():
        miss = foveal_miss(calibration, "left", from_wide, DEPTHS_M + wrong_m)
        name = f"depth wrong by {1e3 * wrong_m:.0f} mm"
        cost.plot(DEPTHS_M, np.linalg.norm(miss, axis=1), color=colour, label=name)
    for axes, title, ylabel in (
        (converge, "ideal position, from its limit at infinity", "wide image [px]"),
        (cost, "what an error in depth costs, left eye", "narrow image [px]"),
    ):
        limits = {"xscale": "log", "xlim": DEPTHS_M[[0, -1]], "ylim": (0, None)}
        label(axes, title, legend=True, xlabel="depth [m]", ylabel=ylabel, **limits)
        marks = [0.25, 0.5, 1, 2, 5]
        axes.set_xticks(marks, [f"{mark:g}" for mark in marks])
        axes.minorticks_off()
    return canvas
