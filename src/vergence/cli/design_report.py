"""Results of the command design."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

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
from vergence.cli.report import Report, Table
from vergence.files import REPORT, whole_file, write_whole
from vergence.viewer.plots.accuracy import save_design, save_properties

TITLE = "Design of a head"
RESULTS = ("sweep.npz", "design.png", "properties.png", "design.json", REPORT)
"""Files in the folder of the results, besides the chunks."""


def write_design(out: Path, swept: Sweep, *, accuracy_m: float, distance_m: float) -> Report:
    """Write the results of a sweep into a folder, and report the cheapest accurate designs."""
    places = cheapest(swept, accuracy_m, distance_m)
    shown = places[0] if places else most_accurate(swept, distance_m)
    report = design_report(swept, places, shown, accuracy_m=accuracy_m, distance_m=distance_m)
    arrays = {name: np.array(getattr(swept.settings.designs, name)) for name in AXES}
    arrays |= {"worst_m": swept.worst_m, "mean_m": swept.mean_m, "cost": swept.cost}
    arrays["distances_m"] = np.array(swept.settings.workspace.distances_m)
    with whole_file(out / "sweep.npz") as part, part.open("wb") as file:
        np.savez(file, **arrays)  # pyright: ignore[reportArgumentType]
    save_design(out / "design.png", swept, shown, accuracy_m, distance_m)
    save_properties(out / "properties.png", swept, shown, distance_m)
    report.write_json(out / "design.json")
    write_whole(out / REPORT, report.markdown())
    return report


def design_report(
    swept: Sweep,
    places: list[tuple[int, ...]],
    shown: tuple[int, ...],
    *,
    accuracy_m: float,
    distance_m: float,
) -> Report:
    """Report the designs at `places`, and the sources of error of the one that is shown."""
    worst = at_distance(swept, distance_m)

    def described(place: tuple[int, ...]) -> dict[str, float]:
        costs = {"cost": float(swept.cost[place]), "worst_mm": float(1e3 * worst[place])}
        return {**values_of(swept.settings, place), **costs}

    designs = [described(place) for place in places]
    first, count = described(shown), int((worst <= accuracy_m).sum())
    ahead = np.array([[distance_m, 0.0, 0.0]])
    squares = by_source(swept.settings, values_of(swept.settings, shown), ahead)[:, 0]
    data: dict[str, Any] = {
        "wanted": {"accuracy_mm": 1e3 * accuracy_m, "at_m": distance_m},
        "designs": int(swept.cost.size),
        "accurate_enough": count,
        "cheapest": designs,
        "shown": first,
        "ahead_std_mm": dict(zip(SOURCES, (1e3 * np.sqrt(squares)).tolist(), strict=True)),
        "settings": swept.settings.model_dump(),
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
    heading = [name.replace("_", " ") for name in (*AXES, "cost", "worst_mm")]
    rows = [
        [*(f"{each[name]:g}" for name in (*AXES, "cost")), f"{each['worst_mm']:.2f}"]
        for each in designs or [first]
    ]
    details = (
        Table(heading, rows),
        "Root mean square error of a point straight ahead that both eyes fixate, by source, for "
        "the first of these heads:",
        Table(("source", "mm"), [(k, f"{v:.3f}") for k, v in data["ahead_std_mm"].items()]),
        "![the design](design.png)",
        "![one property at a time](properties.png)",
    )
    return Report(TITLE, (sentence,), data, details=details)
