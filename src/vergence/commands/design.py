"""What `vergence design` runs: a sweep on all cores or a cluster, and its results in a folder.

Its chunks are computed by `design_chunks`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from vergence.accuracy.design_settings import AXES, DesignSettings, load_settings
from vergence.accuracy.design_sweep import (
    SOURCES,
    Sweep,
    at_distance,
    by_source,
    cheapest,
    most_accurate,
    values_of,
)
from vergence.commands.design_chunks import sweep
from vergence.errors import VergenceError, explain
from vergence.processes import process_count
from vergence.progress import Progress, silent
from vergence.viewer.plots.design import save_design, save_properties
from vergence.writable import REPORT
from vergence.writing import markdown_table, results_folder, whole_file, write_json, write_whole

LARGEST = 1_000_000
"""Limit of the accuracy [mm] and of the distance [m] that may be wanted."""
CHUNKS = "chunks"
TITLE = "# Design of a head"
RESULTS = ("sweep.npz", "design.png", "properties.png", "design.json", REPORT)
"""Files in the folder of the results, besides the chunks."""


def chosen_settings(
    path: Path | None,
    given: dict[str, tuple[float, ...] | None],
    *,
    accuracy_mm: float,
    at_m: float,
    jobs: int,
) -> DesignSettings:
    """Return the settings of a file, or the default ones, with given values in their place.

    The distance at which an accuracy is wanted is among their distances. VergenceError if a file or
    a value is not possible.
    """
    for name, value in (("--accuracy-mm", accuracy_mm), ("--at-m", at_m)):
        if not 0 < value < LARGEST:
            raise VergenceError(
                f"{name} takes a number above 0 and below {LARGEST:,}, found {value:g}."
            )
    process_count(jobs)
    settings = DesignSettings() if path is None else load_settings(path)
    chosen = settings.model_dump()
    chosen["designs"] |= {name: values for name, values in given.items() if values is not None}
    distances = settings.workspace.distances_m
    if at_m not in distances:
        chosen["workspace"]["distances_m"] = (*distances, at_m)
    try:
        return DesignSettings.model_validate(chosen)
    except ValidationError as error:
        raise VergenceError(f"These designs cannot be compared: {explain(error)}.") from None


def run(
    settings: DesignSettings,
    out: Path,
    *,
    accuracy_m: float,
    distance_m: float,
    jobs: int = -1,
    cluster: str | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Sweep, write the results into a folder, and return their summary.

    Args:
        settings: what is swept; its distances have distance_m.
        out: folder of the results.
        accuracy_m: that is wanted of points at distance_m.
        distance_m: from the middle between the eyes.
        jobs: processes on this machine; -1: one for each core.
        cluster: address of the scheduler of a Dask cluster, which then does the work.
        progress: see vergence.progress.

    Raises:
        VergenceError: a file cannot be written, or the cluster cannot be reached.
    """
    with results_folder(out):
        swept = sweep(settings, out / CHUNKS, jobs=jobs, cluster=cluster, progress=progress)
        chosen = cheapest(swept, accuracy_m, distance_m)
        shown = chosen[0] if chosen else most_accurate(swept, distance_m)
        found = summary(swept, chosen, shown, accuracy_m, distance_m)
        arrays = {name: np.array(getattr(settings.designs, name)) for name in AXES}
        arrays |= {"worst_m": swept.worst_m, "mean_m": swept.mean_m, "cost": swept.cost}
        arrays["distances_m"] = np.array(settings.workspace.distances_m)
        with whole_file(out / "sweep.npz") as part, part.open("wb") as file:
            np.savez(file, **arrays)  # pyright: ignore[reportArgumentType]
        save_design(out / "design.png", swept, shown, accuracy_m, distance_m)
        save_properties(out / "properties.png", swept, shown, distance_m)
        write_json(found, out / "design.json")
        write_whole(out / REPORT, as_markdown(found))
    return found


def summary(
    swept: Sweep,
    chosen: list[tuple[int, ...]],
    shown: tuple[int, ...],
    accuracy_m: float,
    distance_m: float,
) -> dict[str, Any]:
    """Return what a sweep found: the cheapest designs, and where the error of the first is from."""
    worst = at_distance(swept, distance_m)

    def described(place: tuple[int, ...]) -> dict[str, float]:
        return {
            **values_of(swept.settings, place),
            "cost": float(swept.cost[place]),
            "worst_mm": float(1e3 * worst[place]),
        }

    ahead = np.array([[distance_m, 0.0, 0.0]])
    squares = by_source(swept.settings, values_of(swept.settings, shown), ahead)[:, 0]
    return {
        "wanted": {"accuracy_mm": 1e3 * accuracy_m, "at_m": distance_m},
        "designs": int(swept.cost.size),
        "accurate_enough": int((worst <= accuracy_m).sum()),
        "cheapest": [described(place) for place in chosen],
        "shown": described(shown),
        "ahead_std_mm": dict(zip(SOURCES, (1e3 * np.sqrt(squares)).tolist(), strict=True)),
        "settings": swept.settings.model_dump(),
    }


def as_markdown(found: dict[str, Any]) -> str:
    """Return the report."""
    lines = [TITLE, "", *sentences(found), ""]
    heading = " | ".join(name.replace("_", " ") for name in (*AXES, "cost", "worst_mm"))
    designs = found["cheapest"] or [found["shown"]]
    rows = [[f"{each[name]:g}" for name in (*AXES, "cost")] for each in designs]
    rows = [[*row, f"{each['worst_mm']:.2f}"] for row, each in zip(rows, designs, strict=True)]
    lines += [markdown_table(heading, rows), ""]
    lines += [
        "Root mean square error of a point straight ahead that both eyes fixate, by source, for",
        "the first of these heads:",
        "",
        markdown_table("source | mm", [(k, f"{v:.3f}") for k, v in found["ahead_std_mm"].items()]),
        "",
        "![the design](design.png)",
        "",
        "![one property at a time](properties.png)",
    ]
    return "\n".join(lines) + "\n"


def sentences(found: dict[str, Any]) -> list[str]:
    """Return the result in sentences."""
    wanted, count = found["wanted"], found["accurate_enough"]
    aim = f"{wanted['accuracy_mm']:g} mm at {wanted['at_m']:g} m"
    shown = found["shown"]
    values = ", ".join(f"{name} {shown[name]:g}" for name in AXES)
    if not count:
        return [
            f"None of {found['designs']:,} designs reaches {aim}; the most accurate one has "
            f"{shown['worst_mm']:.2f} mm and costs {shown['cost']:g}: {values}.",
            "Sweep wider baselines, longer lenses, finer encoders or more views.",
        ]
    return [
        f"{count:,} of {found['designs']:,} designs reach {aim}, everywhere at that distance; the "
        f"cheapest has {shown['worst_mm']:.2f} mm and costs {shown['cost']:g}: {values}.",
    ]
