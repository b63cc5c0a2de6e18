"""Read a recording back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rerun.chunk import RrdReader

from vergence.arrays import Array
from vergence.errors import VergenceError


def read_series(
    path: Path, entity: str, *, component: str = "Scalars:scalars", timeline: str = "sim_time"
) -> tuple[Array, Array]:
    """Return the times (N,) [s] and the values of one series of a recording, in order of time.

    Values are (N, ...), or (N, k, ...) where k were logged at a time, as in `/paper/x`. On the
    timeline `frame` times are sample numbers.

    Raises:
        VergenceError: the recording has no such series.
    """
    times: list[np.ndarray] = []
    rows: list[Any] = []
    stream = RrdReader(path).stream()
    for chunk in stream.filter(content=entity, components=component, has_timeline=timeline):
        batch = chunk.to_record_batch()
        times.append(batch.column(timeline).cast("int64").to_numpy())
        rows += batch.column(component).to_pylist()
    if not times:
        raise VergenceError(f"{path} has no {component} at {entity} on the timeline {timeline}.")
    t, values = np.concatenate(times), np.array(rows)
    order = np.argsort(t, kind="stable")
    seconds = t[order] * (1e-9 if timeline == "sim_time" else 1.0)
    return seconds, (values[:, 0] if values.shape[1] == 1 else values)[order]
