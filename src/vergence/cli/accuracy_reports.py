"""Results of the commands plan, design and budget."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from vergence.accuracy.budget import Budget, MotionBudgets, Part
from vergence.accuracy.design_settings import AXES
from vergence.accuracy.design_sweep import (
    SOURCES,
    Sweep,
    at_distance,
    by_source,
    cheapest,
    most_accurate,
    values_of,
)
from vergence.accuracy.plan import Plan
from vergence.cli.report import Report
from vergence.errors import VergenceError
from vergence.files import REPORT, markdown_table, whole_file, write_whole
from vergence.geometry.board import corner_points
from vergence.geometry.head import base_pose
from vergence.geometry.se3 import transform

DESIGN_RESULTS = ("sweep.npz", "design.png", "properties.png", "design.json", REPORT)
"""Files in the folder of the results."""
FIRST_ORDER = 0.08
"""Std of a point, relative to its distance, up to which sampled points spread within 2 % of it."""


def plan_report(found: Plan) -> Report:
    """Report a plan: a row for each view, and the accuracy that is predicted."""
    views, readings = found.views, found.head.kinematics.readings
    T_head_target = base_pose(found.head, "left") @ views.T_lbase_target
    centres = transform(T_head_target, corner_points(found.board).mean(axis=0))
    normals = -T_head_target[:, :3, 2]  # towards the head
    places = np.unique(views.placement, return_inverse=True)[1]
    rows = [
        (
            str(k + 1),
            " ".join(f"{x:z.3f}" for x in centres[k]),
            " ".join(f"{x:z.2f}" for x in normals[k]),
            " ".join(f"{angle:z.1f}" for angle in np.degrees(joints)),
            f"{1e3 * found.steps_m[k]:.2f}",
        )
        for k, joints in enumerate(views.joints)
    ]
    heading = (
        "view | centre of the board x y z in the head [m] | its normal | "
        f"{', '.join(readings)} [deg] | largest std by then [mm]"
    )
    sentences = (
        "Largest standard deviation of a point by the calibration: "
        f"{1e3 * found.before_m.max():.2f} mm now, {1e3 * found.after_m.max():.2f} mm after these "
        "views (predicted).\n"
        "A place of the board need not be met exactly: calibrate with what was recorded."
    )
    data = {
        "readings": list(readings),
        "views": [
            {
                "place": int(places[k]),
                "board_centre_head_m": centres[k].tolist(),
                "board_normal_head": normals[k].tolist(),
                "T_lbase_target": views.T_lbase_target[k].tolist(),
                "joints_rad": joints.tolist(),
                "largest_std_m": float(found.steps_m[k]),
            }
            for k, joints in enumerate(views.joints)
        ],
        "points_lbase_m": found.workspace.points.tolist(),
        "std_before_m": found.before_m.tolist(),
        "std_after_m": found.after_m.tolist(),
    }
    return Report("Views to record next", (markdown_table(heading, rows), sentences), data)


def write_design(out: Path, swept: Sweep, *, accuracy_m: float, distance_m: float) -> Report:
    """Write the results of a sweep into a folder, and report the cheapest accurate designs."""
    places = cheapest(swept, accuracy_m, distance_m)
    shown = places[0] if places else most_accurate(swept, distance_m)
    report = design_report(swept, places or [shown], accuracy_m=accuracy_m, distance_m=distance_m)
    arrays = {name: np.array(getattr(swept.settings.designs, name)) for name in AXES}
    arrays |= {"worst_m": swept.worst_m, "mean_m": swept.mean_m, "cost": swept.cost}
    arrays["distances_m"] = np.array(swept.settings.workspace.distances_m)
    with whole_file(out / "sweep.npz") as part, part.open("wb") as file:
        np.savez(file, **arrays)  # pyright: ignore[reportArgumentType]
    from vergence.viewer.plots.accuracy import save_design, save_properties

    save_design(out / "design.png", swept, shown, accuracy_m, distance_m)
    save_properties(out / "properties.png", swept, shown, distance_m)
    report.write_json(out / "design.json")
    write_whole(out / REPORT, report.markdown())
    return report


def design_report(
    swept: Sweep, places: list[tuple[int, ...]], *, accuracy_m: float, distance_m: float
) -> Report:
    """Report the designs at `places`, and the sources of error of the first."""
    worst, settings = at_distance(swept, distance_m), swept.settings
    designs = [
        values_of(settings, place)
        | {"cost": float(swept.cost[place]), "worst_mm": float(1e3 * worst[place])}
        for place in places
    ]
    if np.isinf(worst[places[0]]):
        raise VergenceError(
            f"None of {swept.cost.size:,} designs shows both cameras the points at "
            f"{distance_m:g} m and enough of the board to calibrate with; try a shorter baseline, "
            "larger squares or a shorter focal length."
        )
    first, count = designs[0], int((worst <= accuracy_m).sum())
    ahead = np.array([[distance_m, 0.0, 0.0]])
    squares = by_source(settings, values_of(settings, places[0]), ahead)[:, 0]
    data: dict[str, Any] = {
        "wanted": {"accuracy_mm": 1e3 * accuracy_m, "at_m": distance_m},
        "designs": int(swept.cost.size),
        "accurate_enough": count,
        "cheapest": designs if count else [],
        "shown": first,
        "ahead_std_mm": dict(zip(SOURCES, (1e3 * np.sqrt(squares)).tolist(), strict=True)),
        "settings": settings.model_dump(),
    }
    aim = f"{1e3 * accuracy_m:g} mm at {distance_m:g} m"
    values = ", ".join(f"{name} {first[name]:g}" for name in AXES)
    reached = f"{first['worst_mm']:.2f} mm and costs {first['cost']:g}: {values}."
    sentence = (
        f"{count:,} of {swept.cost.size:,} designs reach {aim}, everywhere at that distance; the "
        f"cheapest has {reached}"
        if count
        else f"None of {swept.cost.size:,} designs reaches {aim}; the most accurate one has "
        f"{reached}\nSweep wider baselines, longer lenses, finer encoders or more views."
    )
    details = (
        markdown_table(
            " | ".join(first).replace("_", " "),
            [[f"{value:.5g}" for value in each.values()] for each in designs],
        ),
        "Root mean square error of a point straight ahead that both eyes fixate, by source, for "
        "the first of these heads:",
        markdown_table("source | mm", [(k, f"{v:.3f}") for k, v in data["ahead_std_mm"].items()]),
        "![the design](design.png)",
        "![one property at a time](properties.png)",
    )
    return Report("Design of a head", (sentence,), data, details=details)


def budget_report(found: MotionBudgets) -> Report:
    """Report the budgets of points: a table and a sentence of advice for each."""
    # Standard deviations of what differs between samples, and of what all samples share.
    heading = "source | x | y | z | x, parallel | shared"
    parts: list[str] = []
    for k, one in enumerate(found.budgets):
        x, y, z = one.point_m
        parts += [
            f"({x:g}, {y:g}, {z:g}) m, {found.motion} motion: 1 std [mm]",
            markdown_table(heading, budget_rows(found, k)),
            advice(one),
        ]
    data = {
        "motion": found.motion,
        "points": list(map(_plain, found.budgets)),
        "in_parallel_motion": list(map(_plain, found.parallel)),
    }
    return Report("Error budget", parts, data)


def budget_rows(found: MotionBudgets, k: int) -> list[tuple[str, ...]]:
    """List the parts of point k [mm], the total last."""

    def mm(value: float) -> str:
        return f"{1e3 * value:z.2f}"

    def sources(budgets: list[Budget]) -> list[Part]:
        return [*budgets[k].parts, budgets[k].total]

    parallel = sources(found.parallel)
    return [
        (
            part.name,
            *map(mm, part.spread_m),
            mm(other.spread_m[0]),
            " ".join(map(mm, part.shared_m)) if part.shared_m.any() else "",
        )
        for part, other in zip(sources(found.budgets), parallel, strict=True)
    ]


def advice(one: Budget) -> str:
    """Name the sources whose reduction would help most."""
    total = 1e3 * float(np.linalg.norm(one.total.std_m))
    best = sorted(one.halved_m.items(), key=lambda item: item[1])[:2]
    halves = [f"half of {name!r} would give {1e3 * value:.2f} mm" for name, value in best]
    text = f"A point is off by {total:.2f} mm (1 std in space); {', '.join(halves)}."
    if total > 1e3 * FIRST_ORDER * np.linalg.norm(one.point_m):
        text += (
            f" That is more than {100 * FIRST_ORDER:.0f} % of its distance, too much for a budget, "
            "which is of first order: the true error may be larger or smaller."
        )
    return text


def _plain(one: Budget) -> dict[str, object]:
    def moments(part: Any) -> dict[str, object]:
        return {"spread_m": part.spread_m.tolist(), "shared_m": part.shared_m.tolist()}

    return {
        "point_m": one.point_m.tolist(),
        "samples": one.samples,
        "sources": {part.name: moments(part) for part in one.parts},
        "total": moments(one.total),
        "std_m_if_halved": one.halved_m,
    }
