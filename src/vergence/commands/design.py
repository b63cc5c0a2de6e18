"""What `vergence design` runs: a sweep on all cores or a cluster, and its results in a folder.

Finished chunks are files of their own in the folder of results, named by what they depend on: a run
that was stopped, and a sweep that shares designs with an earlier one, compute only what is missing.
"""

from __future__ import annotations

import hashlib
import os
import threading
import time
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, cast

import joblib
import numpy as np
from pydantic import ValidationError

from vergence import __version__
from vergence.accuracy.design_settings import AXES, DesignSettings, chunks, load_settings
from vergence.accuracy.design_sweep import (
    SOURCES,
    Sweep,
    assemble,
    at_distance,
    by_source,
    cheapest,
    chunk_shape,
    compute_chunk,
    most_accurate,
    values_of,
)
from vergence.arrays import Array
from vergence.errors import VergenceError, explain
from vergence.progress import Progress, silent
from vergence.viewer.opening import markdown_table
from vergence.viewer.plots.design import draw_axes, draw_design
from vergence.writing import results_folder, whole_file, write_json, write_whole

CHUNKS = "chunks"
TIMEOUT_S = 10


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
        if not 0 < value < 1e6:
            raise VergenceError(f"{name} takes a number above 0, found {value:g}.")
    if jobs == 0:
        raise VergenceError("--jobs takes a number of processes, or -1 for all cores, found 0.")
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
        draw_design(out / "design.png", swept, shown, accuracy_m, distance_m)
        draw_axes(out / "properties.png", swept, shown, distance_m)
        write_json(found, out / "design.json")
        write_whole(out / "report.md", as_markdown(found))
    return found


def sweep(
    settings: DesignSettings,
    folder: Path,
    *,
    jobs: int = 1,
    cluster: str | None = None,
    progress: Progress = silent,
) -> Sweep:
    """Return a sweep, whose chunks are read from a folder or else computed and written there."""
    each = list(chunks(settings))
    files = [folder / f"{digest(chunk)}.npy" for chunk in each]
    kept = [_read(file, chunk_shape(chunk)) for file, chunk in zip(files, each, strict=True)]
    found = {k: known for k, known in enumerate(kept) if known is not None}
    missing = [(k, each[k]) for k in range(len(each)) if k not in found]
    progress("sweeping designs", len(found), len(each))
    if missing:
        for k, values in _computed(missing, jobs, cluster):
            with whole_file(files[k]) as part, part.open("wb") as file:
                np.save(file, values)
            found[k] = values
            progress("sweeping designs", len(found), len(each))
    return assemble(settings, [found[k] for k in range(len(each))])


def digest(chunk: DesignSettings) -> str:
    """Return a name for all that a chunk depends on; prices do not matter."""
    text = f"{__version__} {chunk.designs.model_dump_json()} {chunk.workspace.model_dump_json()}"
    return hashlib.blake2b(text.encode(), digest_size=12).hexdigest()


def _read(file: Path, shape: tuple[int, ...]) -> Array | None:
    """Return what an earlier run has written; None if there is nothing of this shape to be read."""
    try:
        values = np.load(file, allow_pickle=False)
    except (OSError, ValueError, EOFError, MemoryError, zipfile.BadZipFile):
        return None
    return values if isinstance(values, np.ndarray) and values.shape == shape else None


def _computed(
    missing: list[tuple[int, DesignSettings]], jobs: int, cluster: str | None
) -> Iterable[tuple[int, Array]]:
    """Yield the numbers and values of chunks as they are finished."""
    parent = os.getpid() if cluster is None else None
    tasks = [joblib.delayed(_numbered)(k, chunk, parent) for k, chunk in missing]
    with _backend(cluster):
        parallel = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")
        yield from cast(Iterable[tuple[int, Array]], parallel(tasks))


def _numbered(k: int, chunk: DesignSettings, parent: int | None) -> tuple[int, Array]:
    """Compute a chunk, in a process that ends with its parent; None: it belongs to a cluster."""
    if parent not in (None, os.getpid()):
        _end_with(parent)
    return k, compute_chunk(chunk)


@cache
def _end_with(parent: int | None) -> None:
    """Let this process end when its parent was killed; joblib's would wait for work for ever."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _backend(cluster: str | None) -> Iterator[None]:
    """Let joblib use a Dask cluster in a `with` block; None: processes of this machine."""
    if cluster is None:
        yield
        return
    try:
        from distributed import Client  # pyright: ignore[reportMissingImports]  # optional
    except ImportError:
        raise VergenceError(
            "A cluster needs Dask, which is not installed; `pip install 'vergence[cluster]'` "
            "installs it."
        ) from None
    try:
        client = Client(cluster, timeout=TIMEOUT_S)
    except (OSError, ValueError, TypeError) as error:
        raise VergenceError(
            f"No Dask scheduler answers at {cluster!r}, which should be like "
            f"tcp://192.168.1.10:8786 ({type(error).__name__})."
        ) from None
    with client, joblib.parallel_config(backend="dask"):
        yield


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
    lines = ["# Design of a head", "", *said(found), ""]
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


def said(found: dict[str, Any]) -> list[str]:
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
